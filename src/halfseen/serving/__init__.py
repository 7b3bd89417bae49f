"""A policy that answers over HTTP or OPC UA: the decisions of `halfseen act`, for a controller without Python.

Reading order: `models` (requests and answers) → `limits` (access, size and time limits; the server) → `recording`
(decisions become the next log) → `in_service` (a policy that was read, checked and warmed up, and its fallback rule) →
`comparing` (which trajectories are the policy's) → `questions` (the states to decide on) → `watching` (the log against
the promise) → `served` (one answer at a time, over either protocol) → `pages` → `app` (HTTP) and `opcua` (OPC UA).
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.serving.app import app_of
    from halfseen.serving.comparing import LiveComparison
    from halfseen.serving.opcua.mapping import CellMapping, read_mapping
    from halfseen.serving.opcua.wire import Wire
    from halfseen.serving.recording import RecordedTrajectories
    from halfseen.serving.served import Answering, Served

__all__ = [
    "Answering",
    "CellMapping",
    "LiveComparison",
    "RecordedTrajectories",
    "Served",
    "Wire",
    "app_of",
    "read_mapping",
]

__getattr__ = lazy_names(
    __name__,
    {
        "Answering": "served",
        "CellMapping": "opcua.mapping",
        "LiveComparison": "comparing",
        "RecordedTrajectories": "recording",
        "Served": "served",
        "Wire": "opcua.wire",
        "app_of": "app",
        "read_mapping": "opcua.mapping",
    },
)
