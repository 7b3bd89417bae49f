"""When to listen and when to open a door: the tiger of `examples/tiger.py`."""

import numpy as np
from matplotlib.figure import Figure

from halfseen.figures import BLUE, ORANGE, SOFT
from pictures.examples import importable
from pictures.picture import plot
from pictures.style import LEGEND, panel

importable("")


def draw_tiger() -> Figure:
    """Draw what four actions are worth by what is believed, and where each is the first to take."""
    from tiger import NAMES, solved

    found, belief = solved(4), np.linspace(0.0, 1.0, 201)
    made, axes = panel(1.5, "probability that the tiger is on the left", has_grid=False)
    for row, steps in enumerate((1, 2, 3, 4)):
        actions = np.array([found.action_of([left, 1.0 - left], steps) for left in belief])
        for action, colour in enumerate((SOFT, ORANGE, BLUE)):
            axes.plot(
                belief[actions == action], np.full((actions == action).sum(), row), "s", ms=5.0, mew=0, color=colour
            )
    for name, colour in zip(NAMES, (SOFT, ORANGE, BLUE), strict=True):
        axes.plot([], [], "s", color=colour, label=name)
    axes.set_yticks(range(4), [f"{steps} left" for steps in (1, 2, 3, 4)])
    axes.set_ylim(3.6, -0.6)
    made.legend(loc="outside upper left", ncols=3, **LEGEND)
    return made


TIGER = plot("tiger", draw_tiger)
