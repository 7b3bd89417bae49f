"""What the world needs to know of a table: which object hides which, and how well each seems to be gripped.

A `Scene` is what perception hands over and what an episode starts from. It holds what can be seen and nothing hidden:
whether an object is dirty, and what nobody sees of its grip, are drawn when an episode begins.
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
    "grip": "give one number for each of the objects",
    "places_m": "give x and y an object",
}


def _is_share(values: np.ndarray) -> np.ndarray:
    return (values >= 0) & (values <= 1)


@dataclass(frozen=True)
class Scene:
    """A table of N objects, half hidden behind one another.

    Parameters
    ----------
    hides
        ``hides[i, j]`` is the share of object i's silhouette that is hidden by object j alone, in [0, 1]; the diagonal
        is 0.
    name
        Where the scene comes from, for reports.
    grip
        Mean of each object's grip offset, from what is seen of it (it lies, it is wide), in units of the law of
        grasping; above 0 it is easier to grip than most. None for 0.
    places_m
        Where each object stands on the table, to the right of the camera's foot and away from it, as perception has
        it [m]; None where nobody has said. Only who reaches what needs it.

    Raises
    ------
    SceneError
        `hides` is not square, leaves [0, 1], is not finite, or lets an object hide itself; `grip` or `places_m` is not
        finite, or not one number, or one place, an object.
    """

    hides: Hides
    name: str = "scene"
    grip: PerObject | None = None
    places_m: Float[np.ndarray, "N 2"] | None = None

    def __post_init__(self) -> None:
        hides = np.array(self.hides, dtype=np.float64)
        num = len(hides) if hides.ndim else 0
        self._keep("hides", hides, (num, num), _is_share, "a hidden share lies in [0, 1]")
        i = int(np.argmax(np.append(np.diag(hides) != 0, True)))
        if i < num:
            raise SceneError(
                f"{self.name}: hides[{i}, {i}] is {hides[i, i]}; an object does not hide itself: set it to 0"
            )
        grip = np.zeros(num) if self.grip is None else self.grip
        self._keep("grip", grip, (num,), np.isfinite, "give a finite offset, 0 where nothing is known")
        if self.places_m is not None:
            self._keep("places_m", self.places_m, (num, 2), np.isfinite, "give a finite place [m]")

    def _keep(
        self, name: str, given: Any, shape: tuple[int, ...], is_right: Callable[[np.ndarray], np.ndarray], remedy: str
    ) -> None:
        """Keep a copy that nobody can write into, if its numbers are right and as many as there are objects."""
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
        """Hidden share of each object while all stand on the table: 1 − Π_j (1 − hides[i, j])."""
        return 1.0 - np.prod(1.0 - self.hides, axis=1)
