"""Made-up pieces of the map, for the tests of its table, figure and words."""

from dataclasses import asdict

import numpy as np

from halfseen.study.experiment import Setting
from halfseen.study.experiments.clutter import Clutter
from halfseen.study.experiments.clutter.table import table_of
from halfseen.world.config import WorldConfig

WORLD = WorldConfig()
SETTING = Setting((), world=WORLD)


def example_pieces(gain_share, design=None, repetitions=5, noise=0.01, setting=SETTING):
    """Make pieces in which the learned policy gains a share, by place, of the 12 that the best heuristic earns."""
    rng = np.random.default_rng(0)
    pieces = []
    for index in range(repetitions):
        rows = []
        for place in (design or Clutter()).places(setting):
            best = 12.0 - 3.0 * place.num_objects
            learned = best + 12.0 * (gain_share(place) + noise * rng.normal())
            rewards = {"censored_q": learned, "greedy": best - 2, "history": best - 3, "greedy-penalty": best - 1}
            rows.append(asdict(place) | {"rewards": rewards | {"history-penalty": best}})
        pieces.append({"index": index, "map": rows})
    return pieces


def example_table(gain_share, design=None, **options):
    return table_of(design or Clutter(), WORLD, example_pieces(gain_share, design, **options))
