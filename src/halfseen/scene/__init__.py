"""The physical table: cups that stand or lie, partly visible to a depth camera.

Data flow: `cups` (shapes, stains and spots) → `draw` (initial poses, physics, acceptance of tables) → `view` (the room,
and the view of an ideal camera) → `xtion` (the sensor's depth image) → `record` (colours, cloud and truth) → `shipped`
(the ten tables that come with the package).

MuJoCo is imported when a table is drawn or viewed, not when this package is imported.
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.scene.cups import Cup, Stain, Surface, draw_surface
    from halfseen.scene.draw import random_table
    from halfseen.scene.poses import Pose
    from halfseen.scene.record import Capture, capture
    from halfseen.scene.shipped import read_table, read_truth, table_paths
    from halfseen.scene.table import Camera, Table, Truth

__all__ = [
    "Camera",
    "Capture",
    "Cup",
    "Pose",
    "Stain",
    "Surface",
    "Table",
    "Truth",
    "capture",
    "draw_surface",
    "random_table",
    "read_table",
    "read_truth",
    "table_paths",
]

_NAMES = {
    "cups": "Cup Stain Surface draw_surface",
    "draw": "random_table",
    "poses": "Pose",
    "record": "Capture capture",
    "shipped": "read_table read_truth table_paths",
    "table": "Camera Table Truth",
}
__getattr__ = lazy_names(__name__, {name: module for module, names in _NAMES.items() for name in names.split()})
