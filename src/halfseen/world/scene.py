"""Initial arrangement of a table: which object hides which, and how well each can probably be gripped.

A `Scene` is the output of perception and the start of an episode. It holds only observable properties: whether an
object is dirty, and the hidden part of its grip offset, are drawn when an episode begins.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from halfseen.arrays import Hides, PerObject
from halfseen.errors import SceneError
from halfseen.shapes import Float

_SHAPES = {
    "hides": "it must be square",
    "grip": "give one number for each object",
    "places_m": "give x and y of each object",
}


def _is_share(values: np.ndarray) -> np.ndarray:
    return (values >= 0) & (values <= 1)


@dataclass(frozen=True)
class Scene:
    """A table of N objects that partly occlude one another.

    Parameters
    ----------
    hides
        ``hides[i, j]`` is the share of object i's silhouette that is hidden by object j alone, in [0, 1]; the diagonal
        is 0.
    name
        Origin of the scene, for reports.
    grip
        Mean of each object's grip offset given what is observed (it lies on its side, it is wide), in units of the law
        of grasping; above 0, it is easier to grip than most. None for 0.
    places_m
        Place of each object on the table from perception: to the right of the camera's foot, and away from it [m]. None
        if unknown; only needed to find which robot reaches which object.

    Raises
    ------
    SceneError
        `hides` is not square, outside [0, 1], not finite, or lets an object hide itself; `grip` or `places_m` is not
        finite, or does not have one number, or one place, per object.
    """

    hides: Hides
    name: str = "scene"
    grip: PerObject | None = None
    places_m: Float[np.ndarray, "N 2"] | None = None

    def __post_init__(self) -> None:
        hides = np.array(self.hides, dtype=np.float64)
        num = len(hides) if hides.ndim else 0
        self._keep("hides", hides, (num, num), _is_share, "give hidden shares in [0, 1]")
        i = int(np.argmax(np.append(np.diag(hides) != 0, True)))
        if i < num:
            raise SceneError(
                f"{self.name}: hides[{i}, {i}] is {hides[i, i]}; an object does not hide itself; set it to 0"
            )
        grip = np.zeros(num) if self.grip is None else self.grip
        self._keep("grip", grip, (num,), np.isfinite, "give a finite offset, 0 where unknown")
        if self.places_m is not None:
            self._keep("places_m", self.places_m, (num, 2), np.isfinite, "give a finite place [m]")

    def _keep(
        self, name: str, given: Any, shape: tuple[int, ...], is_right: Callable[[np.ndarray], np.ndarray], remedy: str
    ) -> None:
        """Set a field to a read-only copy, after checking shape and values."""
        values = np.array(given, dtype=np.float64)
        if values.shape != shape:
            raise SceneError(f"{self.name}: {name} has shape {values.shape}; {_SHAPES[name]}, {shape}")
        wrong = np.argwhere(~is_right(values))
        if len(wrong):
            where = ", ".join(map(str, wrong[0]))
            raise SceneError(f"{self.name}: {name}[{where}] is {values[tuple(wrong[0])]}; {remedy}")
        values.setflags(write=False)
        object.__setattr__(self, name, values)

    @property
    def num_objects(self) -> int:
        """Number of objects on the table."""
        return len(self.hides)

    @property
    def occlusion(self) -> PerObject:
        """Hidden share of each object while all are on the table: 1 − Π_j (1 − hides[i, j])."""
        return 1.0 - np.prod(1.0 - self.hides, axis=1)
