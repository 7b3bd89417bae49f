"""The page of the running cell, and the same for programs; what is slow was worked out before."""

import base64
import hashlib
from typing import Any
from zlib import crc32

import msgspec
from msgspec import UNSET

from halfseen.serving.answering import Answering
from halfseen.serving.in_service import InService
from halfseen.serving.models import Cell, Decided, Progress
from halfseen.serving.watching import FIGURES
from halfseen.view.templates import rendered, template, text_of
from halfseen.wording import capitalised, counted, percent, significant

TEMPLATE = "halfseen.view", "cell.html.j2"
template(*TEMPLATE)  # no request waits for it
SCRIPT = text_of("halfseen.view", "cell.js")
_DIGEST = base64.b64encode(hashlib.sha256(SCRIPT.encode()).digest()).decode()
SECURITY = (
    f"default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-{_DIGEST}'; connect-src 'self'; "
    "img-src data:; base-uri 'none'; form-action 'none'"
)
"""The page runs its own script, which asks nobody but its server."""


def cell_of(service: InService, answering: Answering) -> Cell:
    """Say how the cell stands; the log is looked at again where it is time."""
    recent, trajectories, comparison = answering.recent, answering.trajectories, answering.comparison
    recording = UNSET if trajectories is None else trajectories.facts
    monitor, age_s = None, None
    if recent.watch is not None:
        recent.watch.look()
        found, age_s = recent.watch.found, recent.watch.age_s
        monitor = found and {name: each for name, each in found.items() if name != FIGURES}
    cell = Cell(
        sentence=_sentence(recent.decision, recording, monitor or {}),
        revision="",
        policy=service.digest,
        decision=recent.decision,
        seen=dict(recent.seen),
        rule=answering.tally.facts,
        recording=recording,
        comparison=UNSET if comparison is None else comparison.facts,
        trajectories=list(recent.trajectories),
        monitor=monitor,
    )
    revision = f"{crc32(msgspec.json.encode(cell)):08x}"
    aged = monitor and {**monitor, "age_s": age_s}
    return msgspec.structs.replace(cell, revision=revision, monitor=aged)


def _sentence(decision: Decided | None, recording: Progress | Any, monitor: dict[str, Any]) -> str:
    if monitor.get("is_alarm"):
        return monitor["sentence"]
    if decision is None:
        return "No decision yet."
    stage = f"stage {decision.stage} of {decision.horizon}"
    if recording is UNSET:
        return f"{capitalised(stage)}: {decision.action}, {_who(decision)}."
    if recording.trajectory is None:
        return "No trajectory is in progress."
    if recording.waits_for == "decision":
        return f"Trajectory {recording.trajectory}: stage {recording.stage} is done, the next decision is awaited."
    return f"Trajectory {recording.trajectory}, {stage}: {decision.action}, {_who(decision)}."


def _who(decision: Decided) -> str:
    """By whom."""
    if decision.arm == "rule":
        return "by the rule of today, to which this trajectory was dealt"
    if decision.stepped_back is not UNSET:
        return f"by the rule in the policy's place ({decision.stepped_back})"
    return "drawn to explore" if decision.is_explored else "by the policy"


def page_of(cell: Cell, answering: Answering) -> str:
    """Write the page."""
    watch = answering.recent.watch
    figures = ((watch and watch.found) or {}).get(FIGURES, {})
    content = {"cell": cell, "UNSET": UNSET, "watch": watch, "figures": figures, "script": SCRIPT}
    words = {"counted": counted, "percent": percent, "significant": significant}
    return rendered(*TEMPLATE, content, **words)
