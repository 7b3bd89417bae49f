"""What can be asked: for programs OpenAPI 3.1, made from the policy that answers; for people a page without scripts."""

import json
from html import escape
from importlib.resources import files
from typing import Any

import halfseen
from halfseen.policies.ranges import middle_of
from halfseen.serving.answering import InService

Schema = dict[str, Any]

_NUMBER: Schema = {"type": "number"}
_TEXT: Schema = {"type": "string"}
_HELD = {
    "type": "boolean",
    "description": "Of clouds: whether the WASH or LIFT held. Without it, a WASH did if its object is gone, and a LIFT "
    "is not counted.",
}
_ELAPSED = {
    **_NUMBER,
    "description": "Seconds since the trajectory began; always or never. Without it, the server's clock.",
}


def described(service: InService, *, is_recording: bool) -> Schema:
    """Describe what a server answers.

    Parameters
    ----------
    service
        The policy that answers.
    is_recording
        Whether what is decided is recorded.
    """
    decide, reload = _post("Decide what to do now, and say why.", _asked(service), _decision(service)), _reloaded()
    recorded = {"/reward": _rewarded(service), "/end": _ended()} if is_recording else {}
    addresses = {"/decide": decide, **recorded, "/reload": reload, "/health": _health()}
    return {
        "openapi": "3.1.0",
        "info": {"title": f"halfseen policy {service.digest}", "version": halfseen.__version__},
        "paths": addresses,
    }


def _asked(service: InService) -> Schema:
    """What `/decide` takes, by content type."""
    stored = service.stored
    stage = {"type": "integer", "minimum": 1, "maximum": stored.horizon, "description": "The stage to decide, from 1."}
    if stored.is_table:
        told = "One for each object on the table, with the columns that a stage of a log has."
        objects = {"type": "array", "minItems": 1, "items": {"type": "object"}, "description": told}
        file: Schema = {"type": "string", "contentMediaType": "application/octet-stream"}
        labels = {**file, "description": "What looks dirty, as halfseen look --labels takes it: .csv or .json."}
        form = {"cloud": {**file, "description": "What the camera sees: .pcd, .ply or .npz."}, "labels": labels}
        form |= {"stage": stage}
        return {
            "application/json": {"schema": _object({"objects": objects, "stage": stage}, ["objects"])},
            "multipart/form-data": {"schema": _object(form, ["cloud"])},
        }
    policy, seen = stored.policy, stored.ranges(1) or {}
    covariates: Schema = {
        name: {"enum": list(policy.categories[name])} if name in policy.categories else _seen(seen.get(name))
        for name in policy.covariates
    }
    example = {name: _short(middle_of(seen[name])) for name in policy.covariates if name in seen}
    schema = _object({**covariates, "stage": stage}, list(policy.covariates))
    return {"application/json": {"schema": schema, "example": example}}


def _short(value: float | str) -> float | str:
    """A number as people write one."""
    return value if isinstance(value, str) else float(f"{value:.3g}")


def _seen(seen: Any) -> Schema:
    told = {} if seen is None else {"description": f"In the logs {seen[0]:.3g} to {seen[1]:.3g} at the first stage."}
    return {**_NUMBER, **told}


def _decision(service: InService) -> Schema:
    values = {"type": "object", "additionalProperties": {"type": ["number", "null"]}}
    stored = service.stored
    actions = {} if stored.is_table else {"enum": list(stored.policy.actions)}
    in_log = {"verb": _TEXT, "object": {"description": "As the log names it."}} if stored.is_table else {}
    return _object(
        {
            "action": actions or _TEXT,
            **in_log,
            "probability": {**_NUMBER, "description": "With which this action was taken."},
            "is_explored": {"type": "boolean", "description": "Whether it was drawn to explore."},
            "stage": {"type": "integer"},
            "q_values": {**values, "description": "What the policy goes by; null where not possible."},
            "reason": _TEXT,
            "warnings": {"type": "array", "items": _TEXT},
            "policy": {**_TEXT, "description": "Digest of the policy that decided."},
        },
        ["action", "probability", "is_explored", "stage", "q_values", "reason", "warnings", "policy"],
    )


def _rewarded(service: InService) -> Schema:
    held = {"held": _HELD} if service.stored.is_table else {}
    reward = {**_NUMBER, "description": "Of the stage, in the unit of the log."}
    body = _object({"reward": reward, "elapsed_s": _ELAPSED, **held}, ["reward"])
    return _post("Complete the stage in progress.", {"application/json": {"schema": body}}, {"type": "object"})


def _ended() -> Schema:
    cause = {**_TEXT, "description": "What cut it, such as operator; with cut alone."}
    ending = {"enum": ["finished", "cut"], "description": "Whether the trajectory came to its own end."}
    properties = {"ending": ending, "cause": cause, "elapsed_s": _ELAPSED}
    body = {"application/json": {"schema": _object(properties, ["ending"])}}
    return _post("End the trajectory in progress; what was cut has a cause.", body, {"type": "object"})


def _reloaded() -> Schema:
    answer = _object({"policy": _TEXT}, ["policy"])
    return {"post": {"summary": "Read the policy's folder again.", "responses": _responses(answer)}}


def _health() -> Schema:
    answer = _object({"status": _TEXT, "policy": _TEXT, "kind": _TEXT}, ["status", "policy", "kind"])
    return {"get": {"summary": "Say that it answers, and what.", "responses": _responses(answer)}}


def _post(summary: str, content: Schema, answer: Schema) -> Schema:
    body = {"required": True, "content": content}
    return {"post": {"summary": summary, "requestBody": body, "responses": _responses(answer)}}


def _responses(answer: Schema) -> Schema:
    refused = {"schema": _object({"error": _TEXT}, ["error"])}
    return {
        "200": {"description": "The answer.", "content": {"application/json": {"schema": answer}}},
        "4XX": {"description": "Refused, in one line.", "content": {"application/json": refused}},
    }


def _object(properties: Schema, required: list[str]) -> Schema:
    return {"type": "object", "properties": properties, "required": required}


def page_of(api: dict[str, Any]) -> str:
    """Write the page of what `halfseen.serving.openapi.described` describes."""
    css = files("halfseen.view").joinpath("page.css").read_text(encoding="utf-8")
    title = escape(api["info"]["title"])
    parts = [_address(path, how, told) for path, each in api["paths"].items() for how, told in each.items()]
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        f'<meta name="viewport" content="width=device-width"><style>{css}</style></head>\n'
        f'<body><header><h1>{title}</h1><p>The same for programs: <a href="openapi.json">openapi.json</a>.</p></header>'
        f"<main>{''.join(parts)}</main></body></html>\n"
    )


def _address(path: str, how: str, told: dict[str, Any]) -> str:
    takes = "".join(_takes(kind, each) for kind, each in told.get("requestBody", {}).get("content", {}).items())
    return f"<h2>{how.upper()} {escape(path)}</h2>\n<p>{escape(told['summary'])}</p>\n{takes}"


def _takes(kind: str, content: dict[str, Any]) -> str:
    schema = content["schema"]
    rows = "".join(
        f"<dt><code>{escape(name)}</code></dt><dd>{escape(_in_words(each, name in schema['required']))}</dd>"
        for name, each in schema["properties"].items()
    )
    example = content.get("example")
    shown = "" if example is None else f"<pre><code>{escape(json.dumps(example, indent=1))}</code></pre>"
    return f"<p>It takes {escape(kind)}, with</p><dl>{rows}</dl>{shown}"


def _in_words(schema: dict[str, Any], is_required: bool) -> str:
    if "enum" in schema:
        kind = " or ".join(map(str, schema["enum"]))
    else:
        kind = "file" if "contentMediaType" in schema else str(schema.get("type", "anything"))
    more = f". {schema['description']}" if "description" in schema else "."
    return f"{kind}{'' if is_required else ', if wanted'}{more}"
