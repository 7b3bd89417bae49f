"""Logs in other forms: CSV folders, Minari datasets, ROS bags.

Read down: `column_types` (what a column is, and its cells as text) → `csv_folder` → `minari_steps`, `minari_foreign`,
`minari_dataset` → `ros_mapping`, `ros_messages`, `ros_paths`, `ros_bag`. Minari and rosbags are `extras`; they load
when they are used.
"""

from halfseen.logs.formats.csv_folder import read_csv, write_csv
from halfseen.logs.formats.minari_dataset import read_minari, write_minari
from halfseen.logs.formats.ros_bag import read_bag
from halfseen.logs.formats.ros_mapping import MAPPING_TEMPLATE, BagMapping, read_mapping

__all__ = [
    "MAPPING_TEMPLATE",
    "BagMapping",
    "read_bag",
    "read_csv",
    "read_mapping",
    "read_minari",
    "write_csv",
    "write_minari",
]
