"""Figures as bytes: the same numbers give the same bytes, whatever the user's own style is."""

import io
import re
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib
import numpy as np
from markupsafe import Markup, escape
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from halfseen.pages.palette import INK, SOFT

MOST_MARKERS = 3000
"""A line of more markers becomes a picture within the drawing, which stays small however long the log."""
DOTS_PER_INCH = {"png": 200, "svg": 150}
METADATA: dict[str, dict[str, None]] = {
    "png": {"Software": None},
    "svg": {"Date": None, "Creator": None, "Format": None, "Type": None},
}
STYLE: Any = {
    "svg.hashsalt": "halfseen",
    # Words stay words: they can be searched and read aloud, and a browser has letters that DejaVu lacks.
    "svg.fonttype": "none",
    "text.parse_math": False,
    "font.family": ["DejaVu Sans", "sans-serif"],
    "font.size": 9.5,
    "text.color": INK,
    "axes.labelcolor": INK,
    "axes.edgecolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "hatch.color": SOFT,
    "hatch.linewidth": 0.7,
    "lines.linewidth": 1.8,
    "lines.markersize": 4.5,
}


@contextmanager
def style() -> Iterator[None]:
    """Draw alike whatever the user's own style is, and leave that as it was."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(STYLE)
        yield


def drawn(figure_of: Callable[[], Figure], kind: str) -> bytes:
    """Draw a figure of a kind, ``"svg"`` or ``"png"``."""
    buffer = io.BytesIO()
    with style(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        figure = figure_of()
        FigureCanvasAgg(figure)
        _lighten(figure)
        figure.savefig(buffer, format=kind, dpi=DOTS_PER_INCH[kind], metadata=METADATA[kind])
    return buffer.getvalue()


def inline_svg(figure_of: Callable[[], Figure], prefix: str, title: str) -> Markup:
    """Draw a figure as an SVG element that stands in a page beside others: `prefix` makes every id unique."""
    text = drawn(figure_of, "svg").decode()
    text = text[text.index("<svg") :]
    text = re.sub(r'\s(?:xmlns(?::xlink)?|version)="[^"]*"', "", text)
    text = re.sub(r"<!--.*?-->\s*", "", text, flags=re.DOTALL).replace("xlink:href", "href")
    # A page's style sheet reaches all of the page, so this one is bound to its figure.
    text = text.replace("*{stroke-linejoin", f"#{prefix} *{{stroke-linejoin", 1)
    text = re.sub(r'\bid="', f'id="{prefix}-', text)
    text = re.sub(r'(href="#|url\(#)', rf"\g<1>{prefix}-", text)
    opening = re.compile(r'(<svg)\swidth="[^"]*"\sheight="[^"]*"([^>]*>)')
    name = f"<title>{escape(title)}</title>"
    text = opening.sub(lambda found: f'{found[1]} id="{prefix}" role="img"{found[2]}{name}', text, count=1)
    return Markup(text.strip())


def _lighten(figure: Figure) -> None:
    for axes in figure.axes:
        for line in axes.lines:
            if line.get_marker() not in ("None", "", None) and np.size(line.get_xdata()) > MOST_MARKERS:
                line.set_rasterized(True)
