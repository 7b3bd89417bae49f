"""Logs of tables with much to tell, for fits of laws."""

import numpy as np
import pytest

from halfseen.planners import GreedyPolicy
from halfseen.tables.evidence import evidence_of
from halfseen.world import ExploringPolicy, FittedGrasping, PersistentSeeing, Scene, TableWorld, WorldConfig
from halfseen.world.logs import to_logs

GRASPING = FittedGrasping(
    log_odds=2.0,
    log_odds_per_occlusion=-0.5,
    offset_std=0.8,
    log_held_s=1.3,
    log_missed_s=1.6,
    log_std=0.25,
    limit_s=9.5,
)
"""A law such as attempts of a cell tell: the view hardly matters, and misses take longer."""

SEEING = PersistentSeeing(
    facing=0.3,
    views=(0.075, 0.15, 0.225, 0.3, 1.0),
    sensitivity=(0.45, 0.6, 0.7, 0.8, 0.97),
    false_alarms=(0.02, 0.05, 0.08, 0.1, 0.3),
)
CALIBRATED = WorldConfig(grasping=GRASPING, seeing=SEEING)

LOGGER = ExploringPolicy(GreedyPolicy(WorldConfig(), uses_history=True, counts_penalty=True), 0.5)


def scene(grip=None):
    """Five objects, from hardly hidden to nearly whole."""
    hides = np.zeros((5, 5))
    hides[1, 0], hides[2, 1], hides[3, 2], hides[4, 0], hides[4, 3] = 0.2, 0.5, 0.8, 0.6, 0.7
    return Scene(hides) if grip is None else Scene(hides, grip=np.asarray(grip))


def recorded(num_trajectories, cut_share=0.0, cut_kind="independent", config=None, seed=0, table=None):
    """The episodes with what was hidden, and the log of them."""
    config = WorldConfig() if config is None else config
    scenes = [scene() if table is None else table]
    with pytest.MonkeyPatch.context() as patch:
        # The share that is cut may be a little off: finding it took as long as the episodes.
        patch.setattr("halfseen.world.table_world.NUM_PILOT_TRAJECTORIES", 200)
        cuts = TableWorld(config).record(scenes, LOGGER, num_trajectories, seed, cut_share, cut_kind)
    return cuts, to_logs(cuts, cut_kind, scenes, config.dirty_share)


def evidence(num_trajectories, *args, config=None, **options):
    """What such a log tells."""
    config = WorldConfig() if config is None else config
    return evidence_of(recorded(num_trajectories, *args, config=config, **options)[1], config)
