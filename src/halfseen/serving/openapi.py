"""What can be asked: for programs OpenAPI 3.1, from the models and the policy; for people a page without scripts."""

import json
from html import escape
from importlib.resources import files
from typing import Any

import msgspec
from msgspec import Struct

import halfseen
from halfseen.logs.missing import Filling
from halfseen.policies.ranges import middle_of
from halfseen.serving import models
from halfseen.serving.in_service import InService
from halfseen.serving.models import Schema

JSON, FORM = "application/json", "multipart/form-data"
_REFERENCE = "#/components/schemas/"


def described(service: InService, *, is_recording: bool, is_comparing: bool = False) -> Schema:
    """Describe what a server answers.

    Parameters
    ----------
    service
        The policy that answers.
    is_recording
        Whether what is decided is recorded.
    is_comparing
        Whether trajectories are dealt to the policy or to a rule.
    """
    stored = service.stored
    looks = {JSON: models.Table, FORM: models.Cloud} if stored.is_table else {JSON: models.State}
    asked = [
        ("/decide", "post", "Decide what to do now, and say why.", models.Decided, looks),
        ("/reward", "post", "Complete the stage in progress.", models.Progress, {JSON: models.Reward}),
        ("/end", "post", "End the trajectory in progress; what was cut has a cause.", models.Ended, {JSON: models.End}),
        ("/reload", "post", "Read the policy's folder again.", models.Reloaded, {}),
        ("/health", "get", "Say that it answers, and what.", models.Health, {}),
        ("/state", "get", "Say all that the page of the running cell shows.", models.Cell, {}),
        ("/comparison", "get", "Say how the policy stands against the rule.", models.Compared, {}),
    ]
    others = () if is_recording else ("/reward", "/end")
    others += () if is_comparing else ("/comparison",)
    asked = [each for each in asked if each[0] not in others]
    used = [models.Refused, *(model for *_, answer, takes in asked for model in (answer, *takes.values()))]
    _, schemas = msgspec.json.schema_components(used, ref_template=_REFERENCE + "{name}")
    if not stored.is_table:
        schemas["State"] |= _covariates(service, schemas["State"])
        schemas["Decided"]["properties"]["action"]["enum"] = list(stored.policy.actions)
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
            "4XX": {"description": "Refused, in one line.", "content": {JSON: _referred(models.Refused)}},
        },
    }


def _referred(model: type[Struct]) -> Schema:
    return {"schema": {"$ref": _REFERENCE + model.__name__}}


def _covariates(service: InService, state: Schema) -> Schema:
    """What the policy looks at before what any state has, and the middle of what the logs showed as an example."""
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
        listed = f"{' or '.join(categories)}; of any other the rule decides."
        return {"type": ["string", "null"] if may_lack else "string", "description": listed}
    known = "" if seen is None else f", in the logs {seen[0]:.3g} to {seen[1]:.3g} at the first stage"
    return {"type": ["number", "null"] if may_lack else "number", "description": f"A number{known}."}


def description_of(api: Schema) -> str:
    """Write the page of what `halfseen.serving.openapi.described` describes."""
    css = files("halfseen.view").joinpath("page.css").read_text(encoding="utf-8")
    title, schemas = escape(api["info"]["title"]), api["components"]["schemas"]
    parts = [_address(path, how, each, schemas) for path, hows in api["paths"].items() for how, each in hows.items()]
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        f'<meta name="viewport" content="width=device-width"><style>{css}</style></head>\n'
        f'<body><header><h1>{title}</h1><p>The same for programs: <a href="openapi.json">openapi.json</a>.</p></header>'
        f"<main>{''.join(parts)}</main></body></html>\n"
    )


def _address(path: str, how: str, operation: Schema, schemas: Schema) -> str:
    takes = operation["requestBody"]["content"] if "requestBody" in operation else {}
    shown = (_takes(kind, schemas[each["schema"]["$ref"].removeprefix(_REFERENCE)]) for kind, each in takes.items())
    return f"<h2>{how.upper()} {escape(path)}</h2>\n<p>{escape(operation['summary'])}</p>\n{''.join(shown)}"


def _takes(kind: str, schema: Schema) -> str:
    rows = "".join(
        f"<dt><code>{escape(name)}</code></dt><dd>{'' if name in schema['required'] else 'If wanted: '}"
        f"{escape(field['description'])}</dd>"
        for name, field in schema["properties"].items()
    )
    shown = [f"<pre><code>{escape(json.dumps(each, indent=1))}</code></pre>" for each in schema.get("examples", ())]
    return f"<p>It takes {escape(kind)}, with</p><dl>{rows}</dl>{''.join(shown)}"
