"""The physical table: cups that stand or lie, and the depth camera that half sees them.

Data go this way: `cups` (shapes) → `draw` (where they start, physics, which tables are kept) →
`view` (what an ideal camera sees) → `xtion` (what the sensor makes of it) → `stains` (what is on the walls of cups) →
`colours` (what a colour camera sees of it) → `record` (cloud and truth) → `shipped` (the ten tables that come with the
package).

MuJoCo loads when a table is drawn or seen, never when this package is imported.
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.scene.camera import Camera
    from halfseen.scene.cups import Cup
    from halfseen.scene.draw import random_table
    from halfseen.scene.poses import Pose
    from halfseen.scene.record import Capture, capture
    from halfseen.scene.shipped import read_table, read_truth, table_paths
    from halfseen.scene.stains import Stain, Surface, draw_surface
    from halfseen.scene.table import Table, Truth

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

__getattr__ = lazy_names(
    __name__,
    {
        "Camera": "camera",
        "Capture": "record",
        "Cup": "cups",
        "Pose": "poses",
        "Stain": "stains",
        "Surface": "stains",
        "Table": "table",
        "Truth": "table",
        "capture": "record",
        "draw_surface": "stains",
        "random_table": "draw",
        "read_table": "shipped",
        "read_truth": "shipped",
        "table_paths": "shipped",
    },
)
