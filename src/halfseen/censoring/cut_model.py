"""Who is cut, and when: Ĝ on the clock of a trajectory (total time), or on that of each stage (gap time).

========  ============================================================================================
``by``    what the model is fitted to
========  ============================================================================================
trajectory      one row a trajectory: its end, and the covariates with which it began
stage     for each stage t its own model: how long it was watched, its covariates and its action
pooled    the same, one model for the rows of all stages
========  ============================================================================================

On the clock of stages, a trajectory is uncut until U_t with probability Ĝ(U_t⁻) = Π_{s≤t} K̂_s(D_s⁻ | S_s, A_s), where
D_s is the duration of stage s: cuts may depend on all that a trajectory has shown so far, through S_s and A_s
[Robins1992]_.
"""

from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import pandas as pd

from halfseen.arrays import RowMask, Rows
from halfseen.censoring.cox import Cox
from halfseen.censoring.model import CensoringModel, is_fitted, uses_covariates
from halfseen.censoring.named import named_model
from halfseen.censoring.stage_clocks import StageClocks
from halfseen.censoring.weights import stage_weights
from halfseen.errors import ArgumentError, HalfseenError, PositivityError
from halfseen.shapes import Bool, Float, Int

CensoringBy = Literal["trajectory", "stage", "pooled"]
CENSORING_BY: tuple[str, ...] = get_args(CensoringBy)


STAGE_RIDGE = 1.0
"""Penalty of ``"cox"`` on the clock of stages: few cuts fall into each stage and action, and none into some."""


class FittedRows(NamedTuple):
    """One fitted model, and the columns of the covariates that it uses."""

    model: CensoringModel
    columns: Int[np.ndarray, " p"]


@dataclass(frozen=True)
class CutModel:
    """Ĝ of a log.

    Parameters
    ----------
    by
        ``"trajectory"``, ``"stage"`` or ``"pooled"``.
    fitted
        One model; or one for each stage.
    truncate_at
        Largest weight 1/Ĝ allowed; None truncates nothing.
    """

    by: CensoringBy
    fitted: tuple[FittedRows, ...]
    truncate_at: float | int | None = None

    def survival(
        self, trajectories: StageClocks, age_s: Float[np.ndarray, "n T *S"], is_wanted: Bool[np.ndarray, "n T"]
    ) -> Float[np.ndarray, "n T *S"]:
        """K̂: probability that a begun stage is not cut before these ages, given that it began; 1 where not wanted.

        Parameters
        ----------
        trajectories
            The log, or another one with the same covariates.
        age_s
            Time since the stage began [s].
        is_wanted
            Begun stages that are asked about.
        """
        probabilities = np.ones(age_s.shape)
        if self.by == "trajectory":
            trajectory, stage = np.nonzero(is_wanted)
            start = trajectories.begun_at_s[trajectory, stage]
            begun = self._ask(0, trajectories, start, trajectory, np.zeros_like(stage))
            end = self._ask(0, trajectories, _add(start, age_s[trajectory, stage]), trajectory, np.zeros_like(stage))
            probabilities[trajectory, stage] = end / np.where(begun > 0, begun, 1.0).reshape(
                (-1,) + (1,) * (end.ndim - 1)
            )
            return probabilities
        if self.by == "pooled":
            trajectory, stage = np.nonzero(is_wanted)
            probabilities[trajectory, stage] = self._ask(0, trajectories, age_s[trajectory, stage], trajectory, stage)
            return probabilities
        for t in range(is_wanted.shape[1]):
            trajectory = np.flatnonzero(is_wanted[:, t])
            if len(trajectory):
                probabilities[trajectory, t] = self._ask(
                    t, trajectories, age_s[trajectory, t], trajectory, np.full_like(trajectory, t)
                )
        return probabilities

    def weights(self, trajectories: StageClocks) -> Float[np.ndarray, "n T"]:
        """δ_t / Ĝ(U_t⁻), 0 where a stage was not completed.

        Raises
        ------
        PositivityError
            Ĝ is 0 at an observed completion, and no truncation was asked for; trajectory and stage are named.
        """
        if self.by == "trajectory":
            model, columns = self.fitted[0]
            return stage_weights(
                trajectories.elapsed_s,
                trajectories.end_s,
                trajectories.is_finished,
                model,
                self.truncate_at,
                covariates=_frame(trajectories.covariate_names, trajectories.covariates[:, 0], columns),
                trajectory_ids=trajectories.trajectory_ids,
            )
        within = self.survival(trajectories, trajectories.watched_s, trajectories.is_completed)
        survival = np.cumprod(np.where(trajectories.is_completed, within, 1.0), axis=1)
        if self.truncate_at is None:
            _refuse_unseen(trajectories, survival)
            return np.where(trajectories.is_completed, 1.0 / survival, 0.0)
        return np.where(trajectories.is_completed, 1.0 / np.maximum(survival, 1.0 / self.truncate_at), 0.0)

    def begun_weights(self, trajectories: StageClocks) -> Float[np.ndarray, "n T"]:
        """1 / Ĝ(U_{t−1}⁻) of each begun stage: what the stage before it weighed; 0 elsewhere."""
        before = np.concatenate(
            [np.ones((trajectories.num_trajectories, 1)), self.weights(trajectories)[:, :-1]], axis=1
        )
        return np.where(trajectories.is_begun, before, 0.0)

    def _ask(
        self, which: int, trajectories: StageClocks, at_s: Float[np.ndarray, " k *S"], trajectory: Any, stage: Any
    ) -> Float[np.ndarray, " k *S"]:
        model, columns = self.fitted[which]
        return np.asarray(
            model.survival(
                at_s, _frame(trajectories.covariate_names, trajectories.covariates[trajectory, stage], columns)
            ),
            dtype=np.float64,
        )


def fit_cut_model(
    trajectories: StageClocks,
    censoring: str | CensoringModel,
    by: CensoringBy,
    truncate_at: float | int | None = None,
) -> CutModel:
    """Fit Ĝ to a log; a model that is fitted already is taken as it is.

    Parameters
    ----------
    trajectories
        The log.
    censoring
        Name of a model, or a model.
    by
        ``"trajectory"``, ``"stage"`` or ``"pooled"``.
    truncate_at
        Largest weight allowed.

    Raises
    ------
    ArgumentError
        The model cannot be fitted, or needs the action of a stage in which a trajectory was cut, which was not logged.
    """
    if not isinstance(censoring, str) and is_fitted(censoring):
        columns = np.arange(len(trajectories.covariate_names) if uses_covariates(censoring) else 0)
        which = trajectories.num_stages if by == "stage" else 1
        return CutModel(by, (FittedRows(censoring, columns),) * which, truncate_at)
    if by == "trajectory":
        _refuse_unknown(
            trajectories, np.broadcast_to(np.arange(trajectories.num_stages) == 0, trajectories.is_begun.shape)
        )
        rows = trajectories.end_s, trajectories.is_finished, trajectories.covariates[:, 0]
        return fit_trajectory_cuts(*rows, trajectories.covariate_names, censoring, truncate_at)
    if isinstance(censoring, str) and censoring == "cox":
        censoring = Cox(ridge=STAGE_RIDGE)
    fitted = []
    for t in range(trajectories.num_stages) if by == "stage" else [None]:
        wanted = (
            trajectories.is_begun if t is None else trajectories.is_begun & (np.arange(trajectories.num_stages) == t)
        )
        if not wanted.any():
            # No trajectory came so far: nothing can be asked of it either.
            fitted.append(fitted[-1])
            continue
        _refuse_unknown(trajectories, wanted)
        rows = trajectories.watched_s[wanted], trajectories.is_completed[wanted], trajectories.covariates[wanted]
        where = "all stages" if t is None else f"stage {t + 1}"
        fitted.append(_fit(censoring, *rows, trajectories.covariate_names, where))
    return CutModel(by, tuple(fitted), truncate_at)


def fit_trajectory_cuts(
    end_s: Rows,
    is_finished: RowMask,
    covariates: Float[np.ndarray, "n P"],
    names: tuple[str, ...],
    censoring: str | CensoringModel,
    truncate_at: float | int | None = None,
) -> CutModel:
    """Fit Ĝ on the clock of trajectories, given the covariates with which each began."""
    if not isinstance(censoring, str) and is_fitted(censoring):
        columns = np.arange(len(names) if uses_covariates(censoring) else 0)
        return CutModel("trajectory", (FittedRows(censoring, columns),), truncate_at)
    fitted = _fit(censoring, end_s, is_finished, covariates, names, "a trajectory's first stage")
    return CutModel("trajectory", (fitted,), truncate_at)


def _fit(
    censoring: str | CensoringModel,
    watched_s: Float[np.ndarray, " k"],
    is_completed: Bool[np.ndarray, " k"],
    covariates: Float[np.ndarray, "k P"],
    names: tuple[str, ...],
    where: str,
) -> FittedRows:
    model = named_model(censoring)
    if not uses_covariates(model):
        return FittedRows(model.fit(watched_s, is_completed), np.arange(0))
    differs = np.ptp(covariates, axis=0) > 0 if len(covariates) else np.zeros(len(names), dtype=bool)
    columns = np.flatnonzero(differs)
    if not len(columns):
        raise ArgumentError(
            f"censoring uses covariates, and none of those of {where} differs between trajectories; choose "
            "'kaplan-meier'"
        )
    try:
        return FittedRows(model.fit(watched_s, is_completed, _frame(names, covariates, columns)), columns)
    except HalfseenError as error:
        raise type(error)(f"cuts of {where}: {error}") from error


def _frame(
    names: tuple[str, ...], values: Float[np.ndarray, "k P"], columns: Int[np.ndarray, " p"]
) -> pd.DataFrame | None:
    if not len(columns):
        return None
    return pd.DataFrame(values[:, columns], columns=pd.Index([names[column] for column in columns]))


def _refuse_unknown(trajectories: StageClocks, wanted: Bool[np.ndarray, "n T"]) -> None:
    unknown = wanted & np.isnan(trajectories.covariates).any(axis=-1)
    if unknown.any():
        trajectory, stage = np.argwhere(unknown)[0]
        name = trajectories.covariate_names[int(np.argmax(np.isnan(trajectories.covariates[trajectory, stage])))]
        raise ArgumentError(
            f"trajectory {trajectories.trajectory_ids[trajectory]}, stage {stage + 1}: {name} is not known, and cuts "
            "are to depend on it; log the action of the stage in which a trajectory is cut, or leave 'action' out of "
            "censoring_covariates"
        )


def _refuse_unseen(trajectories: StageClocks, survival: Float[np.ndarray, "n T"]) -> None:
    unseen = trajectories.is_completed & (survival <= 0)
    if unseen.any():
        trajectory, stage = np.argwhere(unseen)[0]
        age_s = trajectories.watched_s[trajectory, stage]
        raise PositivityError(
            f"trajectory {trajectories.trajectory_ids[trajectory]}, stage {stage + 1}: completed {age_s:g} s after it "
            "began, where the censoring model leaves no stage uncut (Ĝ = 0), so its weight is not identified; shorten "
            f"the stages to below {age_s:g} s, pool the stages, or truncate the weights knowingly with truncate_at=…"
        )


def _add(start_s: Float[np.ndarray, " k"], age_s: Float[np.ndarray, " k *S"]) -> Float[np.ndarray, " k *S"]:
    return start_s.reshape((-1,) + (1,) * (age_s.ndim - 1)) + age_s
