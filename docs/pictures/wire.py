"""What controller and halfseen write while a stage is decided, and what happens where the session is lost."""

from matplotlib.figure import Figure

from halfseen.figures import ALARM, INK, OURS
from pictures.picture import plot
from pictures.style import figure

CELL, POLICY = 0.0, 1.0
LINES = (
    (CELL, "outcome of 6, state, request = 7"),
    (POLICY, "log: reward of 6, decision 7"),
    (POLICY, "action"),
    (POLICY, "decision = 7"),
    (CELL, "acts"),
    (CELL, "outcome of 7, state, request = 8"),
    (POLICY, "log: reward of 7, decision 8"),
    (None, "the session, or halfseen, is lost"),
    (CELL, "request = 8 still stands"),
    (POLICY, "action and decision = 8, from the log"),
)
"""Who does what, in order."""


def draw_wire() -> Figure:
    """Draw two lines of life, with an arrow for each thing that is written to the other."""
    made = figure(4.0)
    axes = made.subplots()
    axes.set_axis_off()
    axes.set_xlim(-0.45, 1.45)
    axes.set_ylim(len(LINES) - 0.4, -1.1)
    for place, name in ((CELL, "controller"), (POLICY, "halfseen")):
        axes.plot([place, place], [-0.4, len(LINES) - 0.5], color=INK, lw=1.0)
        axes.text(place, -0.7, name, ha="center", fontsize=9.5, weight="bold")
    for row, (who, words) in enumerate(LINES):
        if who is None:
            axes.axhline(row, color=ALARM, lw=1.2, ls="--")
            axes.text(0.5, row - 0.14, words, ha="center", fontsize=8.5, color=ALARM)
        elif words == "acts" or words.startswith("log:"):
            axes.plot([who], [row], "s", color=OURS if who == POLICY else INK, ms=5)
            side = 0.05 if who == CELL else -0.05
            axes.text(who + side, row + 0.12, words, ha="left" if who == CELL else "right", fontsize=8.5)
        else:
            colour = OURS if who == POLICY else INK
            axes.annotate("", (1.0 - who, row), (who, row), arrowprops={"arrowstyle": "->", "color": colour})
            axes.text(0.5, row - 0.14, words, ha="center", fontsize=8.5, color=colour)
    return made


WIRE = plot("wire", draw_wire)
