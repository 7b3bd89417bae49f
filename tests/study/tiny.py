"""The experiments as small as they go, and two tables for them."""

import numpy as np

from halfseen.study.experiments.attempts import Attempts
from halfseen.study.experiments.censoring import Censoring
from halfseen.study.experiments.clutter import Clutter
from halfseen.study.experiments.grasp import Grasp
from halfseen.study.experiments.planning import Planning
from halfseen.study.experiments.regret import Regret
from halfseen.study.experiments.reward import Reward
from halfseen.study.setting import Setting
from halfseen.world.scene import Scene

SIZES = (25, 50)


def table(num_objects):
    rng = np.random.default_rng(num_objects)
    return Scene(np.tril(rng.uniform(0.0, 0.6, (num_objects, num_objects)), -1), name=f"table_{num_objects}")


SETTING = Setting((table(3), table(4)), repetitions=2)
TINY = (
    Reward(
        SIZES,
        (0.0, 0.5),
        2,
        ((4, 2), (8, 1)),
        fitted_episodes=2,
        selection_blocks=2,
        selection_planned=2,
        table_num_trajectories=50,
        num_starts=300,
    ),
    Planning(
        ((4, 2), (8, 1)), (1, 2), 8, horizon_episodes=4, num_trajectories=50, episodes_per_scene=2, num_starts=300
    ),
    Censoring(SIZES, compared_num_trajectories=50, episodes_per_scene=2),
    Grasp(SIZES, episodes_per_scene=2, num_starts=300),
    Clutter((2, 3), (0.2,), (1.0,), (-10.0,), (0.5,), num_trajectories=50, num_tables=4, episodes_per_table=5),
    Regret(2, 3, SIZES, (0.0, 0.5), planner_horizons=(1, 2), planner_simulations=8),
    Attempts((5, 10), 2),
)
