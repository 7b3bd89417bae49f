"""What was recorded: trajectories, their stages, endings and causes; checked once, kept on disk.

A *path* is a trajectory: one episode. It ends *finished*, or *cut*: right-censored by something outside the task.

Read down: `frames` (what is accepted) → `refusal` (how a broken log is told) → `columns` (which columns, of which
types) → `path_checks`, `stage_checks`, `object_checks` (the invariants) → `summary` → `journal`, `journal_tables`
(what a recorder wrote) → `folder` (on disk) → `logs` (the record) → `reading` (whatever wrote it) → `stream` (a log
that need not fit in memory) → `compaction` (many folders as one). While a robot runs: `journal_values`, `path_clock` →
`recorded` → `durability`, `journal_writer` → `path_recorder` → `recorder` → `line_protocol` → `line_socket`. What
`halfseen inspect` tells: `breakdown`, `suspicious_units` → `suspicions`.
`formats`: from and to other forms.
"""

from halfseen.logs.compaction import Compacted, compact
from halfseen.logs.logs import Logs
from halfseen.logs.path_recorder import CAUSES, PathRecorder
from halfseen.logs.reading import read_logs
from halfseen.logs.recorder import LogRecorder
from halfseen.logs.stream import LogStream, write_stream
from halfseen.logs.summary import LogsSummary

__all__ = [
    "CAUSES",
    "Compacted",
    "LogRecorder",
    "LogStream",
    "Logs",
    "LogsSummary",
    "PathRecorder",
    "compact",
    "read_logs",
    "write_stream",
]
