"""What the experiment says: Figure 5, Table 3, and whether the paper's claim holds here."""

from functools import partial
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from halfseen.evaluation.estimate import Estimate
from halfseen.pages.axes import PANEL_TITLE, WIDTH_INCHES, draw_bars, draw_curve, draw_grid, mark_sizes, write_title
from halfseen.pages.numbers import amount, interval, p_value, share_in_words
from halfseen.pages.palette import INK, MARKERS
from halfseen.pages.sentences import SUPPORTED, Claim, listed
from halfseen.study.experiment import Drawing, Listing, Section, Setting, Tables
from halfseen.study.experiments.grasp.design import (
    CLAIMED,
    MEASURES,
    MODEL_COLOURS,
    MODEL_NAMES,
    ORACLE,
    RIVAL,
    SUCCESSION,
    GraspDesign,
)
from halfseen.study.frames import records, row_of, where
from halfseen.study.policies import STRONGEST_RULE
from halfseen.study.wording import learned_from, verdict_of

SCORE = "log_loss"
"""The measure that decides on the paper's claim: it is proper, and needs no policy."""
FITTED = (RIVAL, "beta-dropped", CLAIMED)
FEWEST_SHOWN = 100
"""Attempts below which a bin of predicted probabilities is not drawn."""
SIZES_AXIS = "logged paths that the model was learned from (log scale)"
BAR_DODGE = 1.10


def section_of(design: GraspDesign, setting: Setting, tables: Tables) -> Section:
    """Say whether an SVM tells the probability of a grasp better than the mean of a Beta."""
    claims = [claim_of(design, setting, tables["grasp_tests"], measure) for measure in (SCORE, "learned_reward")]
    sentence = f"{claims[0].sentence[:-1]}; the policy learned with it {_on_reward(claims[1])}."
    caption = _caption(design, tables["grasp"])
    drawing = Drawing("figure5", "Figure 5", _title(tables, setting), caption, partial(_draw, design, tables))
    listings = (_tests(setting, tables["grasp_tests"]), _numbers(tables["grasp"]))
    return Section("The probability of a grasp: the mean of a Beta, or an SVM?", (sentence,), (drawing,), listings)


def claim_of(design: GraspDesign, setting: Setting, tests: pd.DataFrame, measure: str) -> Claim:
    """The paper's claim on a measure, from the largest log."""
    largest = max(design.num_paths)
    row = row_of(tests, measure=measure, num_paths=largest)
    effect, low, high = (float(row[name]) for name in ("effect", "effect_low", "effect_high"))
    is_reward = measure.endswith("reward")
    value, ends = (effect, (low, high)) if is_reward else (-effect, (-high, -low))
    gain = Estimate(value, *ends, float("nan"), float("nan"))
    verbs = (
        ("earns more than", "earns less than")
        if is_reward
        else ("predicts grasps better than", "predicts grasps worse than")
    )
    note = "" if is_reward else "log-loss on held-out attempts"
    subject = f"An SVM {learned_from(largest, design.cut_share)}"
    numbers = float(row["p_holm"]), setting.alpha, note
    return Claim(subject, *verbs, "the mean of a Beta", gain, *numbers, decimals=2 if is_reward else 4)


def _on_reward(claim: Claim) -> str:
    return f"earns more than with the Beta: {claim.verdict} ({claim.numbers})"


def _title(tables: Tables, setting: Setting) -> str:
    rows = records(tables["grasp_tests"], measure=SCORE)
    won = [str(row["num_paths"]) for row in rows if _verdict(row, setting) == SUPPORTED]
    if len(won) == len(rows):
        return "The SVM predicts grasps better than the Beta mean, from logs of every size"
    if won:
        return f"The SVM predicts grasps better than the Beta mean from {listed(won)} paths alone"
    return "The SVM does not predict grasps significantly better than the Beta mean"


def _verdict(row: Any, setting: Setting) -> str:
    return verdict_of(row, setting.alpha, is_more_better=str(row["measure"]).endswith("reward"))


def _caption(design: GraspDesign, grasp: pd.DataFrame) -> str:
    return (
        "Models of the probability of a grasp, learned from the attempts of logs of which "
        f"{share_in_words(design.cut_share)} of the paths are cut in expectation; {int(grasp['repetitions'].iloc[0])} "
        "repetitions. The Beta mean and the SVM weight decided attempts by 1/Ĝ, as a cut is likelier in a long "
        "attempt, and long ones fail; for comparison, the Beta mean with cut attempts dropped. The true model knows "
        "how occlusion slows a grasp, and integrates out the grip of each object given all its attempts. Bars and "
        "bands: 95 % intervals (Student’s t) of paired differences from the true model. Upper right: calibration, "
        f"where at least {FEWEST_SHOWN} attempts were predicted so. Below: the model within the features of the "
        "learned policy, where the rule of succession stands for the usual features, and within the heuristic that "
        f"knows the rest of the world ({STRONGEST_RULE.label})."
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
    for axes, measure, words in zip(
        panels[1], ("learned_reward", "heuristic_reward"), ("learned policy", "heuristic"), strict=True
    ):
        _draw_differences(axes, design, grasp, measure, (SUCCESSION, *FITTED))
        axes.set_title(f"reward of the {words}, over the true model's", **PANEL_TITLE)
    known = {}
    for axes in panels.flat:
        known |= dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    shown = [name for name in MODEL_NAMES.values() if name in known]
    handles = [known[name] for name in shown]
    place: Any = {"loc": "upper left", "bbox_to_anchor": (0.05, top - 0.012), "frameon": False}
    figure.legend(handles, shown, ncols=len(shown), columnspacing=1.4, **place)
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
    axes.axhline(0.0, color=MODEL_COLOURS[ORACLE], linewidth=1.0, zorder=1.5)
    over = f"{measure}_over_oracle"
    for k, model in enumerate(models):
        rows = where(grasp, model=model)
        across = rows["num_paths"].to_numpy(dtype=float) * BAR_DODGE ** (k - (len(models) - 1) / 2)
        ends = rows[f"{over}_low"], rows[f"{over}_high"]
        draw_bars(axes, across, rows[over], ends, label=MODEL_NAMES[model], **_look(model))
    mark_sizes(axes, design.num_paths)
    axes.set_xlabel(SIZES_AXIS)


def _draw_calibration(axes: Axes, design: GraspDesign, figure5: pd.DataFrame) -> None:
    """How much oftener attempts succeeded than predicted, for the largest log."""
    largest = max(design.num_paths)
    axes.axhline(0.0, color=INK, linewidth=1.0, zorder=1.5)
    for model in (*FITTED, ORACLE):
        rows = where(figure5, model=model, num_paths=largest)
        rows = rows.loc[rows["attempts"] >= FEWEST_SHOWN].sort_values(by="mean_probability")
        options = {"linewidth": 1.2, "label": MODEL_NAMES[model], **_look(model)}
        draw_curve(axes, rows["mean_probability"], rows["difference"], (rows["low"], rows["high"]), **options)
    axes.set_xlim(0.0, 1.0)
    axes.set_xticks(np.linspace(0.0, 1.0, 6))
    draw_grid(axes)
    axes.set_xlabel("predicted probability of a grasp")
    axes.set_title(f"proportion that succeeded, less predicted ({largest} paths)", **PANEL_TITLE)


def _look(model: str) -> dict[str, Any]:
    return {"color": MODEL_COLOURS[model], "marker": MARKERS[list(MODEL_COLOURS).index(model)]}


def _decimals(measure: str) -> int:
    return 2 if measure.endswith("reward") else 4


def _tests(setting: Setting, tests: pd.DataFrame) -> Listing:
    caption = (
        "“The SVM is better than the Beta mean”: one-sided Wilcoxon signed-rank tests over the repetitions. "
        "Difference: SVM − Beta, with its 95 % interval (not adjusted); of the scores, below 0 is better. Holm’s "
        f"procedure adjusted the p-values of this table together; α = {setting.alpha:g}."
    )
    groups: dict[str, list[tuple[str, ...]]] = {}
    for row in records(tests):
        decimals = _decimals(row["measure"])
        name = MEASURES[row["measure"]]
        ends = interval(row["effect_low"], row["effect_high"], decimals)
        numbers = (
            amount(row[CLAIMED], decimals),
            amount(row[RIVAL], decimals),
            f"{amount(row['effect'], decimals)} ({ends})",
        )
        told = p_value(row["p_value"]), p_value(row["p_holm"]), _verdict(row, setting)
        groups.setdefault(f"{name[0].upper()}{name[1:]}", []).append((str(row["num_paths"]), *numbers, *told))
    header = ("logged paths", "SVM", "Beta", "difference", "p", "p, adjusted", "claim")
    return Listing("Table 3", caption, header, groups, is_folded=False)


def _numbers(grasp: pd.DataFrame) -> Listing:
    rows = []
    for row in records(grasp):
        cells = [
            f"{amount(row[name], _decimals(name))} "
            f"({interval(row[f'{name}_low'], row[f'{name}_high'], _decimals(name))})"
            for name in MEASURES
        ]
        rows.append((MODEL_NAMES[row["model"]], str(row["num_paths"]), *cells))
    header = ("model", "logged paths", "log-loss", "Brier score", "reward, learned", "reward, heuristic")
    return Listing("The numbers of Figure 5", "", header, {"": rows})
