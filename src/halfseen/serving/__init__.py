"""A policy that answers over HTTP: what `halfseen act` says, to whatever controller asks, without a Python of its own.

Read down: `refusal` (what is said where a request is refused) → `in_service` (a policy that is warm) → `exploring` (now
and then another action, with its probability) → `trajectories` (what was decided becomes the next log) → `table_state`,
`seen` (requests → what a policy decides from, and what is recorded of it) → `answering` (a question, an answer) →
`openapi`, `page` (what can be asked, for programs and for people) → `bounds` (who may ask, how much and how slowly) →
`forms`, `hang_up`, `app` → `server`.
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.serving.answering import Answering
    from halfseen.serving.app import Served, app_of
    from halfseen.serving.trajectories import RecordedTrajectories

__all__ = ["Answering", "RecordedTrajectories", "Served", "app_of"]

__getattr__ = lazy_names(
    __name__,
    {"Answering": "answering", "RecordedTrajectories": "trajectories", "Served": "app", "app_of": "app"},
)
