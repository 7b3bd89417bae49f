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

_NAMES = {
    "app": "app_of",
    "comparing": "LiveComparison",
    "opcua.mapping": "CellMapping read_mapping",
    "opcua.wire": "Wire",
    "recording": "RecordedTrajectories",
    "served": "Answering Served",
}
__getattr__ = lazy_names(__name__, {name: module for module, names in _NAMES.items() for name in names.split()})
