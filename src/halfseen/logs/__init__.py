"""What was recorded: trajectories, their stages, endings and causes; checked once, kept on disk.

A *trajectory* is a trajectory: one episode. It ends *finished*, or *cut*: right-censored by something outside the task.

Read down: `frames` (what is accepted) → `refusal` (how a broken log is told) → `columns` (which columns, of which
types) → `reward_unit` → `checks` (the invariants) → `summary` → `parquet` (what a file takes) → `journal` (what a
recorder wrote) → `place`, `folder` (on disk) → `logs` (the record) → `reading` (whatever wrote it) → `shards`, `stream`
(a log that need not fit in memory) → `joining`, `compaction` (many folders as one). While a robot runs: `recording`.
What `halfseen inspect` tells: `inspection`. From and to other forms: `formats`.
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
