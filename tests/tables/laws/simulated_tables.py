"""Logs of tables with much to tell, for fits of laws."""

import numpy as np

from halfseen.planners import GreedyPolicy
from halfseen.tables.fitted_world import evidence_of
from halfseen.world import ExploringPolicy, Scene, TableWorld, WorldConfig
from halfseen.world.recording import to_logs

LOGGER = ExploringPolicy(GreedyPolicy(WorldConfig(), uses_history=True, counts_penalty=True), 0.5)


def scene(grip=None):
    """Five objects, from hardly hidden to nearly whole."""
    hides = np.zeros((5, 5))
    hides[1, 0], hides[2, 1], hides[3, 2], hides[4, 0], hides[4, 3] = 0.2, 0.5, 0.8, 0.6, 0.7
    return Scene(hides) if grip is None else Scene(hides, grip=np.asarray(grip))


def recorded(num_paths, cut_share=0.0, cut_kind="independent", config=None, seed=0, table=None):
    """The episodes with what was hidden, and the log of them."""
    config = WorldConfig() if config is None else config
    scenes = [scene() if table is None else table]
    cuts = TableWorld(config).record(scenes, LOGGER, num_paths, seed, cut_share, cut_kind)
    return cuts, to_logs(cuts, cut_kind, scenes, config.dirty_share)


def evidence(num_paths, *args, config=None, **options):
    """What such a log tells."""
    config = WorldConfig() if config is None else config
    return evidence_of(recorded(num_paths, *args, config=config, **options)[1], config)
