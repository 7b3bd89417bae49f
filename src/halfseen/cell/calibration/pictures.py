"""The pictures beside the numbers of a law: calibration of the law of grasping, and curves of labels."""

from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path

from matplotlib.figure import Figure

from halfseen.cell.calibration.calibrate import HORIZON
from halfseen.cell.calibration.held_figure import draw_held, held_shares
from halfseen.cell.calibration.labels_figure import draw_labels
from halfseen.cell.calibration.law import Law
from halfseen.cell.calibration.trials import glances, trials
from halfseen.figures import drawn
from halfseen.logs import Logs

KINDS = ("svg", "png")


def pictures_of(law: Law, logs: Logs) -> Mapping[str, Callable[[Path], None]]:
    """Give what writes each picture, by the name of its file.

    Parameters
    ----------
    law
        What was estimated.
    logs
        What it was estimated from.
    """
    panels = held_shares(law.grasp.estimate, trials(logs, HORIZON))
    figures = {"held": partial(draw_held, panels), "labels": partial(draw_labels, law.seeing, glances(logs))}
    return {f"{name}.{kind}": partial(_write, draw, kind) for name, draw in figures.items() for kind in KINDS}


def _write(draw: Callable[[], Figure], kind: str, file: Path) -> None:
    file.write_bytes(drawn(draw, kind))
