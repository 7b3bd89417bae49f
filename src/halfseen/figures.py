"""Shared parts of all figures: colours, rendering to bytes, and common drawing functions.

Lines are distinguishable by colour-blind readers (Okabe and Ito, 2008). In every figure learned policies are blue,
heuristics and logging policies grey, and planners green. Among treatments and models that are not policies, the default
is blue, and the others are neither grey nor green. The same numbers give the same bytes, whatever the user's style.
"""

import io
import re
import textwrap
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import matplotlib
import numpy as np
from markupsafe import Markup, escape
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.font_manager import FontProperties
from matplotlib.textpath import text_to_path
from matplotlib.ticker import FixedLocator, NullLocator
from scipy.optimize import isotonic_regression

from halfseen.shapes import Float

INK, SOFT, FAINT = "#222222", "#777777", "#d9d9d9"
BLUE, RED, GREEN, PINK = "#0072B2", "#D55E00", "#009E73", "#CC79A7"
ORANGE, SKY, BLACK = "#E69F00", "#56B4E9", "#000000"
LINES = (BLUE, RED, GREEN, PINK, ORANGE, SKY, BLACK)
OURS, THEIRS, ALARM = BLUE, SOFT, RED
PLANNER, PEER = "#00795c", "#3fa98a"
"""Planners that know the true laws, and planners with laws estimated from the logs."""
HUES = {"learned": OURS, "heuristics": THEIRS, "planners": PLANNER}
MARKERS = "os^Dvp"
BAND_OPACITY = 0.16
_LEARNED_SHADES = LinearSegmentedColormap.from_list("learned", ["#002c4d", BLUE, "#6cb6e8"])

POINTS = 9.5
MOST_MARKERS = 3000
"""A line with more markers is rasterized within the drawing, which keeps it small for a log of any length."""
DOTS_PER_INCH = {"png": 200, "svg": 150}
METADATA: dict[str, dict[str, None]] = {
    "png": {"Software": None},
    "svg": {"Date": None, "Creator": None, "Format": None, "Type": None},
}
STYLE: Any = {
    "svg.hashsalt": "halfseen",
    # Text stays text: it can be searched and read aloud, and browsers have glyphs that DejaVu lacks.
    "svg.fonttype": "none",
    "text.parse_math": False,
    "font.family": ["DejaVu Sans", "sans-serif"],
    "font.size": POINTS,
    **dict.fromkeys(("text.color", "axes.labelcolor", "axes.edgecolor", "xtick.color", "ytick.color"), INK),
    **dict.fromkeys(("axes.spines.top", "axes.spines.right"), False),
    "hatch.color": SOFT,
    "hatch.linewidth": 0.7,
    "lines.linewidth": 1.8,
    "lines.markersize": 4.5,
}

WIDTH_INCHES, NARROW_INCHES = 9.0, 7.4
TITLE_TOP, TITLE_POINTS, TITLE_CHARS = 0.98, 11.5, 92
PANEL_TITLE: dict[str, Any] = {"loc": "left", "fontsize": 9.0, "pad": 8.0}
LABEL_GAP_INCHES = 0.175
LEGEND_ENTRY_INCHES = 4.8 * POINTS / 72
"""Width of a legend entry beyond its text."""


def learned_shades(num: int) -> Any:
    """Blues for `num` ordered values of a learned quantity, the darkest first."""
    return _LEARNED_SHADES(np.linspace(0.0, 1.0, num))


@contextmanager
def style() -> Iterator[None]:
    """Draw in one style whatever the user's own, and restore that afterwards."""
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        matplotlib.rcParams.update(STYLE)
        yield


def drawn(figure_of: Callable[[], Figure], kind: str) -> bytes:
    """Render a figure as ``"svg"`` or ``"png"``."""
    buffer = io.BytesIO()
    with style(), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from font")
        figure = figure_of()
        FigureCanvasAgg(figure)
        for line in (line for axes in figure.axes for line in axes.lines):
            if line.get_marker() not in ("None", "", None) and np.size(line.get_xdata()) > MOST_MARKERS:
                line.set_rasterized(True)
        figure.savefig(buffer, format=kind, dpi=DOTS_PER_INCH[kind], metadata=METADATA[kind])
    return buffer.getvalue()


def inline_svg(figure_of: Callable[[], Figure], prefix: str, title: str) -> Markup:
    """Render a figure as an SVG element for a page with others: `prefix` makes every id unique."""
    text = drawn(figure_of, "svg").decode()
    text = text[text.index("<svg") :]
    text = re.sub(r'\s(?:xmlns(?::xlink)?|version)="[^"]*"', "", text)
    text = re.sub(r"<!--.*?-->\s*", "", text, flags=re.DOTALL).replace("xlink:href", "href")
    # A style sheet applies to the whole page, so this one is scoped to its figure.
    text = text.replace("*{stroke-linejoin", f"#{prefix} *{{stroke-linejoin", 1)
    text = re.sub(r'\bid="', f'id="{prefix}-', text)
    text = re.sub(r'(href="#|url\(#)', rf"\g<1>{prefix}-", text)
    opening = re.compile(r'(<svg)\swidth="[^"]*"\sheight="[^"]*"([^>]*>)')
    name = f"<title>{escape(title)}</title>"
    text = opening.sub(lambda found: f'{found[1]} id="{prefix}" role="img"{found[2]}{name}', text, count=1)
    return Markup(text.strip())


def fitted(text: str, inches: float, most_lines: int = 2, **font: Any) -> str:
    """Break a text into lines no wider than `inches`; text that does not fit ends with an ellipsis."""
    for num_chars in range(len(text), 0, -1):
        lines = textwrap.wrap(text, num_chars) if num_chars < len(text) else [text]
        if len(lines) > most_lines:
            lines = [*lines[: most_lines - 1], f"{lines[most_lines - 1][: num_chars - 1]}…"]
        if max(_width_inches(line, **font) for line in lines) <= inches:
            return "\n".join(lines)
    return text


def _width_inches(text: str, **font: Any) -> float:
    properties = FontProperties(family=STYLE["font.family"], **{"size": POINTS, **font})
    return text_to_path.get_text_width_height_descent(text, properties, False)[0] / 72


def legend_columns(labels: Sequence[str], inches: float, most: int) -> int:
    """Number of columns with which a legend is no wider than `inches`."""
    widths = [_width_inches(label) + LEGEND_ENTRY_INCHES for label in labels]
    nums = range(min(most, len(labels)), 1, -1)
    return next((num for num in nums if sum(map(max, np.array_split(widths, num))) <= inches), 1)


def write_title(figure: Figure, title: str) -> float:
    """Write the title in lines of even length; return the height of its lower edge as a fraction of the figure's."""
    if not title:
        return 1.0
    width = round(TITLE_CHARS * figure.get_size_inches()[0] / WIDTH_INCHES)
    num_lines = len(textwrap.wrap(title, width))
    balanced = next(narrow for narrow in range(1, width + 1) if len(textwrap.wrap(title, narrow)) <= num_lines)
    lines = textwrap.wrap(title, balanced)
    figure.text(0.012, TITLE_TOP, "\n".join(lines), fontsize=TITLE_POINTS, fontweight="bold", va="top", linespacing=1.3)
    return TITLE_TOP - len(lines) * 1.3 * TITLE_POINTS / 72 / figure.get_size_inches()[1]


def write_above(axes: Axes, text: str, points: float, weight: str = "bold") -> None:
    """Write a text `points` above the left end of a panel."""
    place: Any = {"xycoords": "axes fraction", "textcoords": "offset points", "xytext": (0.0, points)}
    axes.annotate(text, (0.0, 1.0), fontweight=weight, **place)


def write_legend(figure: Figure, named: Mapping[str, Any], top: float, **options: Any) -> None:
    """Write a legend for curves, given by name, above the panels, in one line unless `ncols` is given."""
    place: Any = {"loc": "upper left", "bbox_to_anchor": (0.05, top), "ncols": len(named), "frameon": False}
    figure.legend(list(named.values()), list(named), **(place | options))


def named_curves(*panels: Axes) -> dict[str, Any]:
    """Legend handles of these panels, by name."""
    found = {}
    for axes in panels:
        found |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    return found


def draw_grid(axes: Axes) -> None:
    """Draw faint lines at the heights of the ticks, behind everything else."""
    axes.grid(axis="y", color=FAINT, linewidth=0.6, zorder=0)
    axes.set_axisbelow(True)


def mark_sizes(axes: Axes, sizes: Sequence[int]) -> None:
    """Put ticks at these sizes only, on a logarithmic axis."""
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(FixedLocator([float(size) for size in sizes]))
    axes.xaxis.set_minor_locator(NullLocator())
    axes.xaxis.set_major_formatter(lambda size, _: f"{size:g}")
    draw_grid(axes)


def draw_zero(axes: Axes, colour: str = INK, width: float = 1.0) -> None:
    """Draw the reference line of differences at 0."""
    axes.axhline(0.0, color=colour, linewidth=width, zorder=1.5)


def draw_curve(axes: Axes, across: Any, estimates: Any, **options: Any) -> None:
    """Draw a line with markers and a band; `estimates` has the columns mean, low and high."""
    mean, low, high = np.asarray(estimates, dtype=float).T
    across = np.asarray(across, dtype=float)
    axes.fill_between(across, low, high, color=options["color"], alpha=BAND_OPACITY, linewidth=0, zorder=2)
    axes.plot(across, mean, **{"zorder": 2.5, **options})


def draw_bars(axes: Axes, across: Any, estimates: Any, **options: Any) -> None:
    """Draw markers with intervals as error bars: overlapping bands would hide one another."""
    mean, low, high = np.asarray(estimates, dtype=float).T
    usual = {"elinewidth": 1.4, "linewidth": 0.8, "capsize": 2.5, "zorder": 2.5}
    axes.errorbar(np.asarray(across, dtype=float), mean, np.stack([mean - low, high - mean]), **{**usual, **options})


@dataclass(frozen=True)
class EndLabel:
    """A line's name, written to the right of the axes."""

    height: float
    text: str
    colour: Any
    is_bold: bool = False


def write_end_labels(axes: Axes, labels: Sequence[EndLabel]) -> None:
    """Name lines at the right edge, moved apart as little as needed, with connectors to their ends."""
    low, high = axes.get_ylim()
    figure: Any = axes.figure
    height_inches = figure.get_size_inches()[1] * axes.get_position().height
    heights = spread([label.height for label in labels], LABEL_GAP_INCHES / height_inches * (high - low), low, high)
    at = axes.get_yaxis_transform()
    for label, height in zip(labels, heights, strict=True):
        tie = [label.height, label.height, height, height]
        axes.plot([1.005, 1.015, 1.045, 1.055], tie, transform=at, color=label.colour, linewidth=1.3, clip_on=False)
        weight = "bold" if label.is_bold else "normal"
        axes.text(1.065, height, label.text, transform=at, va="center", fontsize=8.5, fontweight=weight)
    axes.set_ylim(low, high)


def spread(heights: Sequence[float], gap: float, low: float, high: float) -> list[float]:
    """Move heights at least `gap` apart, in order and within [low, high], with the smallest sum of squared moves.

    The nearest non-decreasing values are those of isotonic regression [BarlowEtAl1972]_.
    """
    if not len(heights):
        return []
    order, steps = np.argsort(heights, kind="stable"), gap * np.arange(len(heights))
    lowered = isotonic_regression(np.asarray(heights, dtype=float)[order] - steps).x
    placed: Float[np.ndarray, " k"] = np.empty(len(heights))
    placed[order] = np.clip(lowered, low, max(low, high - gap * (len(heights) - 1))) + steps
    return placed.tolist()
