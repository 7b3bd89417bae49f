"""The parameters of the world: this project's own choice, stated in one place.

The paper prints none of them. Results are comparable only under the same configuration; the study prints it.
"""

from collections.abc import Callable, Mapping
from dataclasses import field, replace
from math import isfinite
from typing import Any, TypeAlias, TypeGuard

import numpy as np

from halfseen.arrays import STATIC, Number, record
from halfseen.errors import ArgumentError
from halfseen.world.grasping import AssumedGrasping, GraspingByRobot, GraspLaw
from halfseen.world.seeing import AssumedSeeing, SeeingLaw

HORIZON = 10


@record
class WorldConfig:
    """Parameters of the table world and of the robots at it; only `horizon` is static under JAX.

    Parameters
    ----------
    dirty_share
        Prior probability that an object is DIRTY.
    grasping
        Outcome of an attempt; a `GraspingByRobot` if robots have laws of their own.
    seeing
        Outcome of a look.
    transport_s
        Time that every action adds to its attempt; FINISH takes only this (the arm goes home) [s].
    reward_wash_dirty, reward_wash_clean, reward_wash_failed
        Reward of WASH.
    reward_lift_per_s
        Reward of LIFT for each second of the attempt, transport included [1/s].
    reward_dirty_left
        Reward for each dirty object on the table when the trajectory ends.
    horizon
        Number of actions of each robot after which a trajectory ends by itself.
    speed
        Relative speed of each of the K robots: all durations of the world are divided by it.
    reward_per_s
        Price of each second of the table's clock; 0 or below [1/s].
    drop_out_rate
        Hazard that each robot drops out (battery, e-stop), by the table's clock; None if no robot can [1/s].

    Raises
    ------
    ArgumentError
        There is no robot; a number is not finite or out of its range; or the number of hazards or of laws of grasping
        differs from the number of robots.
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
    horizon: int = field(default=HORIZON, metadata=STATIC)
    speed: tuple[Number, ...] = (1.0,)
    reward_per_s: Number = 0.0
    drop_out_rate: tuple[Number, ...] | None = None

    def __post_init__(self) -> None:
        if not self.speed:
            raise ArgumentError("speed is (): give the speed of each robot, for at least one")
        if self.drop_out_rate is not None and len(self.drop_out_rate) != self.num_robots:
            raise ArgumentError(
                f"drop_out_rate has {len(self.drop_out_rate)} entries for {self.num_robots} robots; give one "
                "for each robot, 0 if it never drops out"
            )
        if not is_whole(self.horizon, 1):
            raise ArgumentError(f"horizon is {self.horizon!r}; give a whole number of actions, at least 1")
        for name in ("dirty_share", "transport_s", "reward_per_s", *_REWARDS):
            check_number(name, getattr(self, name))
        for name, each in (("speed", self.speed), ("drop_out_rate", self.drop_out_rate or ())):
            for robot, value in enumerate(each):
                check_number(name, value, f"{name} of robot {robot}")
        law = self.grasping
        if self.num_robots > 1 and isinstance(law, GraspingByRobot) and len(law.laws) != self.num_robots:
            raise ArgumentError(
                f"grasping has laws for {len(law.laws)} robots, but the team has {self.num_robots}; give one "
                "law for each robot, or one for all"
            )

    @property
    def num_robots(self) -> int:
        """K."""
        return len(self.speed)

    @property
    def num_stages(self) -> int:
        """Largest number of decisions of a trajectory, over all robots."""
        return self.num_robots * self.horizon

    @property
    def has_own_laws(self) -> bool:
        """Whether each robot has a law of grasping of its own."""
        return isinstance(self.grasping, GraspingByRobot)

    def as_robot(self, robot: Any) -> "WorldConfig":
        """Return the world of one robot: attempts follow its law, if each robot has its own.

        Parameters
        ----------
        robot
            Its number, or one for each member of a batch; the batch axes lead in the arguments of the law.
        """
        if not isinstance(self.grasping, GraspingByRobot):
            return self
        return replace(self, grasping=replace(self.grasping, robot=robot))


_REWARDS = (
    "reward_wash_dirty",
    "reward_wash_clean",
    "reward_wash_failed",
    "reward_lift_per_s",
    "reward_dirty_left",
)
PlainNumber: TypeAlias = int | float | np.integer | np.floating
_PARAMETERS: Mapping[str, tuple[Callable[[Any], bool], str]] = {
    "dirty_share": (lambda value: 0 <= value <= 1, "a probability, in [0, 1]"),
    "transport_s": (lambda value: value >= 0, "a finite time, 0 or above [s]"),
    **dict.fromkeys(_REWARDS, (lambda value: True, "a finite reward")),
    "reach_m": (lambda value: value > 0, "a finite number above 0 [m]"),
    "speed": (lambda value: value > 0, "a finite number above 0"),
    "drop_out_rate": (lambda value: value >= 0, "a finite hazard, 0 or above [1/s]"),
    "clearance_m": (lambda value: value >= 0, "a finite distance, 0 or above [m]"),
    "reward_per_s": (lambda value: value <= 0, "a finite price, 0 or below [1/s]"),
    "random_share": (lambda value: 0 <= value <= 1, "the share of decisions made at random, in [0, 1]"),
}
"""For each parameter, the valid finite numbers and the remedy named for an invalid one."""


def is_number(value: object) -> TypeGuard[PlainNumber]:
    """Whether a value is a Python or NumPy number; a boolean is not."""
    return isinstance(value, PlainNumber) and not isinstance(value, bool)


def is_whole(value: object, least: int) -> bool:
    """Whether a value is a whole number of at least `least`."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool) and int(value) >= least


def is_finite(value: PlainNumber) -> bool:
    """Whether a number is finite in double precision; a large integer may overflow."""
    try:
        return isfinite(value)
    except OverflowError:
        return False


def check_number(name: str, value: object, label: str | None = None) -> None:
    """Check that a parameter is a valid number; arrays, which JAX makes of numbers, are not checked.

    Parameters
    ----------
    name
        Name of the parameter; a name unknown here is not checked.
    value
        Its value.
    label
        Name to use in the message.

    Raises
    ------
    ArgumentError
        The number is invalid.
    """
    is_array = hasattr(value, "dtype") and not isinstance(value, np.generic)
    if name not in _PARAMETERS or is_array:
        return
    is_right, wanted = _PARAMETERS[name]
    if not (is_number(value) and is_finite(value) and is_right(value)):
        raise ArgumentError(f"{name if label is None else label} is {value!r}; give {wanted}")
