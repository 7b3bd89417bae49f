"""Q of the treatments of the guide's small trial."""

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from halfseen.figures import BLUE, GREEN, ORANGE
from pictures.guide_pages import names_after
from pictures.picture import Table, plot, whole
from pictures.style import LEGEND, panel


def _treatments() -> Table:
    names = names_after("any-multistage-problem", 0, 1)
    grid = pd.DataFrame({"tumour": np.linspace(0.0, 1.0, 41)})
    q = names["learner"].q_values(grid, stage=2)
    columns = list(names["learner"].policy_.actions)
    return [
        {"tumour": row, **dict(zip(columns, values.tolist(), strict=True))}
        for row, values in zip(grid["tumour"], q, strict=True)
    ]


def draw_treatments(rows: Table) -> Figure:
    """Draw what is learned of three treatments beside how the page makes them."""
    made, axes = panel(3.0, "size of the tumour", "Q of the second stage [years]")
    tumour = np.array([row["tumour"] for row in rows])
    truth = {"A": 0.2 + tumour, "B": 1.2 - tumour, "C": np.full(tumour.shape, 1.0)}
    for (name, mean), colour in zip(truth.items(), (BLUE, ORANGE, GREEN), strict=True):
        axes.plot(tumour, [row[name] for row in rows], color=colour, label=f"{name}, learned")
        axes.plot(tumour, mean, "--", color=colour, lw=1.2, label="in truth")
    made.legend(loc="outside lower center", ncols=3, **LEGEND)
    return made


TREATMENTS = plot("treatments", draw_treatments, whole("treatments.csv", _treatments))
