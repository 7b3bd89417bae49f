"""The positivity report of trajectories and a censoring model, as text or as a figure.

The figure shows the weights over time, and the effect of truncating them.
"""

import textwrap
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from halfseen.arrays import Rows
from halfseen.censoring.inputs import checked_ends, checked_floats, checked_truncation, refuse_other_order
from halfseen.censoring.model import CensoringModel, fitted_model
from halfseen.censoring.positivity_facts import PositivityFacts, Truncation, WeightedTrajectory, text, verdict
from halfseen.censoring.weights import (
    FEWEST_EFFECTIVE,
    refuse_improbable,
    survival_of_rows,
    trajectory_names,
    weight_diagnostics,
)
from halfseen.errors import ArgumentError
from halfseen.shapes import Float

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
else:
    Axes = Figure = Any  # matplotlib is optional, and slow to import.

NUM_HEAVIEST = 5
NUM_BOUNDS = 7
TAIL_SHARE = 0.25
# First bound of the grid if some weight is infinite.
UNIDENTIFIED_BOUND = 100.0
INK, FAINT, TAIL_COLOUR = "#222222", "#8a8a8a", "#f3e3d3"
# Okabe and Ito (2008).
WEIGHT_COLOUR, CUT_COLOUR = "#0072B2", "#D55E00"
CUT_INK = "#a84a00"
"""A darker shade for text, which needs more contrast."""
SIZE_INCHES = (12.0, 4.2)
PANEL_INCHES, TALL_INCHES = (4.1, 3.25), (4.1, 6.75)
"""Of a single panel; the weights over time need more height."""
PANEL_TITLE_CHARS, MOST_LETTERS = 46, 16


class PositivityReport(PositivityFacts):
    """Diagnostics of the support of weights (see `PositivityFacts`); print it, or `plot` it."""

    def __str__(self) -> str:
        return text(self)

    @property
    def panels(self) -> tuple[str, ...]:
        """Names of the panels of its figure that have content; none if no trajectory finished."""
        if not self.num_finished:
            return ()
        return ("weights", "means", "sizes") if self.truncations else ("weights",)

    def plot(self, panel: str | None = None) -> "Figure":
        """Draw the weights over time, and the effect of truncating them, as a matplotlib figure.

        Parameters
        ----------
        panel
            One of `panels`, to draw alone in a small space; None for all of them side by side.
        """
        return _draw(self) if panel is None else _draw_panel(self, panel)


def positivity_report(
    time: ArrayLike,
    is_finished: ArrayLike,
    model: str | CensoringModel | None = None,
    *,
    covariates: Any = None,
    trajectory_ids: ArrayLike | None = None,
    target: ArrayLike | None = None,
    target_name: str = "target",
    truncate_at: float | int | None = None,
) -> PositivityReport:
    """Report the support of the weights of these trajectories, even if some weights are not identified.

    The weighted mean at a grid of bounds follows [ColeHernan2008]_.

    Parameters
    ----------
    time
        Observed end of each trajectory [s], shape (n,).
    is_finished
        False if the trajectory was cut, shape (n,).
    model
        As in `censoring_weights`: fitted, or a name or an unfitted model that is fitted to these trajectories.
    covariates
        Covariates of `model`, one row per trajectory.
    trajectory_ids
        Names of the trajectories; their rows by default.
    target
        The quantity to average, one value per trajectory, NaN if it was cut; by default the time to finish.
    target_name
        Its name, with its unit.
    truncate_at
        The bound on the weights to assess; None for no bound.

    Raises
    ------
    ArgumentError
        A value is invalid; the message names the row.

    Examples
    --------
    >>> report = positivity_report([1.0, 2.0, 2.0, 3.0], [True, False, True, True])
    >>> [(heavy.trajectory, round(heavy.weight, 6)) for heavy in report.heaviest]
    [(3, 2.0), (0, 1.0), (2, 1.0)]
    """
    refuse_other_order(time=time, covariates=covariates, target=target)
    ends, finished = checked_ends(time, is_finished)
    names = trajectory_names(trajectory_ids, len(ends))
    bound = checked_truncation(truncate_at)
    model = fitted_model(model, ends, finished, covariates)
    rows = np.flatnonzero(finished)
    values, quantity = _target(target, target_name, ends, rows)
    seen = survival_of_rows(model, ends[rows], covariates, rows, len(ends))
    refuse_improbable(seen, lambda k: (f"trajectory {names[rows[k]]}", "finished", ends[rows[k]]))
    with np.errstate(divide="ignore"):
        weights = 1.0 / seen
    last_s = min(float(ends.max()), float(getattr(model, "last_time_", np.inf)))
    until_s = min(last_s, float(ends[rows][np.isinf(weights)].min(initial=np.inf)))
    in_use = np.zeros(len(ends))
    # Without a bound, trajectories without a weight are omitted; the report states this first.
    in_use[rows] = np.where(np.isinf(weights), 0.0, weights) if bound is None else np.minimum(weights, bound)
    tail_from_s = float(np.quantile(ends[rows], 1 - TAIL_SHARE, method="higher")) if len(rows) else np.nan
    order, num_unidentified = np.lexsort((ends[rows], -weights)), int(np.isinf(weights).sum())
    heaviest = order[: num_unidentified + NUM_HEAVIEST]
    columns = (names[rows[heaviest]], ends[rows[heaviest]], weights[heaviest])
    named = tuple(map(WeightedTrajectory, *(column.tolist() for column in columns)))
    return PositivityReport(
        num_trajectories=len(ends),
        num_finished=len(rows),
        overall=weight_diagnostics(in_use, bound),
        tail=weight_diagnostics(in_use[finished & (ends >= tail_from_s)], bound),
        tail_from_s=tail_from_s,
        heaviest=named[num_unidentified:],
        unidentified=named[:num_unidentified],
        identified_until_s=until_s,
        num_extrapolated=int(np.count_nonzero((ends[rows] > until_s) & (seen > 0))),
        ends_in_cut=bool((~finished[ends == ends.max()]).any()),
        mean_weight=float(in_use.mean()),
        truncations=_truncations(weights, values),
        quantity=quantity,
        truncate_at=bound,
        finish_s=ends[rows],
        weights=weights,
        cut_s=ends[~finished],
    )


def _target(target: ArrayLike | None, name: str, ends: Rows, rows: np.ndarray) -> tuple[Float[np.ndarray, " f"], str]:
    if target is None:
        return ends[rows], "time to finish [s]"
    values = checked_floats(target, "target")
    if len(values) != len(ends):
        raise ArgumentError(
            f"target has {len(values)} rows for {len(ends)} trajectories; give one value per trajectory"
        )
    wrong = ~np.isfinite(values[rows])
    if wrong.any():
        row = rows[int(np.argmax(wrong))]
        raise ArgumentError(f"target, row {row}: {values[row]}, but the trajectory finished; give a finite value")
    return values[rows], name


def _truncations(weights: Float[np.ndarray, " f"], values: Float[np.ndarray, " f"]) -> tuple[Truncation, ...]:
    if len(weights) == 0:
        return ()
    is_identified = bool(np.isfinite(weights).all())
    largest = float(weights.max()) if is_identified else UNIDENTIFIED_BOUND
    unbounded: list[float | None] = [None] if is_identified else [largest]
    # If all weights are 1, no bound has an effect.
    bounds = np.geomspace(largest, 1.0, NUM_BOUNDS)[1:].tolist() if largest > 1 else []
    found = []
    for bound in unbounded + bounds:
        bounded = weights if bound is None else np.minimum(weights, bound)
        size = weight_diagnostics(bounded, bound).effective_sample_size
        removed = 1.0 - float(bounded.sum() / weights.sum()) if is_identified else None
        found.append(Truncation(bound, float(bounded @ values / bounded.sum()), size, removed))
    return tuple(found)


def _draw(facts: PositivityFacts) -> Figure:
    """Draw three panels: weights over time, and against the bound the mean and the effective sample size."""
    figure = _empty_figure(SIZE_INCHES)
    figure.suptitle(verdict(facts), x=0.01, ha="left", fontsize=11.5, fontweight="bold", color=INK)
    weights, mean, sizes = figure.subplots(1, 3, width_ratios=[1.5, 1.0, 1.0])
    _draw_weights(weights, facts)
    figure.legend(loc="outside lower left", ncols=4, fontsize=8.5, frameon=False)
    _draw_means(mean, facts)
    _draw_size(sizes, facts)
    _trim((weights, mean, sizes), 8.5)
    return figure


def _draw_panel(facts: PositivityFacts, panel: str) -> Figure:
    """Draw one of the panels as a separate figure, with text that stays legible at small width."""
    figure = _empty_figure(TALL_INCHES if panel == "weights" else PANEL_INCHES)
    axes = figure.subplots()
    {"weights": _draw_weights, "means": _draw_means, "sizes": _draw_size}[panel](axes, facts, PANEL_TITLE_CHARS)
    if axes.get_legend_handles_labels()[0]:
        figure.legend(loc="outside lower left", ncols=1, fontsize=9.0, frameon=False)
    _trim((axes,), 9.0)
    return figure


def _empty_figure(size_inches: tuple[float, float]) -> Figure:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size_inches, layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def _trim(panels: Sequence[Axes], size: float) -> None:
    for axes in panels:
        axes.spines[["top", "right"]].set_visible(False)
        axes.tick_params(labelsize=size)


def _draw_weights(axes: Axes, facts: PositivityFacts, title_chars: int = 66) -> None:
    """Draw each finish at its weight, and each cut at the bottom."""
    is_finite = np.isfinite(facts.weights)
    time_s, weight = facts.finish_s[is_finite], facts.weights[is_finite]
    if facts.num_finished:
        end_s = max(facts.identified_until_s, float(facts.finish_s.max()))
        if end_s > facts.tail_from_s:
            axes.axvspan(facts.tail_from_s, end_s, color=TAIL_COLOUR, lw=0, label="last quarter of the finishes")
        axes.plot(time_s, weight, "o", ms=4, mew=0, alpha=0.6, color=WEIGHT_COLOUR, label="finished, at its weight")
    if len(weight) and weight.max() > 10:
        axes.set_yscale("log")
        axes.yaxis.set_major_formatter(lambda value, _: f"{value:g}")
    # The cuts fit below the smallest weight, which is 1.
    low = 0.75
    if len(facts.cut_s):
        axes.plot(facts.cut_s, np.full(len(facts.cut_s), low), "|", ms=7, mew=0.8, color=CUT_COLOUR, label="cut")
    gone = facts.finish_s[~is_finite]
    if len(gone):
        top = axes.get_ylim()[1]
        axes.plot(gone, np.full(len(gone), top), "x", ms=6, color=INK, clip_on=False, label="finished, no weight")
    axes.axvline(facts.identified_until_s, color=INK, lw=1.0, ls=(0, (4, 3)))
    axes.margins(x=0.04, y=0.08)
    if len(weight) == 0 or weight.max() == 1:
        axes.set_ylim(0.7, 1.5)
    if facts.heaviest and facts.heaviest[0].weight > 1:
        heavy = facts.heaviest[0]
        is_late = heavy.time_s > np.mean(axes.get_xlim())
        axes.annotate(
            f"trajectory {textwrap.shorten(str(heavy.trajectory), MOST_LETTERS, placeholder='…')}: {heavy.weight:.3g}",
            (heavy.time_s, heavy.weight),
            xytext=(-7 if is_late else 7, 0),
            textcoords="offset points",
            ha="right" if is_late else "left",
            va="center",
            fontsize=8.5,
        )
    axes.set_xlabel("time [s]; dashed: the end of what is identified")
    axes.set_ylabel("weight, 1/Ĝ")
    _title(axes, _weights_title(facts), title_chars)


def _draw_means(axes: Axes, facts: PositivityFacts, title_chars: int = 40) -> None:
    rows = facts.truncations
    if not rows:
        _leave_empty(axes, "no trajectory finished")
        return
    bounds, means = _bounds(facts), [row.mean for row in rows]
    axes.axhline(means[0], color=FAINT, lw=0.9)
    axes.plot(bounds, means, "o-", ms=5, color=WEIGHT_COLOUR)
    _bound_axis(axes, bounds)
    axes.set_ylabel(f"weighted mean {facts.quantity}")
    first, last = rows[0].mean, rows[-1].mean
    if len(rows) == 1:
        _title(axes, f"All weights are equal, and the mean is {first:.4g}", title_chars)
        return
    begin = "Unbounded weights" if rows[0].truncate_at is None else f"Weights up to {rows[0].truncate_at:g}"
    _title(axes, f"{begin} give a mean of {first:.4g}, equal weights {last:.4g}", title_chars)


def _draw_size(axes: Axes, facts: PositivityFacts, title_chars: int = 42) -> None:
    rows = facts.truncations
    if not rows:
        _leave_empty(axes, "no trajectory finished")
        return
    bounds, sizes = _bounds(facts), [row.effective_sample_size for row in rows]
    axes.axhline(FEWEST_EFFECTIVE, color=CUT_COLOUR, lw=0.9)
    axes.plot(bounds, sizes, "o-", ms=5, color=WEIGHT_COLOUR)
    for bound, size, row in zip(bounds, sizes, rows, strict=True):
        if row.share_removed is None:
            continue
        removed = f"{row.share_removed:.0%}"
        axes.annotate(removed, (bound, size), xytext=(4, 4), textcoords="offset points", ha="left", fontsize=8.5)
    axes.set_ylim(0, 1.15 * max(*sizes, FEWEST_EFFECTIVE, facts.num_finished))
    axes.text(bounds[-1], FEWEST_EFFECTIVE, "below 10: too few", ha="left", va="bottom", fontsize=8.5, color=CUT_INK)
    _bound_axis(axes, bounds)
    axes.set_ylabel("effective sample size [trajectories]")
    shown = "Effective sample size of the finishes; percentages: weight that the bound removes"
    _title(axes, shown, title_chars)


def _bounds(facts: PositivityFacts) -> list[float]:
    """Position of each truncation on the axis: no bound is placed at the largest weight, where truncation begins."""
    largest = facts.heaviest[0].weight if facts.heaviest else 1.0
    return [largest if row.truncate_at is None else row.truncate_at for row in facts.truncations]


def _bound_axis(axes: Axes, bounds: list[float]) -> None:
    axes.set_xscale("log")
    axes.set_xticks(bounds)
    axes.set_xticks([], minor=True)
    axes.xaxis.set_major_formatter(lambda value, _: f"{value:.2g}" if value < 100 else f"{value:.0f}")
    if len(bounds) > 1:
        axes.set_xlim(bounds[0] ** -0.07, bounds[0] ** 1.07)
    axes.set_xlabel("largest weight allowed (log scale)")


def _weights_title(facts: PositivityFacts) -> str:
    if not facts.heaviest:
        return f"None of {facts.num_trajectories} trajectories has a weight"
    shown = f"{facts.num_finished} of {facts.num_trajectories} trajectories finished"
    if facts.heaviest[0].weight == 1:
        return f"{shown}, all with weight 1"
    mass = facts.weights[np.isfinite(facts.weights)]
    share = sum(heavy.weight for heavy in facts.heaviest) / mass.sum()
    few = "the heaviest" if len(facts.heaviest) == 1 else f"the heaviest {len(facts.heaviest)}"
    return f"{shown}; {few} carry {share:.0%} of the weight"


def _leave_empty(axes: Axes, why: str) -> None:
    axes.set_axis_off()
    axes.text(0.5, 0.5, why, ha="center", va="center", color=FAINT, transform=axes.transAxes)


def _title(axes: Axes, sentence: str, width: int) -> None:
    axes.set_title("\n".join(textwrap.wrap(sentence, width)), loc="left", fontsize=9.5, color=INK)
