"""Figure 1 from ten thousand repetitions, as many as the paper has, and what forty of them could not tell."""

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from halfseen.pages.palette import BLUE, INK, SOFT
from halfseen.study.statistics import over_repetitions
from pictures.picture import ROOT, Numbers, Picture, Row, Table, plot
from pictures.study_figure import FIGURE1_NUMBERS, draw_figure, keep_tables, repetitions_in, run_study
from pictures.style import LEGEND, panel

FEW, MANY = 40, 10_000
STUDY = ROOT / "runs" / "pictures" / "study-10000"
PREFIX = "study-10000"


@dataclass(frozen=True)
class Comparison:
    """Two things that were played in each repetition: by how much the first earned more."""

    question: str
    against: str
    num_paths: float
    cut_share: float
    more: np.ndarray


def take_in(folder: Path) -> Table:
    """Keep the tables of a study of ten thousand repetitions, and what forty and all of them tell."""
    keep_tables(folder, PREFIX)
    return [_row(each) for each in _comparisons(repetitions_in(folder))]


def _comparisons(rows: Table) -> Iterator[Comparison]:
    each: dict[tuple[str, float, float], list[float]] = defaultdict(list)
    for row in sorted(rows, key=lambda row: row["repetition"]):
        each[row["policy"], row["num_paths"], row["cut_share"]].append(row["reward"])
    earned = {place: np.array(rewards) for place, rewards in each.items()}
    learned = {(size, share): one for (policy, size, share), one in earned.items() if policy == "censored_q"}
    sizes, shares = (sorted({place[axis] for place in learned}) for axis in (0, 1))
    for size in sizes:
        for share in shares[1:]:
            yield Comparison("cuts", "no cuts", size, share, learned[size, share] - learned[size, 0.0])
    for before, after in pairwise(sizes):
        for share in shares:
            yield Comparison("more", f"{before:.0f}", after, share, learned[after, share] - learned[before, share])
    for rule in sorted({policy for policy, *_ in earned} - {"censored_q"}):
        for size, share in sorted(learned):
            yield Comparison("rule", rule, size, share, learned[size, share] - earned[rule, 0, 0.0])


def _row(one: Comparison) -> dict[str, object]:
    few, many = over_repetitions(one.more[:FEW]), over_repetitions(one.more)
    named = {"question": one.question, "against": one.against, "num_paths": one.num_paths, "cut_share": one.cut_share}
    of_few = {"few_mean": few.value, "few_low": few.low, "few_high": few.high}
    return named | of_few | {"mean": many.value, "low": many.low, "high": many.high, "repetitions": len(one.more)}


def draw_costs(rows: Table) -> Figure:
    """Draw what cuts of half of the paths cost, by the size of the log, from forty repetitions and from all."""
    made, axes = panel(3.2, "paths in the log, half of them cut", "lost to the cuts [points a table]")
    of_half = [row for row in rows if row["question"] == "cuts" and row["cut_share"] == 0.5]
    for begin, colour, aside, told in (("few_", SOFT, -0.08, f"{FEW} repetitions"), ("", BLUE, 0.08, f"{MANY:,}")):
        for at, row in enumerate(of_half):
            low, high = -row[f"{begin}high"], -row[f"{begin}low"]
            axes.plot([at + aside] * 2, [low, high], color=colour, lw=2.4, solid_capstyle="butt")
            axes.plot(at + aside, -row[f"{begin}mean"], "o", color=colour, ms=4.5, label=None if at else told)
    axes.axhline(0.0, color=INK, lw=0.8)
    axes.set_xticks(range(len(of_half)), [f"{row['num_paths']:.0f}" for row in of_half])
    made.legend(loc="outside lower center", ncols=2, **LEGEND)
    return made


def _few_again() -> Mapping[int, Row]:
    """What forty repetitions tell, from the forty of Figure 1, which are the first of the ten thousand."""
    told = map(_row, _comparisons(FIGURE1_NUMBERS.read()))
    few = [{name: row[name] for name in ("few_mean", "few_low", "few_high")} for row in told]
    return {index: row | few[index] for index, row in enumerate(TEN_THOUSAND_NUMBERS.read())}


TEN_THOUSAND_NUMBERS = Numbers("ten-thousand.csv", lambda: take_in(run_study(STUDY, MANY)), _few_again)
TEN_THOUSAND = Picture(
    "ten-thousand",
    "docs/static/guide/ten-thousand.svg",
    partial(draw_figure, "figure1", PREFIX, "svg"),
    TEN_THOUSAND_NUMBERS,
    15.0,
)
COST_OF_CUTS = plot("cost-of-cuts", draw_costs, TEN_THOUSAND_NUMBERS)
