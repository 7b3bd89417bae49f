"""The figure: how much more one treatment is worth than the other in the first stage, in truth and as learned."""

from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from trial_optimum import GRID, STATES, WELLNESS, optimum

from halfseen.learning import CensoredQLearner

DOTS_PER_INCH = 140
COLOURS = "PuOr"
"""Distinct with any colour vision."""


def write_figure(fitted: CensoredQLearner, sentence: str, path: Path) -> None:
    """Draw Q̂_1(A) − Q̂_1(B) over wellness and tumour, beside the truth, and write it as PNG.

    Parameters
    ----------
    fitted
        What was learned.
    sentence
        What is seen, for the title.
    path
        Where to; its folder is made if it is not there.
    """
    _, q_of_stage = optimum()
    learned = fitted.q_values(STATES, 1).reshape(*WELLNESS.shape, -1)
    gains = {"the optimum": _gain(q_of_stage[0]), "learned": _gain(learned)}
    reach = max(float(np.abs(gain).max()) for gain in gains.values())
    figure = Figure(figsize=(9.0, 4.6), layout="constrained", dpi=DOTS_PER_INCH)
    FigureCanvasAgg(figure)
    figure.suptitle(sentence, fontsize=10.0, x=0.01, ha="left")
    axes: Any = figure.subplots(1, 2, sharex=True, sharey=True)
    for axis, (name, gain) in zip(axes, gains.items(), strict=True):
        axis.pcolormesh(GRID, GRID, gain.T, cmap=COLOURS, vmin=-reach, vmax=reach, shading="nearest")
        axis.contour(GRID, GRID, gain.T, levels=[0.0], colors="#222222", linewidths=1.6)
        axis.set_title(name, loc="left", fontsize=9.0)
        axis.set_xlabel("wellness, 0 (bedridden) to 1 (well)")
    axes[1].contour(GRID, GRID, gains["the optimum"].T, levels=[0.0], colors="#222222", linestyles="dashed")
    axes[0].set_ylabel("size of the tumour, 0 (none) to 1 (largest)")
    bar = figure.colorbar(axes[0].collections[0], ax=axes)
    bar.set_label("Q₁(A, aggressive) − Q₁(B, gentle) [years]")
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path, format="png")


def _gain(q: Float[np.ndarray, "G G A"]) -> Float[np.ndarray, "G G"]:
    return q[..., 0] - q[..., 1]
