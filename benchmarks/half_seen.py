"""Is P(DIRTY) of cups that are seen in part what it says? Said beside found, by what was in view and how the cup lies.

python benchmarks/half_seen.py [--tables 100] [--washes 0] [--stains 10] [--seed 2028] [--law FOLDER] [--out FILE]

Of fresh tables every look is taken with many sets of stains, each resampled and remembered apart: what is in view
costs seconds, what is on it a tenth of one. Each cup is dirty in as many of them as the prior says. With --washes, cups
that are drawn at random are washed one after the other, and objects are counted as they looked at last, so that views
from later looks, and cups that were moved, count, too. Beside them stand the WASHes of the logs in
`examples/physical_cell`, whose rewards tell what was dirty. The z of fresh tables takes all sets of stains on one cup
for alike, as its view is; that of the logs takes cups for independent.
"""

import argparse
import json
import os
from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from pathlib import Path
from typing import Any

# Read once, when NumPy is imported.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
import pandas as pd
from scipy.special import expit
from tqdm import tqdm

from halfseen.cell.calibration.law import read_law, shipped_law
from halfseen.cell.camera import CellCamera
from halfseen.cell.memory import KnownObject
from halfseen.cell.table_state import Belief, rows_of
from halfseen.cell.workcell import Workcell
from halfseen.logs import Logs, read_logs
from halfseen.perception.clouds import Cloud
from halfseen.perception.labels import Label, StainCounter
from halfseen.perception.view import View
from halfseen.scene.cups import Surface, draw_surface
from halfseen.scene.draw import random_table
from halfseen.scene.record import colours
from halfseen.scene.table import Table
from halfseen.world.actions import Verb
from halfseen.writing import write_file

LOGS = Path(__file__).parents[1] / "examples" / "physical_cell" / "logs"
WHOLE = 1e-3
"""Of what is hidden less than that, the camera sees all that faces it."""
COLUMNS = ("log_odds", "occlusion", "is_lying", "glance_occlusions", "glance_held", "glance_dirty")


class ManyStains:
    """Labels by colour; and of each look, labels of many other sets of stains, each with a memory of its own."""

    def __init__(self, table: Table, num_sets: int, dirty_share: float, rng: np.random.Generator) -> None:
        # Each cup is dirty in the same share of the sets, so that which cups are dirty is no matter of luck.
        in_order = np.arange(num_sets)[:, None] < round(dirty_share * num_sets)
        self.is_dirty = rng.permuted(np.repeat(in_order, table.num_cups, axis=1), axis=0)
        self._surfaces = [_surfaces(table, is_dirty, rng) for is_dirty in self.is_dirty]
        self._known: list[list[KnownObject]] = [[] for _ in self.is_dirty]
        self._counter, self._rng = StainCounter(), rng
        self.cell = Workcell(table, rng, self._surfaces[0], labeller=self)

    def __call__(self, view: View, cloud: Cloud) -> Sequence[Label]:
        """Label each object of a view, and remember what it would be with other stains."""
        cell, camera = self.cell, self.cell.table.camera
        ideal, memory = CellCamera(cell.cell, camera).view(), cell.memory
        poses = [cell.cell.cup(index) for index in range(cell.cell.num_cups)]
        for surfaces, known in zip(self._surfaces, self._known, strict=True):
            known.extend(replace(each, glances=[]) for each in memory.objects[len(known) :])
            picture = colours(ideal, camera, surfaces, poses, self._rng)
            result = self._counter(view, replace(cloud, colours=picture.reshape(-1, 3)))
            for seen, label in zip(view.objects, result, strict=True):
                number = memory.number_of(seen.id)
                if number is not None and label.is_dirty is not None:
                    known[number].label(memory.occlusion(number), label.is_dirty, is_held=False)
        return self._counter(view, cloud)

    def rows(self, belief: Belief) -> list[dict[str, Any]]:
        """The labels by each set of stains of each object that is in view, and whether it is dirty."""
        memory, found = copy(self.cell.memory), []
        objects = self.cell.memory.objects
        places_m = np.array([self.cell.cell.cup(index).position_m for index in range(self.cell.cell.num_cups)])
        cups = [int(np.linalg.norm(places_m - known.middle_m, axis=1).argmin()) for known in objects]
        for number, (is_dirty, result) in enumerate(zip(self.is_dirty, self._known, strict=True)):
            memory.objects = [replace(known, glances=its.glances) for known, its in zip(objects, result, strict=True)]
            for known, cup, row in zip(objects, cups, rows_of(memory, belief), strict=True):
                if known.seen is not None and row["glance_dirty"]:
                    kept = {name: row[name] for name in COLUMNS}
                    found.append({"stains": number, "cup": cup, "is_dirty": bool(is_dirty[cup]), **kept})
        return found


def _surfaces(table: Table, is_dirty: np.ndarray, rng: np.random.Generator) -> list[Surface]:
    return [draw_surface(cup, bool(dirty), rng) for cup, dirty in zip(table.cups, is_dirty, strict=True)]


def fresh(index: int, seed: int, num_sets: int, num_washes: int, belief: Belief) -> pd.DataFrame:
    """Look at one fresh table, wash at random, and give each cup with each set of stains as it looked at last."""
    rng = np.random.default_rng([seed, index])
    many = ManyStains(random_table(int(rng.integers(2**31))), num_sets, float(belief.config.dirty_share), rng)
    rows: list[dict[str, Any]] = []
    for wash in range(num_washes + 1):
        many.cell.look()
        rows += many.rows(belief)
        left = [number for number, known in enumerate(many.cell.memory.objects) if known.seen is not None]
        if wash == num_washes or not left:
            break
        many.cell.wash(int(rng.choice(left)))
    return pd.DataFrame(rows).groupby(["stains", "cup"]).tail(1).assign(table=index)


def washed(logs: Logs, belief: Belief) -> pd.DataFrame:
    """The WASHes of a log that put one cup into the rack, as the cup looked then."""
    stages, config = pd.DataFrame(logs.stages), belief.config
    rows = stages[stages["action"] == Verb.WASH.name].merge(
        pd.DataFrame(logs.objects), on=["trajectory", "stage", "object"]
    )
    rows = rows[rows["reward"].isin([config.reward_wash_dirty, config.reward_wash_clean])].reset_index(drop=True)
    is_dirty = rows["reward"] == config.reward_wash_dirty
    return rows[[*COLUMNS]].assign(is_dirty=is_dirty, table=rows["trajectory"], cup=rows.index)


def groups(rows: pd.DataFrame) -> dict[str, dict[str, float]]:
    """P(DIRTY) beside the truth, by what was in view at best, what the labels said, and how the cup lies."""
    least = rows["glance_occlusions"].map(min)
    is_held, is_found = (rows[name].map(any) for name in ("glance_held", "glance_dirty"))
    is_half, is_lying = (least > WHOLE) & ~is_held, rows["is_lying"].astype(bool)
    is_whole = ~is_half & ~is_held
    chosen = {
        "all": least >= 0.0,
        "whole": is_whole,
        "whole, nothing found": is_whole & ~is_found,
        "whole, found": is_whole & is_found,
        "half-seen": is_half,
        "half-seen, nothing found": is_half & ~is_found,
        "half-seen, nothing found, standing": is_half & ~is_found & ~is_lying,
        "half-seen, nothing found, lying": is_half & ~is_found & is_lying,
        "half-seen, found": is_half & is_found,
        "hidden by less than 0.33": is_half & (least < 0.33),
        "by 0.33 to 0.67": is_half & least.between(0.33, 0.67),
        "by more": is_half & (least > 0.67),
        "half-seen in several looks": is_half & (rows["glance_dirty"].map(len) > 1),
        "held up": is_held,
    }
    return {name: beside_truth(pd.DataFrame(rows[mask])) for name, mask in chosen.items() if mask.any()}


def beside_truth(rows: pd.DataFrame) -> dict[str, float]:
    """Mean of what was said, share that was dirty, and the z of their difference, by the sums of each cup's."""
    said, found = expit(rows["log_odds"].to_numpy(dtype=float)), rows["is_dirty"].to_numpy(dtype=float)
    excess = pd.DataFrame({"excess": found - said, "variance": said * (1.0 - said)})
    of_cup = excess.groupby([rows["table"].to_numpy(), rows["cup"].to_numpy()]).sum()
    # Where each cup is there once, what was said tells what to expect; else how cups differ does.
    is_once = len(of_cup) == len(rows)
    variance = of_cup["variance"].sum() if is_once else (of_cup["excess"] ** 2).sum()
    z = float(of_cup["excess"].sum() / np.sqrt(variance)) if variance > 0.0 else 0.0
    return {"labels": len(rows), "cups": len(of_cup), "said": float(said.mean()), "found": float(found.mean()), "z": z}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--tables", type=int, default=100)
    parser.add_argument("--washes", type=int, default=0)
    parser.add_argument("--stains", type=int, default=10, help="sets of stains on each table: ten can hold the prior")
    parser.add_argument("--seed", type=int, default=2028)
    parser.add_argument("--law", type=Path, default=shipped_law())
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/half_seen.json"))
    options = parser.parse_args()
    law = read_law(options.law).law
    belief = Belief(law.config(), law.grip)
    each = [
        fresh(index, options.seed, options.stains, options.washes, belief)
        for index in tqdm(range(options.tables), disable=None)
    ]
    what = f"{options.tables} fresh tables, {options.stains} sets of stains on each, {options.washes} washed"
    results = {
        what: groups(pd.concat(each, ignore_index=True)),
        "washed, in the logs that come with the package": groups(washed(read_logs(LOGS), belief)),
    }
    for name, found in results.items():
        print(f"{name:<60}{'labels':>8}{'cups':>7}{'said':>8}{'found':>8}{'z':>7}")
        for group, row in found.items():
            counts = f"{row['labels']:>8.0f}{row['cups']:>7.0f}"
            print(f"  {group:<58}{counts}{row['said']:>8.3f}{row['found']:>8.3f}{row['z']:>+7.1f}")
    options.out.parent.mkdir(parents=True, exist_ok=True)
    write_file(options.out, json.dumps({"seed": options.seed, **results}, indent=1) + "\n")


if __name__ == "__main__":
    main()
