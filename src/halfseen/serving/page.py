"""What can be asked, for people: one page that stands alone, without scripts or anything to load."""

import json
from html import escape
from importlib.resources import files
from typing import Any


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
