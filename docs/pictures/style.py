"""What the guide's figures have in common: narrow, so that letters are legible on a phone, on white."""

from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from halfseen.figures import draw_grid

WIDTH_INCHES = 4.8
"""A page of a phone shows it at four fifths of that."""
LEGEND: Any = {"frameon": False, "fontsize": 9.0, "handlelength": 1.4}


def figure(height_inches: float) -> Figure:
    """An empty figure of the usual width."""
    return Figure(figsize=(WIDTH_INCHES, height_inches), layout="constrained")


def panel(height_inches: float, x: str = "", y: str = "", has_grid: bool = True) -> tuple[Figure, Axes]:
    """A figure of one panel with the names of its axes."""
    made = figure(height_inches)
    axes = made.add_subplot(xlabel=x, ylabel=y)
    if has_grid:
        draw_grid(axes)
    return made, axes
