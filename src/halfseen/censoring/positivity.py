"""The positivity report: from trajectories and a censoring model to numbers, told in words or drawn."""

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from halfseen.arrays import Rows
from halfseen.censoring.inputs import checked_ends, checked_floats, checked_truncation
from halfseen.censoring.model import CensoringModel, fitted_model
from halfseen.censoring.positivity_facts import PositivityFacts, Truncation, WeightedTrajectory, text
from halfseen.censoring.weights import refuse_improbable, survival_of_rows, trajectory_names, weight_diagnostics
from halfseen.errors import ArgumentError
from halfseen.shapes import Float

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NUM_HEAVIEST = 5
NUM_BOUNDS = 7
TAIL_SHARE = 0.25
# A bound to start from where the weights themselves have none.
UNIDENTIFIED_BOUND = 100.0


class PositivityReport(PositivityFacts):
    """What weights rest on, with the numbers of `PositivityFacts`; print it, or `plot` it."""

    def __str__(self) -> str:
        return text(self)

    @property
    def panels(self) -> tuple[str, ...]:
        """Names of the panels of its figure that have something to show; none where no trajectory finished."""
        if not self.num_finished:
            return ()
        return ("weights", "means", "sizes") if self.truncations else ("weights",)

    def plot(self, panel: str | None = None) -> "Figure":
        """Draw the weights over time, and what bounding them would change, as a matplotlib figure.

        Parameters
        ----------
        panel
            One of `panels`, to be drawn alone for where there is little room; None for all of them side by side.
        """
        # matplotlib is optional.
        from halfseen.censoring.positivity_figure import draw, draw_panel

        return draw(self) if panel is None else draw_panel(self, panel)


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
    """Report what the weights of these trajectories rest on; unlike the weights, it also answers where they have none.

    The weighted mean at a grid of bounds follows [ColeHernan2008]_.

    Parameters
    ----------
    time
        Observed end of each trajectory [s], shape (n,).
    is_finished
        False where the trajectory was cut, shape (n,).
    model
        As in `censoring_weights`: fitted, or a name or an unfitted model that is fitted to these trajectories.
    covariates
        What `model` conditions on, one row for each trajectory.
    trajectory_ids
        Names of the trajectories; their rows by default.
    target
        The quantity whose mean is wanted, one value for each trajectory, NaN where it was cut; the time to finish by
        default.
    target_name
        What it is called, with its unit.
    truncate_at
        The bound on the weights that is to be judged; None bounds nothing.

    Raises
    ------
    ArgumentError
        A value is none that a trajectory can have; the row is named.

    Examples
    --------
    >>> report = positivity_report([1.0, 2.0, 2.0, 3.0], [True, False, True, True])
    >>> [(heavy.trajectory, round(heavy.weight, 6)) for heavy in report.heaviest]
    [(3, 2.0), (0, 1.0), (2, 1.0)]
    """
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
    # Without a bound the trajectories that have no weight stand outside; the report says so first.
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
    # Where all weights are 1, no bound changes anything.
    bounds = np.geomspace(largest, 1.0, NUM_BOUNDS)[1:].tolist() if largest > 1 else []
    return tuple(_truncation(weights, values, bound) for bound in unbounded + bounds)


def _truncation(weights: Float[np.ndarray, " f"], values: Float[np.ndarray, " f"], bound: float | None) -> Truncation:
    bounded = weights if bound is None else np.minimum(weights, bound)
    size = weight_diagnostics(bounded, bound).effective_sample_size
    removed = 1.0 - float(bounded.sum() / weights.sum()) if np.isfinite(weights).all() else None
    return Truncation(bound, float(bounded @ values / bounded.sum()), size, removed)
