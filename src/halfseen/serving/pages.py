"""Descriptions and pages: OpenAPI 3.1 and a page of the addresses, and the running cell as JSON and as a page.

Slow results about the cell are computed beforehand.
"""

import base64
import hashlib
import json
from functools import partial
from typing import Any
from zlib import crc32

import msgspec
from msgspec import UNSET, Struct

import halfseen
from halfseen.logs.missing import Filling
from halfseen.policies.ranges import middle_of
from halfseen.serving import models
from halfseen.serving.in_service import InService
from halfseen.serving.models import Cell, DecisionAnswer, RecordingProgress, Schema
from halfseen.serving.served import Answering
from halfseen.serving.watching import FIGURES
from halfseen.view.templates import rendered, template, text_of
from halfseen.wording import capitalised, counted, percent, significant

JSON, FORM = "application/json", "multipart/form-data"
_REFERENCE = "#/components/schemas/"


def described(service: InService, *, is_recording: bool, is_comparing: bool = False) -> Schema:
    """Describe a server in OpenAPI.

    Parameters
    ----------
    service
        The policy that answers.
    is_recording
        Whether decisions are recorded.
    is_comparing
        Whether trajectories are dealt to the policy or to a rule.
    """
    stored = service.stored
    looks = {JSON: models.TableRequest, FORM: models.CloudRequest} if stored.is_table else {JSON: models.State}
    asked = [
        ("/decide", "post", "Decide what to do now, and say why.", models.DecisionAnswer, looks),
        ("/reward", "post", "Complete the stage in progress.", models.RecordingProgress, {JSON: models.StageReward}),
        (
            "/end",
            "post",
            "End the trajectory in progress; a cut one has a cause.",
            models.EndAnswer,
            {JSON: models.TrajectoryEnd},
        ),
        ("/reload", "post", "Read the policy's folder again.", models.Reloaded, {}),
        ("/health", "get", "Report that it runs, and its state.", models.Health, {}),
        ("/state", "get", "Return everything the page of the running cell shows.", models.Cell, {}),
        ("/comparison", "get", "Report how the policy compares with the rule.", models.Compared, {}),
    ]
    others = () if is_recording else ("/reward", "/end")
    others += () if is_comparing else ("/comparison",)
    asked = [each for each in asked if each[0] not in others]
    used = [models.Refused, *(model for *_, answer, takes in asked for model in (answer, *takes.values()))]
    _, schemas = msgspec.json.schema_components(used, ref_template=_REFERENCE + "{name}")
    if not stored.is_table:
        schemas["State"] |= _covariates(service, schemas["State"])
        schemas["DecisionAnswer"]["properties"]["action"]["enum"] = list(stored.policy.actions)
    return {
        "openapi": "3.1.0",
        "info": {"title": f"halfseen policy {service.digest}", "version": halfseen.__version__},
        "paths": {path: {how: _operation(*each)} for path, how, *each in asked},
        "components": {"schemas": schemas},
    }


def _operation(summary: str, answer: type[Struct], takes: dict[str, type[Struct]]) -> Schema:
    body = {"required": True, "content": {kind: _referred(model) for kind, model in takes.items()}}
    return {
        "summary": summary,
        **({"requestBody": body} if takes else {}),
        "responses": {
            "200": {"description": "The answer.", "content": {JSON: _referred(answer)}},
            "default": {"description": "Refused, in one line.", "content": {JSON: _referred(models.Refused)}},
        },
    }


def _referred(model: type[Struct]) -> Schema:
    return {"schema": {"$ref": _REFERENCE + model.__name__}}


def _covariates(service: InService, state: Schema) -> Schema:
    """Fields of a state: policy covariates, common fields, and the middle of the log's range as an example."""
    policy, seen = service.stored.policy, service.stored.ranges(1) or {}
    filling = policy.filling or Filling({}, 1)
    may_lack = {name for name, fill in filling.fills.items() if fill.value is not None} | {*filling.flags}
    covariates = {
        name: _covariate(policy.categories.get(name), seen.get(name), name in may_lack) for name in policy.covariates
    }
    middles = {name: middle_of(seen[name]) for name in policy.covariates if name in seen}
    required = [name for name in policy.covariates if name not in may_lack]
    example = {name: each if isinstance(each, str) else float(f"{each:.3g}") for name, each in middles.items()}
    return {"properties": covariates | state["properties"], "required": required, "examples": [example]}


def _covariate(categories: Any, seen: Any, may_lack: bool) -> Schema:
    if categories is not None:
        listed = f"{' or '.join(categories)}; for any other the rule decides."
        return {"type": ["string", "null"] if may_lack else "string", "description": listed}
    known = "" if seen is None else f", in the logs {seen[0]:.3g} to {seen[1]:.3g} at the first stage"
    kinds = ["number", "boolean", *(["null"] if may_lack else [])]
    return {"type": kinds, "description": f"A number{known}."}


def description_of(api: Schema) -> str:
    """Render a description from `halfseen.serving.pages.described` as a page."""
    content = {"title": api["info"]["title"], "paths": api["paths"], "schemas": api["components"]["schemas"]}
    return rendered("halfseen.serving", "api.html.j2", content, json=partial(json.dumps, indent=1))


TEMPLATE = "halfseen.view", "cell.html.j2"
template(*TEMPLATE)  # load it before the first request
SCRIPT = text_of("halfseen.view", "cell.js")
_DIGEST = base64.b64encode(hashlib.sha256(SCRIPT.encode()).digest()).decode()
SECURITY = (
    f"default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-{_DIGEST}'; connect-src 'self'; "
    "img-src data:; base-uri 'none'; form-action 'none'"
)
"""Content security policy: the page runs only its own script, which connects only to its server."""


def cell_of(service: InService, answering: Answering) -> Cell:
    """State of the cell; starts a new look at the log if one is due."""
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
        rule=answering.tally,
        recording=recording,
        comparison=UNSET if comparison is None else comparison.facts,
        trajectories=list(recent.trajectories),
        monitor=monitor,
    )
    revision = f"{crc32(msgspec.json.encode(cell)):08x}"
    aged = monitor and {**monitor, "age_s": age_s}
    return msgspec.structs.replace(cell, revision=revision, monitor=aged)


def _sentence(decision: DecisionAnswer | None, recording: RecordingProgress | Any, monitor: dict[str, Any]) -> str:
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
        return f"Trajectory {recording.trajectory}: stage {recording.stage} is done; waiting for the next decision."
    return f"Trajectory {recording.trajectory}, {stage}: {decision.action}, {_who(decision)}."


def _who(decision: DecisionAnswer) -> str:
    """Who decided."""
    if decision.arm == "rule":
        return "by the rule of today, to which this trajectory was assigned"
    if decision.stepped_back is not UNSET:
        return f"by the rule in the policy's place ({decision.stepped_back})"
    return "drawn to explore" if decision.is_explored else "by the policy"


def page_of(cell: Cell, answering: Answering) -> str:
    """Write the page."""
    watch = answering.recent.watch
    figures = ((watch and watch.found) or {}).get(FIGURES, {})
    content = {"cell": cell, "UNSET": UNSET, "watch": watch, "figures": figures, "script": SCRIPT}
    words: Any = {"capitalised": capitalised, "counted": counted, "percent": percent, "significant": significant}
    return rendered(*TEMPLATE, content, **words)
