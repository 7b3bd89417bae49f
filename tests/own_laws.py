"""Teams whose robots have laws of grasping of their own, and what they play."""

import numpy as np

from halfseen.world import FittedGrasping, Robot, Scene, TableWorld, WorldConfig, random
from halfseen.world.rollout import play
from picked import picked

NUM_OBJECTS = 4
HIDES = np.triu(np.full((NUM_OBJECTS, NUM_OBJECTS), 0.25), 1)
SCENE = Scene(HIDES, places_m=np.array([[-0.3, 0.0], [-0.1, 0.0], [0.1, 0.0], [0.3, 0.0]]))
WORLD = WorldConfig(horizon=5)
LOGISTIC = FittedGrasping(
    log_odds=0.4,
    log_odds_per_occlusion=-2.0,
    offset_std=1.5,
    log_held_s=float(np.log(2.0)),
    log_missed_s=float(np.log(4.0)),
    log_std=1e-3,
    limit_s=9.0,
)
KEY = random.key_of(5)


def robots(*laws, reach_m=0.75):
    """One to the left, the others to the right; each lacks the far end."""
    bases = [(-0.5, 0.0), (0.5, 0.0), (0.5, 0.1)]
    return [
        Robot(base, reach_m, name=f"r{k}", grasping=law) for k, (base, law) in enumerate(zip(bases, laws, strict=False))
    ]


def world_of(*laws, price=0.0, world=WORLD):
    return TableWorld(world, robots(*laws), reward_per_s=price)


def played(world, policy, num_trajectories=60, seed=0):
    return play(world.played_config, world.layouts([SCENE]), policy, random.key_of(seed), num_trajectories)


def met(trajectories):
    """All states that were decided in; axis B."""
    return picked(trajectories.states, trajectories.is_taken)


def first_layout(world):
    return picked(world.layouts([SCENE]), 0)
