"""Mends what the theme and Sphinx leave wrong for people who hear a page: levels of headings, and lists."""

import re
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx

AFTER_THE_THEME = 900
# Sphinx writes the parameters of a long signature as a list of descriptions of nothing.
PARAMETERS = re.compile(r"<dl>\s*(<dd>.*?</dd>)\s*</dl>", re.DOTALL)


def with_levels(navigation: str) -> str:
    """Captions of the navigation are headings of a level."""
    return navigation.replace('role="heading"', 'role="heading" aria-level="2"')


def with_plain_parameters(body: str) -> str:
    """Parameters of a long signature stand in plain blocks, a line each."""

    def plain(found: re.Match[str]) -> str:
        return f'<div class="sig-params">{found[1].replace("<dd>", "<div>").replace("</dd>", "</div>")}</div>'

    return PARAMETERS.sub(plain, body)


def without_empty_roles(body: str) -> str:
    """The bibliography's entries have a role of their own, which is none of a list's."""
    return body.replace('<div role="list" class="citation-list">', '<div class="citation-list">')


def mend(_app: Sphinx, _page: str, _template: str, context: dict[str, Any], _doctree: nodes.document | None) -> None:
    """Mend a page before it is written."""
    if "furo_navigation_tree" in context:
        context["furo_navigation_tree"] = with_levels(context["furo_navigation_tree"])
    if "body" in context:
        context["body"] = without_empty_roles(with_plain_parameters(context["body"]))


def setup(app: Sphinx) -> dict[str, bool]:
    """Mend every page."""
    app.connect("html-page-context", mend, priority=AFTER_THE_THEME)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
