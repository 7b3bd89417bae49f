"""Diagnostics of weights: the effective sample size, and the largest weight.

Inverse-probability-of-censoring weights (IPCW), w = δ / Ĝ(U⁻), of trajectories and stages (design §2; eqs. 2, 3).

A stage completed at U represents all that would have been completed then without cuts
[Robins1992]_ [GoldbergKosorok2012]_ [GoldbergKosorok2017]_.
"""

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from halfseen.arrays import Rows
from halfseen.censoring.clocks import LARGEST_ROUNDING, tied_clocks
from halfseen.censoring.inputs import (
    as_floats,
    checked_ends,
    checked_floats,
    checked_truncation,
    refuse_other_order,
    rows_of,
    shortest_float,
)
from halfseen.censoring.model import CensoringModel, fitted_model
from halfseen.errors import ArgumentError, HalfseenWarning, PositivityError
from halfseen.shapes import Float, Int

# An effective sample size below this is too small for a mean.
FEWEST_EFFECTIVE = 10.0


@dataclass(frozen=True)
class WeightDiagnostics:
    """A summary of inverse-probability weights.

    Parameters
    ----------
    num_weights
        Number of weights, including those of cut trajectories.
    num_seen
        Number of weights above 0.
    effective_sample_size
        (Σ w)² / Σ w² [Kish1965]_: number of equal weights with the same variance; 0 if no weight is positive.
    largest_weight
        The largest weight; 0 if none is positive.
    largest_at
        Its index, one integer per axis; None if none is positive.
    share_truncated
        Proportion of Σ w carried by weights at the bound, in [0, 1].
    """

    num_weights: int
    num_seen: int
    effective_sample_size: float
    largest_weight: float
    largest_at: tuple[int, ...] | None
    share_truncated: float

    def __str__(self) -> str:
        if self.num_seen == 0:
            return f"None of {self.num_weights} weights is above 0."
        truncated = f", and {self.share_truncated:.1%} of the weight is truncated" if self.share_truncated else ""
        return (
            f"{self.num_seen} of {self.num_weights} weights are above 0, with an effective sample size of "
            f"{self.effective_sample_size:.1f}; the largest weight is {self.largest_weight:.3g}{truncated}."
        )


def weight_diagnostics(weights: ArrayLike, truncate_at: float | int | None = None) -> WeightDiagnostics:
    """Summarise weights.

    Parameters
    ----------
    weights
        Weights ≥ 0 of any shape, 0 if not observed.
    truncate_at
        The bound at which the weights were truncated, if any; weights at the bound count as truncated.

    Raises
    ------
    ArgumentError
        A weight is negative or not finite.
    """
    tally = WeightTally(truncate_at)
    tally.add(weights)
    return tally.diagnostics()


class WeightTally:
    """Running summary of weights that arrive in parts, along their first axis, truncated at a bound, if any."""

    def __init__(self, truncate_at: float | int | None = None) -> None:
        self._bound = checked_truncation(truncate_at)
        self._num_weights = self._num_seen = self._num_rows = self.num_rows_seen = 0
        self._total = self._squares = self._truncated = self._largest = 0.0
        self._largest_at: tuple[int, ...] | None = None

    def add(self, weights: ArrayLike) -> None:
        """Add the next rows."""
        values = as_floats(weights, "weights")
        wrong = np.argwhere(~((values >= 0) & np.isfinite(values)))
        if len(wrong):
            at = tuple(wrong[0].tolist())
            raise ArgumentError(f"weights{list(at)} is {values[at]}; give finite weights ≥ 0")
        if values.any():
            self._total += values.sum()
            self._squares += np.square(values).sum()
            largest = float(values.max())
            if largest > self._largest:
                place = tuple(map(int, np.unravel_index(int(values.argmax()), values.shape)))
                # A single number has no axis.
                self._largest, self._largest_at = largest, place and (self._num_rows + place[0], *place[1:])
            if self._bound is not None:
                # 1/(1/bound) may miss the bound by one unit in the last place.
                self._truncated += values[values >= self._bound * (1 - 1e-12)].sum()
        self._num_weights += values.size
        self._num_seen += int(np.count_nonzero(values))
        self._num_rows += len(values) if values.ndim else 1
        self.num_rows_seen += int(values.any(axis=tuple(range(1, values.ndim))).sum())

    def diagnostics(self) -> WeightDiagnostics:
        """Summarise all rows so far."""
        if not self._num_seen:
            return WeightDiagnostics(self._num_weights, 0, 0.0, 0.0, None, 0.0)
        return WeightDiagnostics(
            num_weights=self._num_weights,
            num_seen=self._num_seen,
            effective_sample_size=float(self._total**2 / self._squares),
            largest_weight=self._largest,
            largest_at=self._largest_at,
            share_truncated=float(self._truncated / self._total),
        )


def warn_if_few(diagnostics: WeightDiagnostics, stacklevel: int = 3) -> None:
    """Warn if the effective sample size is below ten.

    Parameters
    ----------
    diagnostics
        Summary of the weights.
    stacklevel
        As in `warnings.warn`: 2 blames the caller of this function, 3 that caller's caller.

    Warns
    -----
    HalfseenWarning
        The effective sample size is below 10.
    """
    if diagnostics.effective_sample_size < FEWEST_EFFECTIVE:
        warnings.warn(
            f"{diagnostics} That is too few to trust an average; record more trajectories, shorten the horizon, or "
            "truncate the weights knowingly with truncate_at=…",
            HalfseenWarning,
            stacklevel=stacklevel,
        )


def censoring_weights(
    time: ArrayLike,
    is_finished: ArrayLike,
    model: str | CensoringModel | None = None,
    *,
    covariates: Any = None,
    truncate_at: float | int | None = None,
    trajectory_ids: ArrayLike | None = None,
) -> Rows:
    """Weight of the end of each trajectory: is_finished / Ĝ(time⁻ | z).

    Parameters
    ----------
    time
        Observed end of each trajectory [s], shape (n,).
    is_finished
        False if the trajectory was cut, shape (n,).
    model
        A fitted censoring model; or ``"kaplan-meier"`` (same as None), ``"cox"``, ``"kernel"`` or an unfitted model, of
        which a copy is fitted to these trajectories.
    covariates
        Covariates of `model`, one row per trajectory.
    truncate_at
        Largest weight allowed, ≥ 1; None for no truncation.
    trajectory_ids
        Names of the trajectories for messages; their rows by default.

    Returns
    -------
    Float[ndarray, "n"]
        The weights, 0 where cut.

    Raises
    ------
    PositivityError
        Ĝ is 0 at an observed end, and there is no truncation.
    ArgumentError
        A value is invalid; the message names the row.
    """
    refuse_other_order(time=time, covariates=covariates)
    ends, finished = checked_ends(time, is_finished)
    model = fitted_model(model, ends, finished, covariates)
    rows = np.flatnonzero(finished)
    asked = ends[rows].astype(shortest_float(time))
    seen = survival_of_rows(model, asked, covariates, rows, len(ends))
    names = trajectory_names(trajectory_ids, len(ends))
    weights = np.zeros(len(ends))
    weights[rows] = _inverse(seen, truncate_at, lambda k: (f"trajectory {names[rows[k]]}", "finished", ends[rows[k]]))
    return weights


def stage_weights(
    elapsed_s: ArrayLike,
    end_s: ArrayLike,
    is_finished: ArrayLike,
    model: str | CensoringModel | None = None,
    truncate_at: float | int | None = None,
    *,
    covariates: Any = None,
    trajectory_ids: ArrayLike | None = None,
) -> Float[np.ndarray, "n T"]:
    """Weight of each completed stage: w_it = δ_it / Ĝ(U_it⁻ | z_i).

    Parameters
    ----------
    elapsed_s
        Clock at the end of each stage [s], NaN if the stage was not completed, shape (n, T); 0 if several robots decide
        at the start, one right after the other.
    end_s
        Observed end of each trajectory [s], shape (n,).
    is_finished
        False if the trajectory was cut, shape (n,).
    model, truncate_at, covariates, trajectory_ids
        As in `censoring_weights`.

    Returns
    -------
    Float[ndarray, "n T"]
        The weights, 0 if the stage was not completed.

    Raises
    ------
    PositivityError
        Ĝ is 0 at an observed completion, and there is no truncation.
    ArgumentError
        A value is invalid; the message names the row and the stage.
    """
    refuse_other_order(end_s=end_s, elapsed_s=elapsed_s, covariates=covariates)
    ends, finished = checked_ends(end_s, is_finished, "end_s")
    clock = checked_floats(elapsed_s, "elapsed_s", ndim=2)
    names = trajectory_names(trajectory_ids, len(ends))
    if len(clock) != len(ends):
        raise ArgumentError(
            f"elapsed_s has {len(clock)} rows and end_s has {len(ends)}; give one of each per trajectory"
        )
    wrong = np.argwhere((clock < 0) | (clock > ends[:, None] * (1.0 + LARGEST_ROUNDING)))
    if len(wrong):
        row, column = wrong[0]
        raise ArgumentError(
            f"trajectory {names[row]}, stage {column + 1}: elapsed_s {clock[row, column]} is not in [0, {ends[row]}], "
            "so not between the trajectory's beginning and its end_s; fix the clock, or put NaN where the stage was "
            "not completed"
        )
    short = shortest_float(elapsed_s, end_s)
    ends, clock = tied_clocks(*(times.astype(short).astype(np.float64) for times in (ends, clock)))
    model = fitted_model(model, ends, finished, covariates)
    rows, columns = np.nonzero(~np.isnan(clock))
    times = clock[rows, columns]
    seen = survival_of_rows(model, times.astype(short), covariates, rows, len(ends))
    weights = np.zeros(clock.shape)
    weights[rows, columns] = _inverse(
        seen, truncate_at, lambda k: (f"trajectory {names[rows[k]]}, stage {columns[k] + 1}", "completed", times[k])
    )
    return weights


def survival_of_rows(
    model: CensoringModel,
    times: Float[np.ndarray, " k"],
    covariates: Any,
    rows: Int[np.ndarray, " k"],
    num_trajectories: int,
) -> Float[np.ndarray, " k"]:
    """Ĝ(times⁻ | z) at one time for each of `rows`, which may repeat; covariates has one row per trajectory."""
    return np.asarray(model.survival(times, rows_of(covariates, rows, num_trajectories)), dtype=np.float64)


def _inverse(seen: Float[np.ndarray, " k"], truncate_at: float | int | None, describe: Any) -> Float[np.ndarray, " k"]:
    """1/Ĝ, truncated; `describe(k)` gives place, event and time of entry k."""
    bound = checked_truncation(truncate_at)
    refuse_improbable(seen, describe)
    unseen = seen == 0
    if bound is None and unseen.any():
        where, what, when = describe(int(np.argmax(unseen)))
        raise PositivityError(
            f"{where}: {what} at {when:g} s, where the censoring model leaves no trajectory uncut (Ĝ = 0), so its "
            f"weight is not identified; shorten the horizon so that it ends before {when:g} s, fit the model to "
            "trajectories that were watched longer, or truncate the weights knowingly with truncate_at=…"
        )
    if bound is None:
        return 1.0 / seen
    return 1.0 / np.maximum(seen, 1.0 / bound)


def refuse_improbable(seen: Float[np.ndarray, " k"], describe: Any) -> None:
    """Refuse values of a censoring model that are not probabilities; `describe(k)` gives place, event and time."""
    wrong = ~((seen >= 0) & (seen <= 1))
    if wrong.any():
        k = int(np.argmax(wrong))
        where, _, when = describe(k)
        raise ArgumentError(
            f"{where}: the censoring model gives P(C ≥ {when:g} s) = {seen[k]}; a probability must lie in [0, 1]"
        )


def trajectory_names(trajectory_ids: ArrayLike | None, num_trajectories: int) -> np.ndarray:
    """Names of the trajectories for messages: `trajectory_ids`, or their rows."""
    names = np.arange(num_trajectories) if trajectory_ids is None else np.asarray(trajectory_ids)
    if names.shape != (num_trajectories,):
        raise ArgumentError(
            f"trajectory_ids has shape {names.shape} for {num_trajectories} trajectories; give one name per trajectory"
        )
    return names
