"""What the experiment says: Figure 5, Table 3, and whether the paper's claim holds here."""

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from halfseen.figures import (
    MARKERS,
    PANEL_TITLE,
    WIDTH_INCHES,
    dodged,
    draw_bars,
    draw_curve,
    draw_grid,
    draw_zero,
    mark_sizes,
    named_curves,
    write_legend,
    write_title,
)
from halfseen.study.experiment import Drawing, Listing, Row, Section, Setting, Tables
from halfseen.study.experiments.grasp.design import (
    CLAIMED,
    MEASURES,
    MODEL_COLOURS,
    MODEL_NAMES,
    ORACLE,
    REWARDS,
    RIVAL,
    SUCCESSION,
    GraspDesign,
)
from halfseen.study.frames import records, row_of, where
from halfseen.study.policies import STRONGEST_RULE
from halfseen.study.wording import EFFECT, TEST_CELLS, estimated_in, gain_in, is_reward, learned_from, verdict_of
from halfseen.wording import SUPPORTED, Claim, amount, capitalised, listed, share_in_words

SCORE = "log_loss"
"""The measure that decides on the paper's claim: it is proper, and needs no policy."""
VERBS = {
    SCORE: ("predicts grasps better than", "predicts grasps worse than", "log-loss on held-out attempts"),
    REWARDS[0]: ("earns more than", "earns less than", ""),
}
"""Measure → the paper's claim on it, its denial, and a note."""
FITTED = (RIVAL, "beta-dropped", CLAIMED)
FEWEST_SHOWN = 100
"""Attempts below which a bin of predicted probabilities is not drawn."""
SIZES_AXIS = "logged trajectories that the model was learned from (log scale)"
BAR_DODGE = 1.10


def section_of(design: GraspDesign, setting: Setting, tables: Tables) -> Section:
    """Say whether an SVM tells the probability of a grasp better than the mean of a Beta."""
    tests = tables["grasp_tests"]
    score, reward = (claim_of(design, setting, tests, measure) for measure in VERBS)
    sentence = (
        f"{score.sentence[:-1]}; what linear eq. 3 learns with it earns more than with the Beta: {reward.verdict} "
        f"({reward.numbers})."
    )
    drawing = Drawing(
        "figure5", "Figure 5", _title(tests), _caption(design, tables["grasp"]), partial(_draw, design, tables)
    )
    listings = (_tests(setting, tests), _numbers(tables["grasp"]))
    return Section("The probability of a grasp: the mean of a Beta, or an SVM?", (sentence,), (drawing,), listings)


def claim_of(design: GraspDesign, setting: Setting, tests: pd.DataFrame, measure: str) -> Claim:
    """The paper's claim on a measure, from the largest log."""
    largest = max(design.num_trajectories)
    row = row_of(tests, measure=measure, num_trajectories=largest)
    asserted, denied, note = VERBS[measure]
    subject, rival = f"An SVM {learned_from(largest, design.cut_share)}", "the mean of a Beta"
    test = gain_in(row), float(row["p_holm"]), setting.alpha
    return Claim(subject, asserted, denied, rival, *test, note, _decimals(measure))


def _title(tests: pd.DataFrame) -> str:
    rows = records(tests, measure=SCORE)
    won = [str(row["num_trajectories"]) for row in rows if verdict_of(row) == SUPPORTED]
    if len(won) == len(rows):
        return "The SVM predicts grasps better than the Beta mean, from logs of every size"
    if won:
        return f"The SVM predicts grasps better than the Beta mean from {listed(won)} trajectories alone"
    return "The SVM does not predict grasps significantly better than the Beta mean"


def _caption(design: GraspDesign, grasp: pd.DataFrame) -> str:
    return (
        "Models of the probability of a grasp, learned from the attempts of logs of which "
        f"{share_in_words(design.cut_share)} of the trajectories are cut in expectation; "
        f"{int(grasp['repetitions'].iloc[0])} repetitions. The Beta mean and the SVM weight decided attempts by 1/Ĝ, "
        "as a cut is likelier in a long attempt, and long ones fail; for comparison, the Beta mean with cut attempts "
        "dropped. The true model knows how occlusion slows a grasp, and integrates out the grip of each object given "
        "all its attempts. Bars and bands: 95 % intervals (Student’s t) of paired differences from the true model. "
        f"Upper right: calibration, where at least {FEWEST_SHOWN} attempts were predicted so. Below: the model within "
        "the features of linear eq. 3 (laws that are fitted to the log would have a grasp of their own), where the "
        "rule of succession stands for the usual features, and within the heuristic that "
        f"knows the rest of the world ({STRONGEST_RULE.label}).{_stood_in(grasp)}"
    )


def _stood_in(grasp: pd.DataFrame) -> str:
    num, rows = int(grasp["stood_in"].sum()), grasp[grasp["model"] == CLAIMED]
    if not num:
        return ""
    return (
        " Where fewer than two objects missed no SVM can be fitted, and the Beta mean stands in for it: "
        f"{num} of {int(rows['repetitions'].sum())} fits."
    )


def _draw(design: GraspDesign, tables: Tables, title: str) -> Figure:
    """Scores and calibration above, rewards below."""
    grasp = tables["grasp"]
    figure = Figure(figsize=(WIDTH_INCHES, 7.6))
    top = write_title(figure, title)
    grid = figure.add_gridspec(2, 2, left=0.07, right=0.985, bottom=0.07, top=top - 0.11, hspace=0.36, wspace=0.18)
    panels: Any = grid.subplots(squeeze=False)
    _draw_scores(panels[0, 0], design, grasp)
    _draw_calibration(panels[0, 1], design, tables["figure5"])
    for axes, measure, words in zip(panels[1], REWARDS, ("policy by linear eq. 3", "heuristic"), strict=True):
        _draw_differences(axes, design, grasp, measure, (SUCCESSION, *FITTED))
        axes.set_title(f"reward of the {words}, over the true model's", **PANEL_TITLE)
    known = named_curves(*panels.flat)
    shown = {name: known[name] for name in MODEL_NAMES.values() if name in known}
    write_legend(figure, shown, top - 0.012, columnspacing=1.4)
    return figure


def _draw_scores(axes: Axes, design: GraspDesign, grasp: pd.DataFrame) -> None:
    _draw_differences(axes, design, grasp, SCORE, FITTED)
    axes.set_title("log-loss on held-out attempts, above the true model's", **PANEL_TITLE)
    above = float(row_of(grasp, model=SUCCESSION)[f"{SCORE}_over_oracle"])
    note = f"the rule of succession, which ignores occlusion, lies {amount(above)} above"
    place: Any = {"xycoords": "axes fraction", "ha": "right", "va": "top", "fontsize": 8.0}
    axes.annotate(note, (0.98, 0.98), color=MODEL_COLOURS[SUCCESSION], **place)
    low, high = axes.get_ylim()
    axes.set_ylim(low, high + 0.12 * (high - low))


def _draw_differences(
    axes: Axes, design: GraspDesign, grasp: pd.DataFrame, measure: str, models: tuple[str, ...]
) -> None:
    draw_zero(axes, MODEL_COLOURS[ORACLE])
    columns = [f"{measure}_over_oracle{end}" for end in ("", "_low", "_high")]
    for k, model in enumerate(models):
        rows = where(grasp, model=model)
        draw_bars(axes, dodged(rows["num_trajectories"], k, len(models), BAR_DODGE), rows[columns], **_look(model))
    mark_sizes(axes, design.num_trajectories)
    axes.set_xlabel(SIZES_AXIS)


def _draw_calibration(axes: Axes, design: GraspDesign, figure5: pd.DataFrame) -> None:
    """How much oftener attempts succeeded than predicted, for the largest log."""
    largest = max(design.num_trajectories)
    draw_zero(axes)
    for model in (*FITTED, ORACLE):
        rows = where(figure5, model=model, num_trajectories=largest)
        rows = rows.loc[rows["attempts"] >= FEWEST_SHOWN].sort_values(by="mean_probability")
        draw_curve(axes, rows["mean_probability"], rows[["difference", "low", "high"]], linewidth=1.2, **_look(model))
    axes.set_xlim(0.0, 1.0)
    axes.set_xticks(np.linspace(0.0, 1.0, 6))
    draw_grid(axes)
    axes.set_xlabel("predicted probability of a grasp")
    axes.set_title(f"proportion that succeeded, less predicted ({largest} trajectories)", **PANEL_TITLE)


def _look(model: str) -> dict[str, Any]:
    marker = MARKERS[list(MODEL_COLOURS).index(model)]
    return {"color": MODEL_COLOURS[model], "marker": marker, "label": MODEL_NAMES[model]}


def _decimals(measure: str) -> int:
    return 2 if is_reward(measure) else 4


def _tests(setting: Setting, tests: pd.DataFrame) -> Listing:
    caption = (
        "“The SVM is better than the Beta mean”: one-sided Wilcoxon signed-rank tests over the repetitions. "
        "Difference: SVM − Beta, with its 95 % interval (not adjusted); of the scores, below 0 is better. Holm’s "
        f"procedure adjusted the p-values of this table together; α = {setting.alpha:g}."
    )
    cells = {
        "logged trajectories": lambda row: str(row["num_trajectories"]),
        "SVM": lambda row: amount(row[CLAIMED], _decimals(row["measure"])),
        "Beta": lambda row: amount(row[RIVAL], _decimals(row["measure"])),
        "difference": lambda row: estimated_in(row, EFFECT, _decimals(row["measure"])),
        **TEST_CELLS,
    }
    headings = {measure: capitalised(words) for measure, words in MEASURES.items()}
    return Listing.of("Table 3", caption, records(tests), cells, lambda row: headings[row["measure"]], is_folded=False)


def _numbers(grasp: pd.DataFrame) -> Listing:
    def cell(measure: str) -> Callable[[Row], str]:
        columns = [f"{measure}{end}" for end in ("", "_low", "_high")]
        return lambda row: estimated_in(row, columns, _decimals(measure))

    cells = {
        "model": lambda row: MODEL_NAMES[row["model"]],
        "logged trajectories": lambda row: str(row["num_trajectories"]),
    }
    names = ("log-loss", "Brier score", "reward, learned", "reward, heuristic")
    cells |= {name: cell(measure) for name, measure in zip(names, MEASURES, strict=True)}
    return Listing.of("The numbers of Figure 5", "", records(grasp), cells)
