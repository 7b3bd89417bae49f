"""Logs in other forms: CSV folders, databases, bags, MCAP files, and datasets of Minari, LeRobot, RLDS and D4RL.

Read down: `column_types` (what a column is, its cells as text, and what a form cannot hold) → `csv_folder` → `older`
(logs of version 1) → `sql_rows` → `steps` (steps of others, column by column, as stages) → `minari_steps`,
`minari_dataset` → `step_tables` → `lerobot_folder` → `step_arrays` → `bag_mapping`, `mcap_files`, `bag_messages`,
`bags`. The libraries of Minari, HDF5, MCAP, ROS and SQL are `extras`; they load when they are used.
"""

from halfseen.logs.formats.bag_mapping import MAPPING_TEMPLATE, BagMapping, read_mapping
from halfseen.logs.formats.bags import read_bag
from halfseen.logs.formats.column_types import Loss, losses
from halfseen.logs.formats.csv_folder import read_csv, write_csv
from halfseen.logs.formats.lerobot_folder import read_lerobot
from halfseen.logs.formats.minari_dataset import read_minari, write_minari
from halfseen.logs.formats.minari_steps import seen_by_halfseen_alone
from halfseen.logs.formats.older import is_older, read_older
from halfseen.logs.formats.sql_rows import Queries, read_queries, read_sql
from halfseen.logs.formats.step_arrays import read_step_arrays
from halfseen.logs.formats.step_tables import read_steps
from halfseen.logs.formats.steps import StepRules

__all__ = [
    "MAPPING_TEMPLATE",
    "BagMapping",
    "Loss",
    "Queries",
    "StepRules",
    "is_older",
    "losses",
    "read_bag",
    "read_csv",
    "read_lerobot",
    "read_mapping",
    "read_minari",
    "read_older",
    "read_queries",
    "read_sql",
    "read_step_arrays",
    "read_steps",
    "seen_by_halfseen_alone",
    "write_csv",
    "write_minari",
]
