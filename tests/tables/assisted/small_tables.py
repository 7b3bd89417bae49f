"""Small tables and logs of them, for what is learned with laws."""

import numpy as np

from fitted_laws import FITTED
from halfseen.planners import GreedyPolicy
from halfseen.world import ExploringPolicy, Scene, TableWorld

HIDES = np.array([[0.0, 0.0, 0.0, 0.0], [0.6, 0.0, 0.0, 0.0], [0.0, 0.4, 0.0, 0.0], [0.0, 0.0, 0.7, 0.0]])
SCENES = [Scene(HIDES), Scene(HIDES[:3, :3], grip=np.array([0.3, -0.2, 0.0]))]
PRICES = {
    "transport_s": 2.5,
    "reward_wash_dirty": 4.0,
    "reward_wash_clean": -7.0,
    "reward_wash_failed": -0.5,
    "reward_lift_per_s": -0.2,
    "reward_dirty_left": -3.0,
}


def logs_of(episodes, config=FITTED, seed=0, cut_share=0.4, cut_kind="independent"):
    logger = ExploringPolicy(GreedyPolicy(config, uses_history=True, counts_penalty=True), 0.5)
    options = {"cut_share": cut_share, "cut_kind": cut_kind}
    return TableWorld(config).simulate(SCENES, logger, episodes, seed=seed, **options)
