"""Colours of all figures; those of lines are told apart by colour-blind eyes (Okabe and Ito, 2008).

Who decides is told by one hue in every figure: what was learned is blue, heuristics and logging policies are grey,
planners are green. Of treatments and models that are no policies, the default is blue, and others are neither grey nor
green.
"""

from typing import Any

import numpy as np
from matplotlib.colors import LinearSegmentedColormap

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
PLANNER, PEER = "#00795c", "#3fa98a"
"""Planners that know the true laws, and those with laws from the logs."""
HUES = {"learned": OURS, "heuristics": THEIRS, "planners": PLANNER}
MARKERS = "os^Dvp"
BAND_OPACITY = 0.16
_LEARNED_SHADES = LinearSegmentedColormap.from_list("learned", ["#002c4d", BLUE, "#6cb6e8"])
_GREYS, _BLUES = (
    ("#333333", "#6b6b6b", "#a0a0a0", "#c6c6c6", "#e6e6e6"),
    ("#dfeefa", "#b3d7f3", "#7fbbe8", "#0068a8", "#003a5f"),
)
GAINS = LinearSegmentedColormap.from_list("gains", [*_GREYS, *_BLUES])
"""From where heuristics earn more to where the learned policy earns more, in ten steps; white words on the outer 4."""


def learned_shades(num: int) -> Any:
    """Blues for so many ordered values of what was learned, the darkest first."""
    return _LEARNED_SHADES(np.linspace(0.0, 1.0, num))
