"""One stage as it is shown: plain data, whatever it comes from and whatever draws it.

Places are in one frame for all stages of a run, whose third axis points up [m].
"""

from dataclasses import dataclass, field

import numpy as np

from halfseen.arrays import Hides, Points
from halfseen.perception.clouds import Colours, Vector
from halfseen.shapes import Float
from halfseen.watch.shapes import Mesh

Poses = Float[np.ndarray, "moments parts 7"]
"""Place [m] and quaternion (w, x, y, z) of each part at each moment."""


def _no_poses() -> Poses:
    return np.zeros((0, 0, 7))


@dataclass(frozen=True, eq=False)
class Shown:
    """An object.

    Parameters
    ----------
    number
        By which decisions call it.
    is_dirty
        P(DIRTY) by all that was seen.
    occlusion
        Hidden share of its silhouette.
    middle_m
        Middle of it [m].
    solid
        What completes it; None where the last look does not show it.
    shadow
        The solid and what it hides from the camera; None without a solid.
    revealed_m
        Points of others that a LIFT of it would bring into view [m].
    """

    number: int
    is_dirty: float
    occlusion: float
    middle_m: Vector
    solid: Mesh | None
    shadow: Mesh | None
    revealed_m: Points


@dataclass(frozen=True)
class Option:
    """An action that was possible.

    Parameters
    ----------
    name
        Such as ``"LIFT 2"``.
    value
        Its Q [reward].
    low, high
        95 % interval of it, where one is known.
    chance_best
        Probability that it is the best, where one is known.
    """

    name: str
    value: float
    low: float | None = None
    high: float | None = None
    chance_best: float | None = None


@dataclass(frozen=True, eq=False)
class Hand:
    """A planned grasp.

    Parameters
    ----------
    way_m
        Where the point between the pads goes, until the object is lifted [m].
    at_m
        Where the hand is to close [m].
    axes
        Columns are the hand's axes: across the fingers, along which they close, and out of the palm.
    opening_m
        Between the pads while it comes [m].
    """

    way_m: Points
    at_m: Vector
    axes: Float[np.ndarray, "3 3"]
    opening_m: float


@dataclass(frozen=True, eq=False)
class Part:
    """A rigid body of the cell: of the arm, of the table.

    Parameters
    ----------
    solid
        In its own frame.
    colour
        Red, green and blue, in [0, 255].
    is_robot
        Whether it is of a robot; else of what the cloud shows, too.
    """

    solid: Mesh
    colour: tuple[int, int, int]
    is_robot: bool = True


@dataclass(frozen=True, eq=False)
class StageView:
    """What was seen, decided and done in one stage.

    Parameters
    ----------
    title
        Which stage it is.
    points_m, colours
        The cloud, and red, green and blue of each point.
    eye_m
        Where the camera is [m].
    objects
        What is known to stand on the table.
    hides
        ``hides[i, j]`` is the share of ``objects[i]`` that ``objects[j]`` alone hides.
    options
        Actions, best first; none where the policy values nothing.
    action
        What is done; empty where nothing was decided.
    reason
        Why, in one sentence.
    notes
        What is doubtful.
    events
        What was seen, tried and cut so far, a sentence each.
    poses
        Of the parts of the cell, moment by moment; of no moment where there is no cell.
    hand
        The planned grasp.
    """

    title: str
    points_m: Points
    colours: Colours
    eye_m: Vector
    objects: tuple[Shown, ...]
    hides: Hides
    options: tuple[Option, ...]
    action: str
    reason: str
    notes: tuple[str, ...] = ()
    events: tuple[str, ...] = ()
    poses: Poses = field(default_factory=_no_poses)
    hand: Hand | None = None

    @property
    def target(self) -> int | None:
        """Number of the object that the action is about; None if it is about none."""
        *_, last = self.action.split() or [""]
        return int(last) if last.isdigit() else None


@dataclass(frozen=True, eq=False)
class Watched:
    """A run: its stages in their order, and the cell that it ran in.

    Parameters
    ----------
    source
        Where it comes from, in words.
    stages
        At least one.
    parts
        Bodies of the cell, in the order of `StageView.poses`; none without a cell.
    """

    source: str
    stages: tuple[StageView, ...]
    parts: tuple[Part, ...] = ()
