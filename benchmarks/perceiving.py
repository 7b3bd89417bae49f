"""From a cloud to objects and who hides whom: CPU time of one thread, organised and not; medians, and JSON.

python benchmarks/perceiving.py [--out runs/benchmarks/perceiving.json] [--runs 5]

The clouds are the ten that come with the package, of 640 × 480 rays; as unorganised ones they are the returns alone,
in an order of chance and without intrinsics. Bars: 0.10 s for an organised cloud, 0.35 s for an unorganised one, on a
machine that counts to ten million in 0.5 s; how long this one takes is printed, and scales nothing. The peer is SciPy's
solver, for the fits alone: each object as a vessel that lies, from two starts, those of a cloud together; both take
turns.
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
from halfseen.perception.marquardt import fitted, soft_l1
from halfseen.perception.vessel_fits import WALL_REST, thinned
from halfseen.perception.walls import LYING_BOUNDS, LyingWalls
from halfseen.scene import table_paths

BARS_S = {"organised": 0.10, "unorganised": 0.35}
# At the top of a program, where names are not local: a function counts twice as fast.
COUNTING = compile("for i in range(10_000_000): pass", "counting", "exec")
STARTS = np.array([[0.02, 0.04, 0.04, 0.1, way, 0.0] for way in (0.0, np.pi / 2)])


def shuffled(cloud: Cloud) -> Cloud:
    """Keep the returns alone, in an order of chance."""
    points_m = cloud.points_m[np.isfinite(cloud.points_m).all(axis=1)]
    return Cloud(np.random.default_rng(0).permutation(points_m), name=cloud.name)


def seconds(run: Callable[[], object]) -> float:
    begin = time.process_time()
    run()
    return time.process_time() - begin


def walls_in(view: View) -> list[np.ndarray]:
    """Of each object, the points that a fit takes."""
    points_m = view.table.table_points(view.image.points_m.reshape(-1, 3))
    return [thinned(np.random.default_rng(0).permutation(points_m[seen.pixels])) for seen in view.objects]


def walls_of(sets: list[np.ndarray]) -> LyingWalls:
    """A vessel for each object and start."""
    twice = [points_m for points_m in sets for _ in STARTS]
    return LyingWalls.of(twice, [np.median(points_m, axis=0) for points_m in twice], *WALL_REST)


def by_scipy(sets: list[np.ndarray]) -> np.ndarray:
    found = []
    for points_m in sets:
        walls = LyingWalls.of([points_m], [np.median(points_m, axis=0)], *WALL_REST)
        found += [
            least_squares(
                lambda p, walls=walls: walls.at(p[None])[0][0],
                start,
                jac=lambda p, walls=walls: walls.at(p[None])[1][0].T,  # pyright: ignore[reportArgumentType]
                bounds=(LYING_BOUNDS.low, LYING_BOUNDS.high),
                loss="soft_l1",
                max_nfev=30,
            ).x
            for start in STARTS
        ]
    return np.array(found)


def ours(sets: list[np.ndarray]) -> np.ndarray:
    return fitted(walls_of(sets), np.tile(STARTS, (len(sets), 1)), LYING_BOUNDS)


def costs(sets: list[np.ndarray], p: np.ndarray) -> np.ndarray:
    return soft_l1(walls_of(sets).at(p)[0]).sum(axis=1)


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
    sets = [walls_in(view) for view in views["organised"]]
    num_fits = sum(map(len, sets))
    found = [(costs(each, ours(each)), costs(each, by_scipy(each))) for each in sets]
    share = np.mean(np.concatenate([mine < 1.0001 * theirs for mine, theirs in found]))
    fits = [[seconds(partial(run, each)) for run in (ours, by_scipy) for each in sets] for _ in range(args.runs)]
    fit_s, scipy_s = np.median(np.array(fits).reshape(args.runs, 2, -1).sum(axis=2), axis=0) / num_fits
    print(f"a fit {1000 * fit_s:.2f} ms, by SciPy {1000 * scipy_s:.2f} ms; of {share:.0%} the cost is no higher")
    rows = [Row("fitting a vessel from two starts", float(fit_s), "s", "SciPy", float(scipy_s))]
    counting_s = float(np.median([seconds(partial(exec, COUNTING, {})) for _ in range(3)]))
    print(f"counting to ten million {counting_s:.2f} s")
    print(f"{'cloud':12} {'median s':>9} {'worst s':>9} {'bar s':>6} {'median / bar':>13}")
    for kind, bar_s in BARS_S.items():
        median_s = float(np.median(times[kind]))
        rows.append(Row(f"perceiving an {kind} cloud of a table", median_s, "s", bar=bar_s))
        holds = "holds" if median_s <= bar_s else "missed"
        print(f"{kind:12} {median_s:9.3f} {np.max(times[kind]):9.3f} {bar_s:6.2f} {median_s / bar_s:13.2f}   {holds}")
    print(f"objects, organised {counts['organised']}, unorganised {counts['unorganised']}")
    write(args.out, {"times_s": times, "num_objects": counts}, rows)


if __name__ == "__main__":
    main()
