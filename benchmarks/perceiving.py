"""From a cloud to objects and who hides whom: CPU time of one thread, organised and not; medians, and JSON.

python benchmarks/perceiving.py [--out runs/benchmarks/perceiving.json] [--runs 5]

The clouds are the ten that come with the package, of 640 × 480 rays; as unorganised ones they are the returns alone,
in an order of chance and without intrinsics. Bars: 0.12 s for an organised cloud, 0.35 s for an unorganised one.
"""

import argparse
import os
import time
from pathlib import Path

# Read once, when NumPy is imported.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from timings import Row, write

from halfseen.perception import Cloud, perceive, read_cloud
from halfseen.scene import table_paths

BARS_S = {"organised": 0.12, "unorganised": 0.35}


def shuffled(cloud: Cloud) -> Cloud:
    """Keep the returns alone, in an order of chance."""
    points_m = cloud.points_m[np.isfinite(cloud.points_m).all(axis=1)]
    return Cloud(np.random.default_rng(0).permutation(points_m), name=cloud.name)


def seconds(cloud: Cloud) -> float:
    begin = time.process_time()
    perceive(cloud)
    return time.process_time() - begin


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/perceiving.json"))
    parser.add_argument("--runs", type=int, default=5)
    args = parser.parse_args()
    organised = [read_cloud(path) for path in table_paths()]
    clouds = {"organised": organised, "unorganised": [shuffled(cloud) for cloud in organised]}
    counts = {kind: [len(perceive(cloud).objects) for cloud in some] for kind, some in clouds.items()}
    times = {kind: [[seconds(cloud) for cloud in some] for _ in range(args.runs)] for kind, some in clouds.items()}
    rows = []
    for kind, bar_s in BARS_S.items():
        median_s = float(np.median(times[kind]))
        rows.append(Row(f"perceiving an {kind} cloud of a table", median_s, "s", bar=bar_s))
        holds = "holds" if median_s <= bar_s else "missed"
        print(f"{kind:12} median {median_s:.3f} s, worst {np.max(times[kind]):.3f} s   bar {bar_s} s: {holds}")
    print(f"objects, organised {counts['organised']}, unorganised {counts['unorganised']}")
    write(args.out, {"times_s": times, "num_objects": counts}, rows)


if __name__ == "__main__":
    main()
