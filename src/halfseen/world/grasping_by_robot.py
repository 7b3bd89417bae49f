"""A law of grasping for each robot of a team, and which of them is at it now."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Int

from halfseen.arrays import Array, chosen, library_of, mapped, record
from halfseen.errors import ArgumentError
from halfseen.world.grasping import Arrangement, Attempt, GraspLaw
from halfseen.world.number import Number
from halfseen.world.random import Key


@record
class GraspingByRobot:
    """Attempts go as the law of the robot has it that makes them (a `GraspLaw`, and known where all of its laws are).

    The hidden trait is a tuple, one of each law, all drawn from one key: an object that is hard to grip is so for all
    robots. Planners take u / offset_std of an object to be one number, whoever tries it. So it is where laws draw u
    alike, as `AssumedGrasping` and `FittedGrasping` do, and grids among themselves.

    Parameters
    ----------
    laws
        Law of each robot, robot 0 first; they may be of different kinds.
    robot
        Number of the robot that tries, or of each; its axes are the first of what the law is asked for.

    Raises
    ------
    ArgumentError
        There is no law, or what is among them is no law of one robot.
    """

    laws: tuple[GraspLaw, ...]
    robot: int | Int[Array, "*R"] = 0

    def __post_init__(self) -> None:
        if not self.laws:
            raise ArgumentError("laws is (): give the law of grasping of each robot, at least one")
        for k, law in enumerate(self.laws):
            check_law(law, f"laws[{k}]")

    @property
    def limit_s(self) -> Number:
        """Longest duration of an attempt of the robot [s]."""
        return self._chosen([law.limit_s for law in self.laws])

    @property
    def offset_std(self) -> Number:
        """Standard deviation of u under the law of the robot."""
        return self._chosen([law.offset_std for law in self._known])

    @property
    def _known(self) -> tuple[Any, ...]:
        """The laws, of which whoever asks knows that their probabilities are known."""
        return self.laws

    def draw_trait(self, num_objects: int, key: Key) -> tuple[Any, ...]:
        """Draw the hidden trait of each law, all from the same key."""
        return tuple(law.draw_trait(num_objects, key) for law in self.laws)

    def attempt(
        self, table: Arrangement, trait: tuple[Any, ...], verb: Int[Array, "*B"], target: Int[Array, "*B"], key: Key
    ) -> Attempt:
        """Attempt as the robot does; the traits of the other laws stay as they are."""
        each = [law.attempt(table, own, verb, target, key) for law, own in zip(self.laws, trait, strict=True)]
        traits = tuple(
            chosen(library_of(self.robot).asarray(self.robot == k), tried.trait, own)
            for k, (tried, own) in enumerate(zip(each, trait, strict=True))
        )
        return self._chosen([tried._replace(trait=None) for tried in each])._replace(trait=traits)

    def log_failure(self, occluded: Any, offset: Any) -> Any:
        """Log probability that an attempt of the robot fails."""
        return self._chosen([law.log_failure(occluded, offset) for law in self._known])

    def expected_s(self, occluded: Any, offset: Any) -> Any:
        """Expected duration of an attempt of the robot [s]."""
        return self._chosen([law.expected_s(occluded, offset) for law in self._known])

    def _chosen(self, each: Sequence[Any]) -> Any:
        if isinstance(self.robot, int | np.integer):
            return each[int(self.robot)]
        found = each[0]
        for robot, other in enumerate(each[1:], start=1):
            found = mapped(lambda new, old, robot=robot: _where(self.robot == robot, new, old), other, found)
        return found


def _where(is_new: Any, new: Any, old: Any) -> Any:
    xp = library_of(is_new)
    num_axes = max(xp.ndim(new), xp.ndim(old))
    return xp.where(is_new.reshape(is_new.shape + (1,) * max(num_axes - is_new.ndim, 0)), new, old)


def check_law(law: object, where: str) -> None:
    """Refuse what is no law of grasping of one robot.

    Raises
    ------
    ArgumentError
        As above.
    """
    if isinstance(law, type | GraspingByRobot) or not isinstance(law, GraspLaw):
        raise ArgumentError(
            f"{where} is {law!r}, no law of grasping of one robot; give one, such as AssumedGrasping() or the grasping "
            "of a calibrated Law"
        )
