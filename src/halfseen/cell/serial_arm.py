"""What every arm is, whoever made it: hinges in a row, and a flange for a hand."""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Iterable
from typing import Protocol, runtime_checkable

import mujoco
import numpy as np

from halfseen.errors import SceneError
from halfseen.shapes import Float

LEAST_JOINTS = 5
"""With fewer an arm reaches places, but cannot point its hand there."""


@runtime_checkable
class SerialArm(Protocol):
    """An arm that a `Robot` can have."""

    @property
    def name(self) -> str:
        """What it is."""
        ...

    @property
    def num_joints(self) -> int:
        """Number of joints."""
        ...

    @property
    def speeds_rad_s(self) -> Float[np.ndarray, " J"]:
        """Largest speed of each joint [rad/s]."""
        ...

    @property
    def search_rad(self) -> Float[np.ndarray, "J 2"]:
        """Least and largest angle of each joint at which a search for angles begins [rad]."""
        ...

    def spec(self) -> mujoco.MjSpec:
        """Build the arm alone.

        Its joints and their position servos are both called ``joint_1``, ``joint_2``, …, from the base on; a site
        ``flange`` has its z out of the arm; and its geoms carry the bits of `halfseen.cell.contacts.ROBOT`.
        """
        ...


def require_positive(what: str, part: object, names: Iterable[str]) -> None:
    """Refuse a part with a number that is not positive and finite.

    Parameters
    ----------
    what
        The part, as messages call it.
    part
        What has the numbers.
    names
        Of the numbers.

    Raises
    ------
    SceneError
        One of them, or one of its components, is not.
    """
    for name in names:
        value = getattr(part, name)
        if not all(0 < number < np.inf for number in np.atleast_1d(value)):
            raise SceneError(f"{what}: {name} is {value}; give a positive number")


def require_finite(what: str, part: object, names: Iterable[str]) -> None:
    """Refuse a part with a number that is not finite, as `require_positive` refuses those that are not positive."""
    for name in names:
        if not np.isfinite(getattr(part, name)):
            raise SceneError(f"{what}: {name} is {getattr(part, name)}; give a finite number")
