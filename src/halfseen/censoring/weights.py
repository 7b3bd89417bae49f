"""Inverse-probability-of-censoring weights (IPCW), w = δ / Ĝ(U⁻), of trajectories and stages (design §2; eqs. 2, 3).

A stage that was completed at U stands for all that would have been completed then, had nothing been cut
[Robins1992]_ [GoldbergKosorok2012]_ [GoldbergKosorok2017]_.
"""

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from halfseen.arrays import Rows
from halfseen.censoring.covariates import rows_of
from halfseen.censoring.inputs import checked_ends, checked_floats, checked_truncation
from halfseen.censoring.model import CensoringModel
from halfseen.censoring.named import fitted_model
from halfseen.errors import ArgumentError, PositivityError
from halfseen.shapes import Float, Int


def censoring_weights(
    time: ArrayLike,
    is_finished: ArrayLike,
    model: str | CensoringModel | None = None,
    *,
    covariates: Any = None,
    truncate_at: float | int | None = None,
    trajectory_ids: ArrayLike | None = None,
) -> Rows:
    """Weight of each trajectory's own end: is_finished / Ĝ(time⁻ | z).

    Parameters
    ----------
    time
        Observed end of each trajectory [s], shape (n,).
    is_finished
        False where the trajectory was cut, shape (n,).
    model
        A fitted censoring model; or ``"kaplan-meier"`` (None means the same), ``"cox"``, ``"kernel"`` or an unfitted
        model, which is fitted to these trajectories on a copy.
    covariates
        What `model` conditions on, one row for each trajectory.
    truncate_at
        Largest weight allowed, ≥ 1; None truncates nothing.
    trajectory_ids
        Names of the trajectories for messages; their rows by default.

    Returns
    -------
    Float[ndarray, "n"]
        The weights, 0 where cut.

    Raises
    ------
    PositivityError
        Ĝ is 0 at an observed end, and no truncation was asked for.
    ArgumentError
        A value is none that a trajectory can have; the row is named.
    """
    ends, finished = checked_ends(time, is_finished)
    model = fitted_model(model, ends, finished, covariates)
    rows = np.flatnonzero(finished)
    seen = survival_of_rows(model, ends[rows], covariates, rows, len(ends))
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
        Clock at the end of each stage [s], NaN where the stage was not completed, shape (n, T); 0 where a
        robot of several decided at the begin, and another at once after it.
    end_s
        Observed end of each trajectory [s], shape (n,).
    is_finished
        False where the trajectory was cut, shape (n,).
    model, truncate_at, covariates, trajectory_ids
        As in `censoring_weights`.

    Returns
    -------
    Float[ndarray, "n T"]
        The weights, 0 where the stage was not completed.

    Raises
    ------
    PositivityError
        Ĝ is 0 at an observed completion, and no truncation was asked for.
    ArgumentError
        A value is none that a trajectory can have; the row and the stage are named.
    """
    ends, finished = checked_ends(end_s, is_finished, "end_s")
    clock = checked_floats(elapsed_s, "elapsed_s", ndim=2)
    names = trajectory_names(trajectory_ids, len(ends))
    _check_clock(clock, ends, names)
    model = fitted_model(model, ends, finished, covariates)
    rows, columns = np.nonzero(~np.isnan(clock))
    times = clock[rows, columns]
    seen = survival_of_rows(model, times, covariates, rows, len(ends))
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
    """Ĝ(times⁻ | z) at one time for each of `rows`, which may repeat; covariates has a row for each trajectory."""
    return np.asarray(model.survival(times, rows_of(covariates, rows, num_trajectories)), dtype=np.float64)


def _inverse(seen: Float[np.ndarray, " k"], truncate_at: float | int | None, describe: Any) -> Float[np.ndarray, " k"]:
    """1/Ĝ, bounded; `describe(k)` tells where, what and when entry k was seen."""
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
    """Refuse what a censoring model gives as a probability and is none; `describe(k)` tells where, what and when."""
    wrong = ~((seen >= 0) & (seen <= 1))
    if wrong.any():
        k = int(np.argmax(wrong))
        where, _, when = describe(k)
        raise ArgumentError(
            f"{where}: the censoring model gives P(C ≥ {when:g} s) = {seen[k]}; a probability lies in [0, 1]"
        )


def _check_clock(clock: Float[np.ndarray, "rows T"], ends: Rows, names: np.ndarray) -> None:
    if len(clock) != len(ends):
        raise ArgumentError(
            f"elapsed_s has {len(clock)} rows and end_s has {len(ends)}; give one of each per trajectory"
        )
    wrong = np.argwhere((clock < 0) | (clock > ends[:, None]))
    if len(wrong):
        row, column = wrong[0]
        raise ArgumentError(
            f"trajectory {names[row]}, stage {column + 1}: elapsed_s {clock[row, column]} is not in [0, {ends[row]}], "
            "so not between the trajectory's beginning and its end_s; fix the clock, or put NaN where the stage was "
            "not completed"
        )


def trajectory_names(trajectory_ids: ArrayLike | None, num_trajectories: int) -> np.ndarray:
    """Names of the trajectories for messages: `trajectory_ids`, or their rows."""
    names = np.arange(num_trajectories) if trajectory_ids is None else np.asarray(trajectory_ids)
    if names.shape != (num_trajectories,):
        raise ArgumentError(
            f"trajectory_ids has shape {names.shape} for {num_trajectories} trajectories; give one name per trajectory"
        )
    return names
