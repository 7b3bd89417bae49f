"""Made-up pieces of the map, for the tests of its table, figure and words."""

from dataclasses import asdict

import numpy as np

from halfseen.study.map_cells import MapDesign, map_cells
from halfseen.study.map_table import map_table
from halfseen.world.config import WorldConfig

WORLD = WorldConfig()
TINY_MAP = MapDesign(
    num_objects=(2, 3),
    occlusions=(0.2,),
    label_gains=(0.3,),
    wash_clean_rewards=(-10.0,),
    grip_offset_stds=(0.5,),
    num_paths=30,
    num_tables=4,
    episodes_per_table=5,
)
"""Quick to draw up."""


def example_pieces(gain_share, map_design=None, repetitions=5, noise=0.01):
    """Make pieces in which the learned policy gains a share, by cell, of the 12 that the best heuristic earns."""
    rng = np.random.default_rng(0)
    pieces = []
    for repetition in range(repetitions):
        rows = []
        for cell in map_cells(map_design or MapDesign(), WORLD):
            best = 12.0 - 3.0 * cell.num_objects
            learned = best + 12.0 * (gain_share(cell) + noise * rng.normal())
            rewards = {"cql": learned, "greedy": best - 2, "history": best - 3, "greedy-penalty": best - 1}
            rows.append(asdict(cell) | {"rewards": rewards | {"history-penalty": best}})
        pieces.append({"repetition": repetition, "map": rows})
    return pieces


def example_table(gain_share, map_design=None, **options):
    return map_table(example_pieces(gain_share, map_design, **options), map_design or MapDesign(), WORLD)
