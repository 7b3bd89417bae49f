"""A policy that answers over HTTP or OPC UA: what `halfseen act` says, to a controller without a Python of its own.

Read down: `models` (what is asked and answered) → `limits` (who may ask, how much and how slowly; the server) →
`recording` (what was decided becomes the next log, and now and then it is another action, with its probability) →
`in_service` (a policy that was read, checked and warmed, and the rule in its place) → `comparing` (which trajectories
are the policy's) → `questions` (what is asked about) → `watching` (the log, held against the promise) → `served` (one
answer at a time, whatever the door) → `pages` → `app` (the door of HTTP) and `opcua` (that of OPC UA).
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.serving.app import app_of
    from halfseen.serving.comparing import Comparison
    from halfseen.serving.opcua.mapping import CellMapping, read_mapping
    from halfseen.serving.opcua.wire import Wire
    from halfseen.serving.recording import RecordedTrajectories
    from halfseen.serving.served import Answering, Served

__all__ = ["Answering", "CellMapping", "Comparison", "RecordedTrajectories", "Served", "Wire", "app_of", "read_mapping"]

__getattr__ = lazy_names(
    __name__,
    {
        "Answering": "served",
        "CellMapping": "opcua.mapping",
        "Comparison": "comparing",
        "RecordedTrajectories": "recording",
        "Served": "served",
        "Wire": "opcua.wire",
        "app_of": "app",
        "read_mapping": "opcua.mapping",
    },
)
