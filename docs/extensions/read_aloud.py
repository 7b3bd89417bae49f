"""Pages for those who have them read aloud: what Sphinx's own HTML leaves out, or says twice."""

from typing import Any

from sphinx.application import Sphinx

AFTER_THE_THEME = 900
PARAMETER = '<dd><em class="sig-param">'
MENDED = {
    # A caption of the navigation is called a heading, without its level.
    'class="caption" role="heading"': 'class="caption" role="heading" aria-level="2"',
    # The lines of a long signature are a list of definitions that define nothing.
    f"<dl>\n{PARAMETER}": f'<dl role="presentation">\n{PARAMETER}',
    PARAMETER: PARAMETER.replace("<dd>", '<dd role="presentation">'),
    # Entries of the bibliography have a role of their own, which is none of a list's.
    '<div role="list" class="citation-list">': '<div class="citation-list">',
}


def mend(app: Sphinx, page: str, template: str, context: dict[str, Any], doctree: Any) -> None:
    """Mend a page when the theme has made its parts."""
    for part in ("furo_navigation_tree", "body"):
        for wrong, right in MENDED.items():
            if part in context:
                context[part] = context[part].replace(wrong, right)


def setup(app: Sphinx) -> dict[str, bool]:
    """Mend pages when all else is done."""
    app.connect("html-page-context", mend, priority=AFTER_THE_THEME)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
