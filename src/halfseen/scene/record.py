"""Take a picture of a table: the cloud that the sensor returns, and the truth beside it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from halfseen.arrays import Image
from halfseen.perception.clouds import Cloud
from halfseen.scene.colours import colours
from halfseen.scene.stains import Surface
from halfseen.scene.table import Table, Truth, truth_of
from halfseen.scene.view import lone_depths_m, table_view
from halfseen.scene.xtion import XTION, StructuredLight, sense


@dataclass(frozen=True, eq=False)
class Capture:
    """A picture of a table.

    Parameters
    ----------
    cloud
        Organised cloud in the camera's frame; coordinates are float32 numbers, so that a file holds them exactly.
    depth_m
        The depth image that the cloud was made from [m]; NaN where nothing returned.
    truth
        What is true of the table. Perception must not see it.
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
        What the depth camera is.
    surfaces
        What is on the walls of each cup, for a cloud with colour; None for one without.

    Returns
    -------
    Capture
        The same table and seed give the same bytes.
    """
    view = table_view(table, sensor.baseline_m)
    rng = np.random.default_rng(seed)
    depth_m = sense(view, table.camera.focal_px[0], rng, sensor)
    # Colours draw last, so that depths are the same without them.
    picture = None if surfaces is None else colours(view, table.camera, surfaces, table.world_from_cup, rng)
    lifted = Cloud.from_depth(depth_m, table.camera.intrinsics, table.name, picture)
    cloud = replace(lifted, points_m=lifted.points_m.astype(np.float32).astype(np.float64))
    return Capture(cloud, depth_m, truth_of(table, lone_depths_m(table)))
