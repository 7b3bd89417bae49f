"""Rendering of page templates, with one style sheet for all."""

from functools import cache
from importlib.resources import files
from typing import Any

import jinja2


def text_of(package: str, name: str) -> str:
    """Read a data file of a package."""
    return files(package).joinpath(name).read_text(encoding="utf-8")


@cache
def template(package: str, name: str) -> jinja2.Template:
    """Compile a template of a package, once."""
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    return environment.from_string(text_of(package, name))


def rendered(package: str, name: str, content: dict[str, Any], **functions: Any) -> str:
    """Render a template of a package, which may call `functions`; its variable `css` is the common style sheet."""
    return template(package, name).render(content, css=text_of("halfseen.view", "page.css"), **functions)
