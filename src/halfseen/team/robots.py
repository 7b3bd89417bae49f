"""The robots of a team: where each stands, how far it reaches, how fast it works; where they work on one table."""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from halfseen.errors import ArgumentError, HalfseenWarning
from halfseen.team.state import Workspace

CLEARANCE_M = 0.12
"""Distance below which two objects are too near for two robots at once [m]: two open grippers side by side."""


@dataclass(frozen=True)
class Robot:
    """One robot at the table.

    Parameters
    ----------
    base_m
        Where it stands, (x, y), in the frame of `Scene.places_m`: right of the camera's foot, and away from it [m].
    reach_m
        How far from there it can grasp [m].
    speed
        What takes the law of the world so many seconds takes it that, divided by its speed.
    name
        What it is called in messages.
    drop_out_rate
        Hazard that it drops out (battery, e-stop), by the table's clock [1/s].

    Raises
    ------
    ArgumentError
        A number is not finite, reach or speed is not above 0, or the hazard is below it.
    """

    base_m: tuple[float, float]
    reach_m: float
    speed: float = 1.0
    name: str = "robot"
    drop_out_rate: float = 0.0

    def __post_init__(self) -> None:
        if not np.isfinite(self.base_m).all():
            raise ArgumentError(f"{self.name}: base_m is {self.base_m}; give finite x and y [m]")
        for what in ("reach_m", "speed"):
            value = getattr(self, what)
            if not (np.isfinite(value) and value > 0):
                raise ArgumentError(f"{self.name}: {what} is {value}; give a finite number above 0")
        if not (np.isfinite(self.drop_out_rate) and self.drop_out_rate >= 0):
            rate = self.drop_out_rate
            raise ArgumentError(f"{self.name}: drop_out_rate is {rate}; give a finite hazard, 0 or above [1/s]")


def workspace_of(
    robots: Sequence[Robot], places_m: Float[np.ndarray, "N 2"], clearance_m: float = CLEARANCE_M, name: str = "table"
) -> Workspace:
    """Tell what each robot reaches, and which objects are too near one another for two robots at once.

    An object that nobody reaches is warned of: it will be left.

    Parameters
    ----------
    robots
        The team, robot 0 first.
    places_m
        Where each object stands, (x, y) in the frame of the table [m].
    clearance_m
        Objects nearer than that are too near [m].
    name
        Of the table, for messages.

    Raises
    ------
    ArgumentError
        There is no robot, a place is not finite, or the clearance is below 0.
    """
    if not robots:
        raise ArgumentError("robots is empty: give at least one Robot")
    if not np.isfinite(places_m).all():
        k = int(np.argmin(np.isfinite(places_m).all(axis=1)))
        raise ArgumentError(f"{name}: object {k} stands at {places_m[k]}; give a finite place [m]")
    if not (clearance_m >= 0 and np.isfinite(clearance_m)):
        raise ArgumentError(f"clearance_m is {clearance_m}; give a finite distance, 0 or above [m]")
    bases = np.array([robot.base_m for robot in robots], dtype=np.float64)
    reaches = np.array([robot.reach_m for robot in robots], dtype=np.float64)
    is_in_reach = np.linalg.norm(places_m[None] - bases[:, None], axis=-1) <= reaches[:, None]
    for k in np.flatnonzero(~is_in_reach.any(axis=0)):
        x, y = places_m[k]
        message = f"{name}: object {k} at ({x:.3g}, {y:.3g}) m is in no robot's reach, so it counts as left"
        warnings.warn(f"{message}; move a base, or leave it out", HalfseenWarning, stacklevel=2)
    apart_m = np.linalg.norm(places_m[:, None] - places_m[None], axis=-1)
    is_near = (apart_m < clearance_m) | np.eye(len(places_m), dtype=bool)
    return Workspace(jnp.asarray(is_in_reach), jnp.asarray(is_near))
