"""What was recorded: trajectories, their stages, endings and causes; checked once, kept on disk.

A *trajectory* is one episode. It ends *finished*, or *cut*: right-censored by something outside the task.

Read down: `frames` (what is accepted) → `columns` (names, types, refusals) → `schema` (the rules) → `checks` (which ask
them) → `summary`, `logs` (the record) → `breakdown`. On disk: `parquet` (what a file takes) → `folder` → `shards`,
`stream` (a log that need not fit in memory) → `joining` (many as one). While a robot runs: `journal` (lines, chained by
checksums) → `writer` → `recorded` (from events to tables) → `values`, `state` → `trajectory_recorder` → `recorder` →
`protocol` (without Python). What `halfseen inspect` finds: `plausibility`, `suspicions`. Other forms: `formats`.
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.logs.joining import Compacted, compact, write_stream
    from halfseen.logs.logs import Logs
    from halfseen.logs.recorder import LogRecorder
    from halfseen.logs.stream import LogStream, read_logs
    from halfseen.logs.summary import LogsSummary
    from halfseen.logs.trajectory_recorder import CAUSES, TrajectoryRecorder

__all__ = [
    "CAUSES",
    "Compacted",
    "LogRecorder",
    "LogStream",
    "Logs",
    "LogsSummary",
    "TrajectoryRecorder",
    "compact",
    "read_logs",
    "write_stream",
]

__getattr__ = lazy_names(
    __name__,
    {
        "CAUSES": "trajectory_recorder",
        "Compacted": "joining",
        "LogRecorder": "recorder",
        "LogStream": "stream",
        "Logs": "logs",
        "LogsSummary": "summary",
        "TrajectoryRecorder": "trajectory_recorder",
        "compact": "joining",
        "read_logs": "stream",
        "write_stream": "joining",
    },
)
