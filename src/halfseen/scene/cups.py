"""Cups: open hollow vessels, some with a handle; and the stains and spots on their walls.

A cup's own frame has its origin in the middle of the underside and z towards the mouth; a handle points along x.
Dirty cups have stains from drinks. Any cup may have glaze spots, which look alike. All numbers of stains are our own
choice.
"""

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from halfseen.errors import SceneError
from halfseen.shapes import Float, Int

# Facets around a cup: few enough to be fast, enough for rays to graze it where they would graze a round wall.
NUM_AROUND = 96
_NUM_ALONG_HANDLE = 12
_NUM_AROUND_HANDLE = 8

Vertices = Float[np.ndarray, "vertices 3"]
Faces = Int[np.ndarray, "faces 3"]


@dataclass(frozen=True)
class Cup:
    """The dimensions of a cup.

    Parameters
    ----------
    height_m
        From underside to rim [m].
    rim_radius_m
        Outer radius at the mouth [m].
    base_radius_m
        Outer radius at the underside [m].
    wall_m
        Thickness of the wall [m].
    bottom_m
        Thickness of the bottom [m].
    handle_m
        Reach of the handle from the wall [m]; 0 for a cup without one.

    Raises
    ------
    SceneError
        A dimension is not positive, or the wall or the bottom leaves no hollow.
    """

    height_m: float
    rim_radius_m: float
    base_radius_m: float
    wall_m: float = 0.003
    bottom_m: float = 0.005
    handle_m: float = 0.0

    def __post_init__(self) -> None:
        for name in ("height_m", "rim_radius_m", "base_radius_m", "wall_m", "bottom_m"):
            if not getattr(self, name) > 0:
                raise SceneError(f"cup: {name} is {getattr(self, name)}; every dimension is a positive length")
        if not self.handle_m >= 0:
            raise SceneError(f"cup: handle_m is {self.handle_m}; give 0 for a cup without a handle")
        if self.wall_m >= min(self.rim_radius_m, self.base_radius_m) or self.bottom_m >= self.height_m:
            raise SceneError(f"cup: {self} has no hollow; make the wall and the bottom thinner")

    def radius_at(self, z_m: Any) -> Any:
        """Outer radius at a height above the underside, or at each of several [m]."""
        return self.base_radius_m + (self.rim_radius_m - self.base_radius_m) * z_m / self.height_m


def body_mesh(cup: Cup) -> tuple[Vertices, Faces]:
    """Build the closed surface of the vessel: outside, rim, inside and bottom.

    Vertices are in the cup's frame [m], and triangles face outward.
    """
    profile_m = [
        (cup.base_radius_m, 0.0),
        (cup.rim_radius_m, cup.height_m),
        (cup.rim_radius_m - cup.wall_m, cup.height_m),
        (cup.radius_at(cup.bottom_m) - cup.wall_m, cup.bottom_m),
    ]
    angles = 2 * np.pi * np.arange(NUM_AROUND) / NUM_AROUND
    rings = np.array(
        [np.stack([r * np.cos(angles), r * np.sin(angles), np.full(NUM_AROUND, z)], 1) for r, z in profile_m]
    )
    poles = np.array([[0.0, 0.0, 0.0], [0.0, 0.0, cup.bottom_m]])
    return _tube(rings, poles)


def handle_bow(cup: Cup, num_points: int) -> tuple[Vertices, float]:
    """Centre line of the bent bar of a handle, from its lower end in the wall to its upper one, and its radius [m]."""
    radius_m = 0.16 * cup.handle_m
    bend = np.linspace(-np.pi / 2, np.pi / 2, num_points)
    z_m = 0.52 * cup.height_m + 0.28 * cup.height_m * np.sin(bend)
    x_m = cup.radius_at(z_m) - cup.wall_m / 2 + (cup.handle_m - radius_m) * np.cos(bend)
    return np.stack([x_m, np.zeros(num_points), z_m], axis=1), radius_m


def handle_mesh(cup: Cup) -> tuple[Vertices, Faces]:
    """Build the closed surface of the handle, a bent round bar whose ends sit in the wall.

    Vertices are in the cup's frame [m], and triangles face outward; ``handle_m > 0``.
    """
    if cup.handle_m <= 0:
        raise SceneError(f"cup: handle_m is {cup.handle_m}, so there is no handle to build; give a cup that has one")
    bow_m, bar_radius_m = handle_bow(cup, _NUM_ALONG_HANDLE)
    x_m, z_m = bow_m[:, 0], bow_m[:, 2]
    outward = np.stack([np.gradient(z_m), -np.gradient(x_m)], 1)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    around = 2 * np.pi * np.arange(_NUM_AROUND_HANDLE) / _NUM_AROUND_HANDLE
    along_x = x_m[:, None] + bar_radius_m * np.cos(around) * outward[:, :1]
    along_z = z_m[:, None] + bar_radius_m * np.cos(around) * outward[:, 1:]
    along_y = np.broadcast_to(bar_radius_m * np.sin(around), along_x.shape)
    poles = np.array([[x_m[0], 0.0, z_m[0]], [x_m[-1], 0.0, z_m[-1]]])
    return _tube(np.stack([along_x, along_y, along_z], 2), poles)


def outline(cup: Cup) -> Vertices:
    """List the vertices of the whole cup, handle included, in its own frame [m]."""
    vertices = body_mesh(cup)[0]
    return vertices if cup.handle_m == 0 else np.concatenate([vertices, handle_mesh(cup)[0]])


def _tube(rings: Float[np.ndarray, "rings around 3"], poles: Float[np.ndarray, "2 3"]) -> tuple[Vertices, Faces]:
    """Join rings of equal size into a closed surface, with a pole at either end."""
    num_rings, num_around, _ = rings.shape
    start, end = num_rings * num_around, num_rings * num_around + 1
    here = np.arange(num_around)
    after = np.roll(here, -1)
    faces = [np.stack([np.full(num_around, start), after, here], 1)]
    for ring in range(num_rings - 1):
        low, high = ring * num_around, (ring + 1) * num_around
        faces.append(np.stack([low + here, low + after, high + after], 1))
        faces.append(np.stack([low + here, high + after, high + here], 1))
    last = (num_rings - 1) * num_around
    faces.append(np.stack([last + here, last + after, np.full(num_around, end)], 1))
    return np.concatenate([rings.reshape(-1, 3), poles]), np.concatenate(faces)


Colour: TypeAlias = tuple[int, int, int]
"""Red, green and blue, 0 to 255, in full light."""


@dataclass(frozen=True)
class Stain:
    """A disc of another colour on one side of a cup's wall.

    Parameters
    ----------
    angle_rad
        Angle of its centre about the cup's axis; a handle is at 0 [rad].
    height_m
        Height of its centre above the underside [m].
    radius_m
        Radius [m].
    is_inside
        True on the inner side of the wall.
    colour
        Colour in full light.
    """

    angle_rad: float
    height_m: float
    radius_m: float
    is_inside: bool
    colour: Colour


@dataclass(frozen=True)
class Surface:
    """A cup with its glaze, stains and spots.

    Parameters
    ----------
    cup
        Its dimensions.
    glaze
        Colour of the cup in full light.
    stains
        Stains; a cup is dirty if it has any.
    spots
        Spots of the glaze, which look like stains.
    """

    cup: Cup
    glaze: Colour
    stains: tuple[Stain, ...] = ()
    spots: tuple[Stain, ...] = ()

    @property
    def is_dirty(self) -> bool:
        """Whether there is a stain, visible or not."""
        return bool(self.stains)


@dataclass(frozen=True)
class SurfaceLaw:
    """Distribution of stains, spots and glazes.

    Parameters
    ----------
    num_stains, num_spots
        Fewest and most stains of a dirty cup, and spots of any cup.
    stain_radius_m, spot_radius_m
        Smallest and largest radius [m].
    height_share
        Lowest and highest centre of a disc, as shares of the cup's height.
    inside_share
        Share of the discs on the inner side.
    glazes
        Glazes to draw from.
    stain_colours, spot_colours
        Colours to draw from.
    """

    num_stains: tuple[int, int] = (1, 3)
    num_spots: tuple[int, int] = (0, 2)
    stain_radius_m: tuple[float, float] = (0.006, 0.014)
    spot_radius_m: tuple[float, float] = (0.002, 0.005)
    height_share: tuple[float, float] = (0.1, 0.95)
    inside_share: float = 0.5
    glazes: tuple[Colour, ...] = (
        (238, 236, 230),  # white
        (228, 214, 184),  # cream
        (70, 105, 165),  # blue
        (110, 150, 120),  # green
        (175, 60, 55),  # red
        (120, 125, 130),  # grey
    )
    stain_colours: tuple[Colour, ...] = ((98, 62, 30), (74, 46, 24), (124, 84, 44))  # tea, coffee, cocoa
    spot_colours: tuple[Colour, ...] = ((110, 76, 44), (88, 60, 36))  # iron in the glaze


SURFACES = SurfaceLaw()


def draw_surface(cup: Cup, is_dirty: bool, rng: np.random.Generator, law: SurfaceLaw = SURFACES) -> Surface:
    """Draw the glaze of a cup, its stains if it is dirty, and the spots that any cup may have.

    Parameters
    ----------
    cup
        The cup.
    is_dirty
        Whether it has stains.
    rng
        Source of randomness.
    law
        Their distribution.
    """
    glaze = law.glazes[rng.integers(len(law.glazes))]
    num_stains = int(rng.integers(law.num_stains[0], law.num_stains[1] + 1)) if is_dirty else 0
    num_spots = int(rng.integers(law.num_spots[0], law.num_spots[1] + 1))
    stains = tuple(_draw(cup, law.stain_radius_m, law.stain_colours, rng, law) for _ in range(num_stains))
    spots = tuple(_draw(cup, law.spot_radius_m, law.spot_colours, rng, law) for _ in range(num_spots))
    return Surface(cup, glaze, stains, spots)


def _draw(
    cup: Cup, radius_m: tuple[float, float], colours: tuple[Colour, ...], rng: np.random.Generator, law: SurfaceLaw
) -> Stain:
    return Stain(
        angle_rad=float(rng.uniform(-np.pi, np.pi)),
        height_m=float(rng.uniform(*law.height_share)) * cup.height_m,
        radius_m=float(rng.uniform(*radius_m)),
        is_inside=bool(rng.random() < law.inside_share),
        colour=colours[rng.integers(len(colours))],
    )
