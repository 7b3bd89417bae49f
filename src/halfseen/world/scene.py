"""What the world needs to know of a table: which object hides which, and how well each seems to be gripped.

A `Scene` is what perception hands over and what an episode starts from. It holds what can be seen and nothing hidden:
whether an object is dirty, and what nobody sees of its grip, are drawn when an episode begins.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from halfseen.arrays import Hides, PerObject
from halfseen.errors import SceneError


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
        hides = self._checked_hides()
        hides.setflags(write=False)
        object.__setattr__(self, "hides", hides)
        grip = self._checked_grip()
        grip.setflags(write=False)
        object.__setattr__(self, "grip", grip)
        if self.places_m is not None:
            places_m = self._checked_places(np.array(self.places_m, dtype=np.float64))
            places_m.setflags(write=False)
            object.__setattr__(self, "places_m", places_m)

    def _checked_hides(self) -> Hides:
        hides = np.array(self.hides, dtype=np.float64)
        if hides.ndim != 2 or hides.shape[0] != hides.shape[1]:
            raise SceneError(f"{self.name}: hides has shape {hides.shape}; it must be square, (N, N)")
        wrong = np.argwhere(~((hides >= 0) & (hides <= 1)))
        if len(wrong):
            i, j = wrong[0]
            raise SceneError(f"{self.name}: hides[{i}, {j}] is {hides[i, j]}; a hidden share lies in [0, 1]")
        if np.any(np.diag(hides) != 0):
            i = int(np.argmax(np.diag(hides) != 0))
            raise SceneError(
                f"{self.name}: hides[{i}, {i}] is {hides[i, i]}; an object does not hide itself: set it to 0"
            )
        return hides

    def _checked_grip(self) -> PerObject:
        grip = np.zeros(self.num_objects) if self.grip is None else np.array(self.grip, dtype=np.float64)
        if grip.shape != (self.num_objects,):
            raise SceneError(f"{self.name}: grip has shape {grip.shape}; give one number for each of the objects")
        if not np.isfinite(grip).all():
            i = int(np.argmin(np.isfinite(grip)))
            raise SceneError(f"{self.name}: grip[{i}] is {grip[i]}; give a finite offset, 0 where nothing is known")
        return grip

    def _checked_places(self, places_m: np.ndarray) -> np.ndarray:
        if places_m.shape != (self.num_objects, 2):
            shape = self.num_objects, 2
            raise SceneError(f"{self.name}: places_m has shape {places_m.shape}; give x and y an object, {shape}")
        if not np.isfinite(places_m).all():
            i = int(np.argmin(np.isfinite(places_m).all(axis=1)))
            raise SceneError(f"{self.name}: places_m[{i}] is {places_m[i]}; give a finite place [m]")
        return places_m

    @property
    def num_objects(self) -> int:
        """Number of objects on the table."""
        return len(self.hides)

    @property
    def occlusion(self) -> PerObject:
        """Hidden share of each object while all stand on the table: 1 − Π_j (1 − hides[i, j])."""
        return 1.0 - np.prod(1.0 - self.hides, axis=1)
