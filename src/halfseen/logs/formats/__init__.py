"""Logs in other formats: CSV, any table, databases, bags, MCAP, and datasets of Minari, LeRobot, RLDS and D4RL.

Reading order: `as_text` (columns as text, and what a format cannot store) → `csv_folder` → `older` (logs of version 1)
→ `mapping` (files that map topics) → `sql_rows` → `steps` (steps of other datasets as stages) → `nested_steps`,
`partitions`, `step_tables` → `lerobot_folder` → `array_doubts`, `step_arrays` → `minari` → `bag_files`, `bag_fields`,
`bag_messages`, `bags` → `table_mapping`, `workbooks`, `table_cells`, `table_values`, `wide_tables`, `ending_flags`,
`event_doubts`, `event_tables` (any table, by a mapping as for bags) → `guesses`, `event_template` (a draft of that
mapping). Optional libraries load on first use.
"""

from halfseen.logs.formats.as_text import Loss, losses
from halfseen.logs.formats.bags import read_bag
from halfseen.logs.formats.csv_folder import read_csv, write_csv
from halfseen.logs.formats.event_tables import read_event_table
from halfseen.logs.formats.event_template import mapping_of
from halfseen.logs.formats.lerobot_folder import read_lerobot
from halfseen.logs.formats.mapping import MAPPING_TEMPLATE, BagMapping, read_mapping
from halfseen.logs.formats.minari import read_minari, seen_by_halfseen_alone, write_minari
from halfseen.logs.formats.older import is_older, read_older
from halfseen.logs.formats.sql_rows import Queries, read_queries, read_sql
from halfseen.logs.formats.step_arrays import read_step_arrays
from halfseen.logs.formats.step_tables import read_steps
from halfseen.logs.formats.steps import StepRules
from halfseen.logs.formats.table_mapping import EventMapping, read_event_mapping

__all__ = [
    "MAPPING_TEMPLATE",
    "BagMapping",
    "EventMapping",
    "Loss",
    "Queries",
    "StepRules",
    "is_older",
    "losses",
    "mapping_of",
    "read_bag",
    "read_csv",
    "read_event_mapping",
    "read_event_table",
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
