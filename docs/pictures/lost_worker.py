"""How pieces go to workers, and what becomes of the one that a lost worker had: a drawing, not a measurement."""

from typing import NamedTuple

from matplotlib.figure import Figure

from halfseen.figures import BLUE, INK, RED, SOFT
from pictures.picture import plot
from pictures.style import panel

LENGTHS_S = (3.0, 4.0, 2.5, 3.5, 3.0, 4.0, 2.5, 3.0, 3.5, 3.0, 2.5, 3.0)
"""Of pieces, in the order in which they are given away [s]."""
LOST, LOST_AT_S, BACK_S = 1, 7.0, 3.0
"""Which of the workers is lost, when, and how long a new one takes to begin [s]."""
NUM_WORKERS = 3


class Bar(NamedTuple):
    """A piece in the hands of a worker."""

    worker: int
    piece: int
    begin_s: float
    end_s: float
    is_lost: bool = False


def bars() -> list[Bar]:
    """Give pieces to anyone who is free first."""
    free_s, waiting, found = [0.0] * NUM_WORKERS, list(range(len(LENGTHS_S))), []
    while waiting:
        worker = min(range(NUM_WORKERS), key=lambda each: free_s[each])
        piece, begin_s = waiting.pop(0), free_s[worker]
        end_s = begin_s + LENGTHS_S[piece]
        if worker == LOST and begin_s < LOST_AT_S < end_s:
            found.append(Bar(worker, piece, begin_s, LOST_AT_S, is_lost=True))
            free_s[worker] = LOST_AT_S + BACK_S
            waiting.insert(0, piece)
        else:
            found.append(Bar(worker, piece, begin_s, end_s))
            free_s[worker] = end_s
    return found


def draw_lost_worker() -> Figure:
    """Draw who makes which piece when."""
    made, axes = panel(2.3, x="time [s]", has_grid=False)
    for bar in bars():
        width_s = bar.end_s - bar.begin_s
        colour = RED if bar.is_lost else BLUE
        axes.barh(bar.worker, width_s, 0.62, bar.begin_s, color=colour, edgecolor="white", lw=1.5)
        middle_s = bar.begin_s + width_s / 2
        axes.text(middle_s, bar.worker, str(bar.piece + 1), ha="center", va="center", color="white", fontsize=9.5)
    axes.plot(LOST_AT_S, LOST, "x", color=INK, ms=9, mew=2.2)
    axes.text(LOST_AT_S + BACK_S / 2, LOST, "a new one\nstarts", ha="center", va="center", color=SOFT, fontsize=8.0)
    axes.set_yticks(range(NUM_WORKERS), [f"worker {each + 1}" for each in range(NUM_WORKERS)])
    axes.tick_params(axis="y", length=0)
    axes.spines[["left", "right", "top"]].set_visible(False)
    axes.set(xlim=(0.0, None))
    axes.invert_yaxis()
    return made


LOST_WORKER = plot("lost-worker", draw_lost_worker)
