"""From a cloud to objects and who hides whom: CPU time of one thread, organised and not; medians, and JSON.

python benchmarks/perceiving.py [--out runs/benchmarks/perceiving.json] [--runs 5]

The clouds are the ten that come with the package, of 640 × 480 rays; as unorganised ones they are the returns alone,
in an order of chance and without intrinsics. Bars: 0.12 s for an organised cloud, 0.35 s for an unorganised one. The
peer is SciPy's solver, for the fits alone: each object as a vessel that lies, from two starts; both take turns.
"""

import argparse
import os
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

# Read once, when NumPy is imported.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from scipy.optimize import least_squares
from timings import Row, write

from halfseen.perception import Cloud, View, perceive, read_cloud
from halfseen.perception.trust_region import fitted
from halfseen.perception.vessel_fits import WALL_REST, thinned
from halfseen.perception.walls import LYING_BOUNDS, LyingWalls
from halfseen.scene import table_paths

BARS_S = {"organised": 0.12, "unorganised": 0.35}
STARTS = [np.array([0.02, 0.04, 0.04, 0.1, way, 0.0]) for way in (0.0, np.pi / 2)]


def shuffled(cloud: Cloud) -> Cloud:
    """Keep the returns alone, in an order of chance."""
    points_m = cloud.points_m[np.isfinite(cloud.points_m).all(axis=1)]
    return Cloud(np.random.default_rng(0).permutation(points_m), name=cloud.name)


def seconds(run: Callable[[], object]) -> float:
    begin = time.process_time()
    run()
    return time.process_time() - begin


def walls_in(view: View) -> list[LyingWalls]:
    """Of each object, the points that a fit takes, and where it is."""
    points_m = view.table.table_points(view.image.points_m.reshape(-1, 3))
    objects = [thinned(np.random.default_rng(0).permutation(points_m[seen.pixels])) for seen in view.objects]
    return [LyingWalls(each, np.median(each, axis=0), *WALL_REST) for each in objects]


def by_scipy(walls: LyingWalls) -> list[np.ndarray]:
    return [
        least_squares(
            lambda p: walls.at(p[None])[0][0],
            start,
            jac=lambda p: walls.at(p[None])[1][0].T,  # pyright: ignore[reportArgumentType]
            bounds=(LYING_BOUNDS.low, LYING_BOUNDS.high),
            loss="soft_l1",
            max_nfev=30,
        ).x
        for start in STARTS
    ]


def ours(walls: LyingWalls) -> list[np.ndarray]:
    return [place.p for place in fitted(walls, STARTS, LYING_BOUNDS)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/perceiving.json"))
    parser.add_argument("--runs", type=int, default=5)
    args = parser.parse_args()
    organised = [read_cloud(path) for path in table_paths()]
    clouds = {"organised": organised, "unorganised": [shuffled(cloud) for cloud in organised]}
    views = {kind: [perceive(cloud) for cloud in some] for kind, some in clouds.items()}
    counts = {kind: [len(view.objects) for view in some] for kind, some in views.items()}
    times = {
        kind: [[seconds(partial(perceive, cloud)) for cloud in some] for _ in range(args.runs)]
        for kind, some in clouds.items()
    }
    walls = [each for view in views["organised"] for each in walls_in(view)]
    is_same = all(np.array_equal(ours(each), by_scipy(each)) for each in walls)
    fits = [[seconds(partial(run, each)) for run in (ours, by_scipy) for each in walls] for _ in range(args.runs)]
    fit_s, scipy_s = np.median(np.array(fits).reshape(args.runs, 2, -1).sum(axis=2), axis=0) / len(walls)
    print(f"a fit {1000 * fit_s:.2f} ms, by SciPy {1000 * scipy_s:.2f} ms; the same to the last bit: {is_same}")
    rows = [Row("fitting a vessel from two starts", float(fit_s), "s", "SciPy", float(scipy_s))]
    for kind, bar_s in BARS_S.items():
        median_s = float(np.median(times[kind]))
        rows.append(Row(f"perceiving an {kind} cloud of a table", median_s, "s", bar=bar_s))
        holds = "holds" if median_s <= bar_s else "missed"
        print(f"{kind:12} median {median_s:.3f} s, worst {np.max(times[kind]):.3f} s   bar {bar_s} s: {holds}")
    print(f"objects, organised {counts['organised']}, unorganised {counts['unorganised']}")
    write(args.out, {"times_s": times, "num_objects": counts}, rows)


if __name__ == "__main__":
    main()
