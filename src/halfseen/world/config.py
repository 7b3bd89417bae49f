"""The numbers of the world: this project's own choice, stated in one place.

The paper prints none of them. Whoever compares results must compare them under the same configuration; the study
prints it.
"""

from dataclasses import dataclass, field, replace

import jax
from jax import Array

from halfseen.world.grasping import AssumedGrasping, GraspLaw
from halfseen.world.grasping_by_robot import GraspingByRobot
from halfseen.world.number import Number
from halfseen.world.seeing import AssumedSeeing, SeeingLaw

HORIZON = 10


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class WorldConfig:
    """Parameters of the table world (a pytree whose leaves may be traced; only `horizon` is static).

    Parameters
    ----------
    horizon
        Steps after which a path ends by itself.
    dirty_share
        Prior probability that an object is DIRTY.
    grasping
        How an attempt goes.
    seeing
        What a look tells.
    transport_s
        Time that every action takes on top of its attempt; FINISH takes only this (the arm goes home) [s].
    reward_wash_dirty, reward_wash_clean, reward_wash_failed
        Reward of WASH.
    reward_lift_per_s
        Reward of LIFT for each second of the attempt, transport included [1/s].
    reward_dirty_left
        Reward for each dirty object on the table when the path ends.
    """

    dirty_share: Number = 0.6
    grasping: GraspLaw = field(default_factory=AssumedGrasping)
    seeing: SeeingLaw = field(default_factory=AssumedSeeing)
    transport_s: Number = 1.0
    reward_wash_dirty: Number = 5.0
    reward_wash_clean: Number = -10.0
    reward_wash_failed: Number = -1.0
    reward_lift_per_s: Number = -0.1
    reward_dirty_left: Number = -5.0
    horizon: int = field(default=HORIZON, metadata={"static": True})

    @property
    def num_stages(self) -> int:
        """Decisions that a path may have."""
        return self.horizon

    def as_robot(self, robot: int | Array) -> "WorldConfig":
        """Give the world as one robot of a team finds it: attempts go by its law, where each has its own."""
        if not isinstance(self.grasping, GraspingByRobot):
            return self
        return replace(self, grasping=replace(self.grasping, robot=robot))
