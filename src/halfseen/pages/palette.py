"""Colours of all figures; those of lines are told apart by colour-blind eyes (Okabe and Ito, 2008)."""

from typing import Any

import matplotlib
import numpy as np

INK, SOFT, FAINT = "#222222", "#777777", "#d9d9d9"
BLUE, RED, GREEN, PINK, ORANGE, SKY, BLACK = (
    "#0072B2",
    "#D55E00",
    "#009E73",
    "#CC79A7",
    "#E69F00",
    "#56B4E9",
    "#000000",
)
LINES = (BLUE, RED, GREEN, PINK, ORANGE, SKY, BLACK)
OURS, THEIRS, ALARM = BLUE, SOFT, RED
PLANNER, FAINT_PLANNER = "#00795c", "#8fc7b8"
PEER = BLACK
MARKERS = "os^Dvp"
BAND_OPACITY = 0.16
# Proportions are ordered, so their colours go from dark to light; plasma's lightness orders them for colour-blind eyes.
_ORDERED, _LIGHTEST = "plasma", 0.80


def ordered_colours(num: int) -> Any:
    """Colours for so many values in their order, the darkest first."""
    return matplotlib.colormaps[_ORDERED](np.linspace(0.0, _LIGHTEST, num))
