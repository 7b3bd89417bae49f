"""A look into the running cell beside MuJoCo's rays alone, and what is perceived in it; medians, ratios, and JSON.

python benchmarks/looking.py [--out runs/benchmarks/looking.json] [--tables 5] [--runs 7]

Bar: a look at a table of six cups and perceiving what it shows cost 0.6 seconds of one core together, the look 0.25 and
perceiving 0.35. The arm waits at home, and over every other table reaches into the picture. The peer is the same view
with all that moves seen by MuJoCo's rays, cast where something that moves may show or shade, as in ours. Both take
turns in one process; what never moves is seen before. Times are those of the processor, of one thread.
"""

import argparse
import os
import time
from collections.abc import Callable
from pathlib import Path

# Read once, when NumPy is imported.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import mujoco
import numpy as np
from timings import Row, write

from halfseen.cell import CellCamera, LiveCell, MountedArm, cell_model
from halfseen.perception import perceive
from halfseen.scene.draw import num_cups_of, random_table
from halfseen.scene.moving import with_rays
from halfseen.scene.rays import CUP_GROUP, FURNITURE_GROUP, ROBOT_GROUP
from halfseen.scene.view import IdealView, Sight, ideal_view
from halfseen.scene.xtion import XTION

NUM_CUPS, LOOK_BAR_S, PERCEIVE_BAR_S = 6, 0.25, 0.35
OVER_THE_TABLE_RAD = (0.0, 3.0, 1.2, 0.0, 0.0, 0.0)


def eyes(num_tables: int) -> list[CellCamera]:
    """An eye over each table; the arm is at home, or reaches over every other table."""
    tables = (random_table(seed) for seed in range(10_000) if num_cups_of(seed) == NUM_CUPS)
    made = []
    for index, table in zip(range(num_tables), tables, strict=False):
        robot = MountedArm()
        cell = LiveCell(cell_model(table.cups, table.world_from_cup, [robot]), [robot])
        if index % 2:
            for name, angle in zip(robot.joint_names, OVER_THE_TABLE_RAD, strict=True):
                cell.data.joint(name).qpos = angle
            mujoco.mj_forward(cell.model, cell.data)
        made.append(CellCamera(cell, table.camera))
    return made


def by_rays(eye: CellCamera, empty: IdealView) -> IdealView:
    """All that moves by MuJoCo's rays."""
    sight = Sight(eye.cell.data, eye.camera, XTION.baseline_m)
    return with_rays(empty, sight, (FURNITURE_GROUP,), (ROBOT_GROUP, CUP_GROUP))


def largest_difference_m(one: IdealView, other: IdealView) -> float:
    """Between depths, where both views show the same body; infinite where they do not."""
    apart = np.abs(np.where(one.body == other.body, one.depth_m - other.depth_m, np.inf))
    return float(np.nanmax(np.where(one.is_lit == other.is_lit, apart, np.inf)))


def seconds(run: Callable[[], object]) -> float:
    begin = time.process_time()
    run()
    return time.process_time() - begin


def timed(eye: CellCamera, num_runs: int) -> tuple[dict[str, list[float]], float]:
    """Seconds that each part took, turn by turn, and how far the two views are apart [m]."""
    cell = eye.cell
    empty = ideal_view(Sight(cell.data, eye.camera, XTION.baseline_m), (FURNITURE_GROUP,))
    # The first call sees what never moves.
    apart_m = largest_difference_m(eye.view(), by_rays(eye, empty))
    cloud = eye.look(np.random.default_rng(0)).cloud
    runs: dict[str, Callable[[], object]] = {
        "view by rays": lambda: by_rays(eye, empty),
        "view": eye.view,
        "look": lambda: eye.look(np.random.default_rng(0)),
        "perceive": lambda: perceive(cloud),
    }
    times: dict[str, list[float]] = {name: [] for name in runs}
    for _ in range(num_runs):
        for name, run in runs.items():
            times[name].append(seconds(run))
    return times, apart_m


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/looking.json"))
    parser.add_argument("--tables", type=int, default=5)
    parser.add_argument("--runs", type=int, default=7)
    args = parser.parse_args()
    parts, apart_m = zip(*(timed(eye, args.runs) for eye in eyes(args.tables)), strict=True)
    times = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    medians = {name: float(np.median(each)) for name, each in times.items()}
    # The median of each turn's own ratio: what slows the machine for a while slows both.
    ratio = float(np.median(times["view by rays"] / times["view"]))
    together_s = float(np.median(times["look"] + times["perceive"]))
    for name, median in medians.items():
        print(f"{name:14s} {1000 * median:6.1f} ms, worst {1000 * times[name].max():6.1f} ms")
    print(f"rays alone take {ratio:.1f} times as long; the two views are {max(apart_m):.1e} m apart at most")
    bar_s = LOOK_BAR_S + PERCEIVE_BAR_S
    holds = "holds" if together_s <= bar_s else "does not hold"
    print(f"bar: look and perceive in {bar_s:.2f} s, here {together_s:.2f} s: {holds}")
    results = {
        "median_s": medians,
        "worst_s": {name: float(each.max()) for name, each in times.items()},
        "look_and_perceive_s": together_s,
        "rays_to_ours": ratio,
        "largest_difference_m": max(apart_m),
        "num_cups": NUM_CUPS,
        "bar_holds": together_s <= bar_s,
    }
    rows = [
        Row("a look into the cell", medians["view"], "s", "MuJoCo's rays", medians["view by rays"]),
        Row("a look into the cell, and perception", together_s, "s", bar=bar_s),
    ]
    write(args.out, results, rows)
    print(f"Results: {args.out}")


if __name__ == "__main__":
    main()
