"""How far the logs support their weights: what is identified, who carries it, and what truncation would change."""

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from halfseen.arrays import RowMask, Rows
from halfseen.censoring.diagnostics import FEWEST_EFFECTIVE, WeightDiagnostics, weight_diagnostics
from halfseen.censoring.inputs import checked_ends, checked_floats, checked_truncation
from halfseen.censoring.model import CensoringModel
from halfseen.censoring.named import fitted_model
from halfseen.censoring.weights import path_names, refuse_improbable, survival_of_rows
from halfseen.errors import ArgumentError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

NUM_HEAVIEST = 5
NUM_BOUNDS = 7
TAIL_SHARE = 0.25
# A bound to start from where the weights themselves have none.
UNIDENTIFIED_BOUND = 100.0


@dataclass(frozen=True)
class WeightedPath:
    """One path that finished, and its weight.

    Parameters
    ----------
    path
        Its name.
    time_s
        When it finished [s].
    weight
        1/Ĝ(time⁻), infinite where Ĝ is 0.
    """

    path: Any
    time_s: float
    weight: float


@dataclass(frozen=True)
class Truncation:
    """What is left when the weights are bounded.

    Parameters
    ----------
    truncate_at
        The bound; None for none.
    mean
        Σ w y / Σ w over the paths that finished: the weighted mean of the quantity.
    effective_sample_size
        (Σ w)² / Σ w².
    share_removed
        Share of Σ w that the bound takes away, in [0, 1]; None where a weight has no end.
    """

    truncate_at: float | None
    mean: float
    effective_sample_size: float
    share_removed: float | None


MEAN_WEIGHT_MARGIN = 0.1
"""Weights whose mean is this far from 1 do not stand for all paths."""


@dataclass(frozen=True, eq=False)
class PositivityReport:
    """What weights rest on; print it, or `plot` it.

    Parameters
    ----------
    num_paths
        Number of paths.
    num_finished
        Number of those that reached their own end; the rest were cut.
    overall
        What the weights are worth, as they are used (bounded, if a bound was given).
    tail
        The same for the tail alone: the paths that finished at `tail_from_s` or later.
    tail_from_s
        The time from which the last quarter of the observed finishes lies [s]; NaN where none finished.
    heaviest
        The five largest weights, or fewer, before any truncation, and whose they are.
    unidentified
        Paths that finished where Ĝ is 0: without truncation they have no weight.
    identified_until_s
        The last observed end, of these paths or of those that the model was fitted to, whichever comes first [s];
        earlier if Ĝ is 0 at an observed finish. Nothing is known of finishes later than this.
    num_extrapolated
        Number of paths that finished later than `identified_until_s` with Ĝ above 0: the model answers for them
        without having seen anyone so late.
    ends_in_cut
        True where the last observed end is a cut, so that some paths would have finished later than any did.
    mean_weight
        Σ w / n. Near 1 if the model is right and every finish could be seen; for Kaplan–Meier on its own paths it is
        exactly the share of paths that finish by `identified_until_s` [SattenDatta2001]_.
    truncations
        The weighted mean at a grid of bounds, from none (where all is identified) down to 1, which is no weighting.
    quantity
        What the mean is of.
    truncate_at
        The bound in use, if any.
    finish_s
        When each path that finished did so [s].
    weights
        Its weight before truncation, infinite where Ĝ is 0.
    cut_s
        When each cut path was cut [s].
    """

    num_paths: int
    num_finished: int
    overall: WeightDiagnostics
    tail: WeightDiagnostics
    tail_from_s: float
    heaviest: tuple[WeightedPath, ...]
    unidentified: tuple[WeightedPath, ...]
    identified_until_s: float
    num_extrapolated: int
    ends_in_cut: bool
    mean_weight: float
    truncations: tuple[Truncation, ...]
    quantity: str
    truncate_at: float | int | None
    finish_s: Float[np.ndarray, " f"]
    weights: Float[np.ndarray, " f"]
    cut_s: Float[np.ndarray, " c"]

    @property
    def is_sound(self) -> bool:
        """True where every finish has a weight, weights and tail are worth enough, and the weights add up."""
        return (
            (not self.unidentified or self.truncate_at is not None)
            and self.overall.effective_sample_size >= FEWEST_EFFECTIVE
            and not self.is_thin
            and not self.is_off
        )

    @property
    def is_off(self) -> bool:
        """True where unbounded weights add up to less or more than the paths, within a tenth."""
        return self.truncate_at is None and abs(self.mean_weight - 1.0) > MEAN_WEIGHT_MARGIN

    @property
    def is_thin(self) -> bool:
        """True where the tail is worth fewer than 10 equal weights, and less than half of its paths."""
        worth = self.tail.effective_sample_size
        return worth < min(FEWEST_EFFECTIVE, self.tail.num_seen / 2)

    def __str__(self) -> str:
        from halfseen.censoring.positivity_text import text

        return text(self)

    def plot(self) -> "Figure":
        """Draw the weights over time, and what bounding them would change, as a matplotlib figure."""
        from halfseen.censoring.positivity_figure import draw

        return draw(self)


def positivity_report(
    time: ArrayLike,
    is_finished: ArrayLike,
    model: str | CensoringModel | None = None,
    *,
    covariates: Any = None,
    path_ids: ArrayLike | None = None,
    target: ArrayLike | None = None,
    target_name: str = "target",
    truncate_at: float | int | None = None,
) -> PositivityReport:
    """Report what the weights of these paths rest on; unlike the weights, it also answers where they have none.

    The weighted mean at a grid of bounds follows [ColeHernan2008]_.

    Parameters
    ----------
    time
        Observed end of each path [s], shape (n,).
    is_finished
        False where the path was cut, shape (n,).
    model
        As in `censoring_weights`: fitted, or a name or an unfitted model that is fitted to these paths.
    covariates
        What `model` conditions on, one row for each path.
    path_ids
        Names of the paths; their rows by default.
    target
        The quantity whose mean is wanted, one value for each path, NaN where it was cut; the time to finish by default.
    target_name
        What it is called, with its unit.
    truncate_at
        The bound on the weights that is to be judged; None bounds nothing.

    Raises
    ------
    ArgumentError
        A value is none that a path can have; the row is named.

    Examples
    --------
    >>> report = positivity_report([1.0, 2.0, 2.0, 3.0], [True, False, True, True])
    >>> [(heavy.path, round(heavy.weight, 6)) for heavy in report.heaviest]
    [(3, 2.0), (0, 1.0), (2, 1.0)]
    """
    ends, finished = checked_ends(time, is_finished)
    names = path_names(path_ids, len(ends))
    bound = checked_truncation(truncate_at)
    model = fitted_model(model, ends, finished, covariates)
    rows = np.flatnonzero(finished)
    values, quantity = _target(target, target_name, ends, rows)
    seen = survival_of_rows(model, ends[rows], covariates, rows, len(ends))
    refuse_improbable(seen, lambda k: (f"path {names[rows[k]]}", "finished", ends[rows[k]]))
    with np.errstate(divide="ignore"):
        weights = 1.0 / seen
    last_s = min(float(ends.max()), float(getattr(model, "last_time_", np.inf)))
    until_s = min(last_s, float(ends[rows][np.isinf(weights)].min(initial=np.inf)))
    in_use = np.zeros(len(ends))
    # Without a bound the paths that have no weight stand outside; the report says so first.
    in_use[rows] = np.where(np.isinf(weights), 0.0, weights) if bound is None else np.minimum(weights, bound)
    tail_from_s = float(np.quantile(ends[rows], 1 - TAIL_SHARE, method="higher")) if len(rows) else np.nan
    path = names.tolist()
    order = np.lexsort((ends[rows], -weights))
    named = [WeightedPath(path[rows[k]], float(ends[rows[k]]), float(weights[k])) for k in order]
    return PositivityReport(
        num_paths=len(ends),
        num_finished=len(rows),
        overall=weight_diagnostics(in_use, bound),
        tail=weight_diagnostics(in_use[finished & (ends >= tail_from_s)], bound),
        tail_from_s=tail_from_s,
        heaviest=tuple(path for path in named if np.isfinite(path.weight))[:NUM_HEAVIEST],
        unidentified=tuple(path for path in named if np.isinf(path.weight)),
        identified_until_s=until_s,
        num_extrapolated=int(np.count_nonzero((ends[rows] > until_s) & (seen > 0))),
        ends_in_cut=_ends_in_cut(ends, finished),
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
        raise ArgumentError(f"target has {len(values)} rows for {len(ends)} paths; give one value per path")
    wrong = ~np.isfinite(values[rows])
    if wrong.any():
        row = rows[int(np.argmax(wrong))]
        raise ArgumentError(f"target, row {row}: {values[row]}, but the path finished; give a finite value")
    return values[rows], name


def _ends_in_cut(ends: Rows, finished: RowMask) -> bool:
    return bool((~finished[ends == ends.max()]).any())


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
    worth = weight_diagnostics(bounded, bound)
    removed = 1.0 - float(bounded.sum() / weights.sum()) if np.isfinite(weights).all() else None
    return Truncation(bound, float(bounded @ values / bounded.sum()), worth.effective_sample_size, removed)
