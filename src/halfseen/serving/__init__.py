"""A policy that answers over HTTP or OPC UA: what `halfseen act` says, to a controller without a Python of its own.

Read down: `models` (what is asked and answered) → `limits` (who may ask, how much and how slowly; the server) →
`recording` (what was decided becomes the next log, and now and then it is another action, with its probability) →
`table_state` (the objects of a table, as a log has them) → `stepping_back` (where a rule decides) → `in_service` (a
policy that was read, checked and warmed) → `comparing` (which trajectories are the policy's) → `answering` (a question,
an answer) → `served` (one at a time, whatever the door) → `openapi` → `app` (the door of HTTP) and `opcua` (that of OPC
UA).
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.serving.answering import Answering
    from halfseen.serving.app import app_of
    from halfseen.serving.comparing import Comparison
    from halfseen.serving.opcua.mapping import CellMapping, read_mapping
    from halfseen.serving.opcua.wire import Wire
    from halfseen.serving.recording import RecordedTrajectories
    from halfseen.serving.served import Served

__all__ = ["Answering", "CellMapping", "Comparison", "RecordedTrajectories", "Served", "Wire", "app_of", "read_mapping"]

__getattr__ = lazy_names(
    __name__,
    {
        "Answering": "answering",
        "CellMapping": "opcua.mapping",
        "Comparison": "comparing",
        "RecordedTrajectories": "recording",
        "Served": "served",
        "Wire": "opcua.wire",
        "app_of": "app",
        "read_mapping": "opcua.mapping",
    },
)
