"""The figure that the page on figures makes, narrower."""

from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from halfseen.figures import INK
from pictures.guide_pages import names_after
from pictures.picture import Table, plot, whole


def _memory() -> Table:
    from halfseen.study import Setting, run_study
    from halfseen.workers import Workers
    from halfseen.world import Scene

    hides = np.zeros((4, 4))
    hides[1:, 0] = 0.7
    setting = Setting((Scene(hides, name="three behind one"),), repetitions=4)
    memory = names_after("another-figure", 0)["Memory"]()
    with TemporaryDirectory() as folder:
        results = run_study(setting, Path(folder), (memory,), workers=Workers(1))
    return [{name: float(value) for name, value in results.tables[0]["memory"].iloc[0].items()}]


def draw_memory(rows: Table) -> Figure:
    """Draw it by the page's own class, under the title that the page's claim gives itself."""
    from halfseen.study import Setting

    memory = names_after("another-figure", 0)["Memory"]()
    table = pd.DataFrame(rows)
    drawing = memory.section(Setting(()), {"memory": table}).drawings[0]
    made = drawing.draw("")
    made.set_size_inches(4.8, 2.4)
    (axes,) = made.axes
    axes.set_position((0.2, 0.1, 0.76, 0.74))
    axes.axhline(0.0, color=INK, lw=1.0)
    axes.set(xticks=[], ylabel="gain from memory")
    axes.set_title("Memory − forgetting, with its 95 % interval", loc="left", fontsize=9.5)
    return made


MEMORY = plot("memory", draw_memory, whole("memory.csv", _memory))
