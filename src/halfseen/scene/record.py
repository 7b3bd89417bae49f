"""Take a picture of a table: the sensor's cloud, its colours, and the truth.

A colour camera sees shaded glazes with stains and spots, and pixel noise. All numbers are our own choice.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from halfseen.arrays import Image, Points
from halfseen.errors import SceneError
from halfseen.perception.clouds import Cloud, Picture
from halfseen.scene.cups import Colour, Cup, Stain, Surface
from halfseen.scene.poses import Pose
from halfseen.scene.table import Camera, Table, Truth, truth_of
from halfseen.scene.view import IdealView, lone_depths_m, table_view
from halfseen.scene.xtion import XTION, StructuredLight, sense
from halfseen.shapes import Bool, Float

_HANDLE_M = 0.0015  # points farther than this outside the wall belong to the handle


@dataclass(frozen=True)
class ColourCamera:
    """Model of a colour camera.

    Parameters
    ----------
    furniture, dark
        Colours of the room, and of pixels that show neither room nor cup: robots, or nothing.
    ambient_share
        Brightness of a surface at a grazing angle, relative to perpendicular view.
    noise
        Standard deviation of each channel of a pixel, of 255.
    """

    furniture: Colour = (150, 150, 152)
    dark: Colour = (25, 25, 28)
    ambient_share: float = 0.55
    noise: float = 4.0


COLOUR_CAMERA = ColourCamera()


def colours(
    view: IdealView,
    camera: Camera,
    surfaces: Sequence[Surface],
    world_from_cup: Sequence[Pose],
    rng: np.random.Generator,
    colour_camera: ColourCamera = COLOUR_CAMERA,
) -> Picture:
    """Take a colour picture of an ideal view.

    Parameters
    ----------
    view
        The ideal view.
    camera
        Its camera.
    surfaces, world_from_cup
        Each cup with its stains and spots, and its pose.
    rng
        Source of the noise.
    colour_camera
        Model of the colour camera.

    Returns
    -------
    numpy.ndarray
        Red, green and blue of each pixel.

    Raises
    ------
    SceneError
        The numbers of surfaces and cups differ.
    """
    if len(surfaces) != len(world_from_cup):
        raise SceneError(f"colours: {len(surfaces)} surfaces and {len(world_from_cup)} cups; give one for every cup")
    picture = np.full((*view.body.shape, 3), colour_camera.dark, dtype=np.float64)
    picture[view.body == 0] = colour_camera.furniture
    rays = camera.pixel_rays()
    for index, (surface, pose) in enumerate(zip(surfaces, world_from_cup, strict=True)):
        shown = view.labels == index
        points_m = camera.world_from_camera.apply(rays[shown] * view.depth_m[shown][:, None])
        picture[shown] = painted(surface, pose.apply_inverse(points_m))
    cosine = np.nan_to_num(view.incidence_cosine)
    light = colour_camera.ambient_share + (1 - colour_camera.ambient_share) * cosine
    noise = colour_camera.noise * rng.standard_normal(picture.shape)
    return np.clip(np.rint(picture * light[..., None] + noise), 0, 255).astype(np.uint8)


def painted(surface: Surface, points_m: Points) -> Float[np.ndarray, "n 3"]:
    """Colour of points of a cup, in its own frame [m], in full light; stains cover spots."""
    colour = np.full((len(points_m), 3), surface.glaze, dtype=np.float64)
    for disc in (*surface.spots, *surface.stains):
        colour[is_within(disc, surface.cup, points_m)] = disc.colour
    return colour


def is_within(disc: Stain, cup: Cup, points_m: Points) -> Bool[np.ndarray, " n"]:
    """Whether points of a cup lie in a disc, on its side of the wall; points of the handle lie in none.

    Points are in the cup's own frame [m].
    """
    radius_m, height_m = np.hypot(points_m[:, 0], points_m[:, 1]), points_m[:, 2]
    wall_m = cup.radius_at(height_m)
    is_inside = (radius_m < wall_m - cup.wall_m / 2) & (height_m > cup.bottom_m / 2)
    is_handle = radius_m > wall_m + _HANDLE_M
    is_near = np.linalg.norm(points_m - middle_m(disc, cup), axis=1) < disc.radius_m
    return is_near & (is_inside == disc.is_inside) & ~is_handle


def middle_m(disc: Stain, cup: Cup) -> Float[np.ndarray, "3"]:
    """Centre of a disc, on its side of the wall, in the cup's frame [m]."""
    radius_m = cup.radius_at(disc.height_m) - (cup.wall_m if disc.is_inside else 0.0)
    return np.array([radius_m * np.cos(disc.angle_rad), radius_m * np.sin(disc.angle_rad), disc.height_m])


@dataclass(frozen=True, eq=False)
class Capture:
    """A picture of a table.

    Parameters
    ----------
    cloud
        Organised cloud in the camera's frame; coordinates are float32 numbers, so that a file stores them exactly.
    depth_m
        The depth image that the cloud was made from [m]; NaN where nothing returned.
    truth
        Ground truth of the table. Perception must not use it.
    """

    cloud: Cloud
    depth_m: Image
    truth: Truth


def capture(
    table: Table, seed: int, sensor: StructuredLight = XTION, surfaces: Sequence[Surface] | None = None
) -> Capture:
    """Look at a table with the depth camera.

    Parameters
    ----------
    table
        The table.
    seed
        Seed of the sensor's noise.
    sensor
        Model of the depth camera.
    surfaces
        Glaze, stains and spots of each cup, for a cloud with colour; None for one without.

    Returns
    -------
    Capture
        The same table and seed give the same bytes.
    """
    view = table_view(table, sensor.baseline_m)
    rng = np.random.default_rng(seed)
    depth_m = sense(view, table.camera.focal_px[0], rng, sensor)
    # Colours are drawn last, so that depths do not depend on them.
    picture = None if surfaces is None else colours(view, table.camera, surfaces, table.world_from_cup, rng)
    lifted = Cloud.from_depth(depth_m, table.camera.intrinsics, table.name, picture)
    cloud = replace(lifted, points_m=lifted.points_m.astype(np.float32).astype(np.float64))
    return Capture(cloud, depth_m, truth_of(table, lone_depths_m(table)))
