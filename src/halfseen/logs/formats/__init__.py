"""Logs in other forms: CSV folders, Minari datasets, ROS 2 bags.

Read down: `column_types` (what a column is, and its cells as text) → `placing` (a folder is there whole or not at all)
→ `csv_folder` → `minari_steps`, `minari_dataset` → `ros_mapping`, `ros_messages`, `ros_bag`. Minari and rosbags are
extras; they load when they are used.
"""

from importlib import import_module
from typing import Any

_HOMES = {
    "read_csv": "csv_folder",
    "write_csv": "csv_folder",
    "read_minari": "minari_dataset",
    "write_minari": "minari_dataset",
    "read_bag": "ros_bag",
    "read_mapping": "ros_mapping",
    "MAPPING_TEMPLATE": "ros_mapping",
}

__all__ = [  # noqa: F822  resolved below, at first use
    "MAPPING_TEMPLATE",
    "read_bag",
    "read_csv",
    "read_mapping",
    "read_minari",
    "write_csv",
    "write_minari",
]


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
