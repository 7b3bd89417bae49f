"""Recorded trajectories with their stages, endings and causes: checked once, stored on disk.

A *trajectory* is one episode. It ends *finished*, or *cut*: right-censored by something outside the task.

Reading order: `missing` (what replaces null in covariates) → `columns` (accepted input, names, types, refusals) →
`checks` (the rules) → `checked_tables` → `logs` (the record). On disk: `parquet` → `folder` → `stream` (a log in
any format, whole or in passes) → `joining` (several logs as one), `later_part`. While a robot runs: `journal` (lines,
chained by checksums) → `journal_writer` → `recorded` (from events to tables) → `recording_state` →
`trajectory_recorder` → `recorder` → `protocol` (without Python). Behind `halfseen inspect`: `plausibility`,
`data_quality`. Other formats: `formats`.
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.logs.joining import Compacted, compact, write_stream
    from halfseen.logs.logs import Logs, LogsSummary
    from halfseen.logs.recorder import LogRecorder
    from halfseen.logs.stream import LogStream, read_logs
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
        "LogsSummary": "logs",
        "TrajectoryRecorder": "trajectory_recorder",
        "compact": "joining",
        "read_logs": "stream",
        "write_stream": "joining",
    },
)
