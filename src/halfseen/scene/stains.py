"""What is on the walls of cups: stains of what was drunk from dirty ones, and glaze spots, which look alike.

All numbers are ours.
"""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from halfseen.scene.cups import Cup

Colour: TypeAlias = tuple[int, int, int]
"""Red, green and blue, 0 to 255, in full light."""


@dataclass(frozen=True)
class Stain:
    """A disc of another colour on one side of a cup's wall: what lies on that side within its radius.

    Parameters
    ----------
    angle_rad
        Where its middle is, about the cup's axis; a handle is at 0 [rad].
    height_m
        Where its middle is, above the underside [m].
    radius_m
        From its middle to its edge [m].
    is_inside
        True on the inner side of the wall.
    colour
        In full light.
    """

    angle_rad: float
    height_m: float
    radius_m: float
    is_inside: bool
    colour: Colour


@dataclass(frozen=True)
class Surface:
    """A cup and what is on its walls.

    Parameters
    ----------
    cup
        Its dimensions.
    glaze
        Its own colour in full light.
    stains
        What makes it dirty; none on a clean cup.
    spots
        Spots of the glaze, which look like stains and are none.
    """

    cup: Cup
    glaze: Colour
    stains: tuple[Stain, ...] = ()
    spots: tuple[Stain, ...] = ()

    @property
    def is_dirty(self) -> bool:
        """Whether there is a stain, in view or not."""
        return bool(self.stains)


@dataclass(frozen=True)
class SurfaceLaw:
    """How stains and glazes are drawn.

    Parameters
    ----------
    num_stains, num_spots
        Fewest and most stains of a dirty cup, and spots of any.
    stain_radius_m, spot_radius_m
        Smallest and largest radius [m].
    height_share
        Lowest and highest middle of a disc, as shares of the cup's height.
    inside_share
        How many of the discs are on the inner side.
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
        How they are drawn.
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
