"""Captions of the navigation say which level of heading they are, as those who have a page read aloud need."""

from typing import Any

from sphinx.application import Sphinx

AFTER_THE_THEME = 900


def tell_levels(app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: Any) -> None:
    """Sphinx calls a caption a heading, and leaves out its level."""
    for part in ("furo_navigation_tree", "body"):
        if part in context:
            context[part] = context[part].replace(
                'class="caption" role="heading"', 'class="caption" role="heading" aria-level="2"'
            )


def setup(app: Sphinx) -> dict[str, bool]:
    """Mend pages when all else is done."""
    app.connect("html-page-context", tell_levels, priority=AFTER_THE_THEME)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
