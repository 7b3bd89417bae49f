"""The distribution of cuts: Ĝ on the clock of a trajectory (total time), or of each stage (gap time).

========  ============================================================================================
``by``    what the model is fitted to
========  ============================================================================================
trajectory      one row per trajectory: its end, and its initial covariates
stage     for each stage t its own model: its observed duration, its covariates and its action
pooled    the same, one model for the rows of all stages
========  ============================================================================================

On the clock of stages, a trajectory is uncut until U_t with probability Ĝ(U_t⁻) = Π_{s≤t} K̂_s(D_s⁻ | S_s, A_s), where
D_s is the duration of stage s: cuts may depend on the history through S_s and A_s [Robins1992]_.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import pandas as pd

from halfseen.censoring.clocks import StageClocks
from halfseen.censoring.cox import Cox
from halfseen.censoring.inputs import checked_truncation, varies
from halfseen.censoring.model import CensoringModel, is_fitted, named_model, uses_covariates
from halfseen.censoring.weights import stage_weights
from halfseen.errors import ArgumentError, HalfseenError, PositivityError
from halfseen.estimator import check_names
from halfseen.shapes import Bool, Float, Int

CensoringBy = Literal["trajectory", "stage", "pooled"]
CENSORING_BY: tuple[str, ...] = get_args(CensoringBy)


STAGE_RIDGE = 1.0
"""Penalty of ``"cox"`` on the clock of stages: few cuts occur per stage and action, and none in some."""


class FittedRows(NamedTuple):
    """A fitted model, and the columns of the covariates that it uses."""

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
        Largest weight 1/Ĝ allowed; None for no truncation.
    """

    by: CensoringBy
    fitted: tuple[FittedRows, ...]
    truncate_at: float | int | None = None

    def survival(
        self, trajectories: StageClocks, age_s: Float[np.ndarray, "n T *S"], is_wanted: Bool[np.ndarray, "n T"]
    ) -> Float[np.ndarray, "n T *S"]:
        """K̂: probability that a stage, given that it began, is not cut before these ages; 1 where not wanted.

        Parameters
        ----------
        trajectories
            The log, or another one with the same covariates.
        age_s
            Time since the stage began [s].
        is_wanted
            Stages to evaluate, among those that began.
        """
        probabilities, (trajectory, stage) = np.ones(age_s.shape), np.nonzero(is_wanted)
        age = age_s[trajectory, stage]
        if self.by == "trajectory":
            start = trajectories.begun_at_s[trajectory, stage]
            wide, first = (-1,) + (1,) * (age.ndim - 1), np.zeros_like(stage)
            times = start, start.reshape(wide) + age
            begun, end = (self._ask(0, trajectories, at_s, trajectory, first) for at_s in times)
            probabilities[trajectory, stage] = end / np.where(begun > 0, begun, 1.0).reshape(wide)
            return probabilities
        for which in np.unique(stage).tolist() if self.by == "stage" else [0]:
            some = stage == which if self.by == "stage" else np.ones(len(stage), dtype=bool)
            asked = trajectory[some], stage[some]
            probabilities[asked] = self._ask(which, trajectories, age[some], *asked)
        return probabilities

    def weights(self, trajectories: StageClocks) -> Float[np.ndarray, "n T"]:
        """δ_t / Ĝ(U_t⁻), 0 if a stage was not completed.

        Raises
        ------
        PositivityError
            Ĝ is 0 at an observed completion, without truncation; the message names trajectory and stage.
        """
        if self.by == "trajectory":
            model, columns = self.fitted[0]
            began = _frame(trajectories.covariate_names, trajectories.covariates[:, 0], columns)
            ends = trajectories.elapsed_s, trajectories.end_s, trajectories.is_finished
            ids = trajectories.trajectory_ids
            return stage_weights(*ends, model, self.truncate_at, covariates=began, trajectory_ids=ids)
        within = self.survival(trajectories, trajectories.watched_s, trajectories.is_completed)
        survival = np.cumprod(np.where(trajectories.is_completed, within, 1.0), axis=1)
        if self.truncate_at is None:
            _refuse_unseen(trajectories, survival)
            return np.where(trajectories.is_completed, 1.0 / survival, 0.0)
        return np.where(trajectories.is_completed, 1.0 / np.maximum(survival, 1.0 / self.truncate_at), 0.0)

    def begun_weights(self, trajectories: StageClocks) -> Float[np.ndarray, "n T"]:
        """1 / Ĝ(U_{t−1}⁻) of each stage that began, i.e. the weight of the stage before; 0 elsewhere."""
        before = np.pad(self.weights(trajectories)[:, :-1], ((0, 0), (1, 0)), constant_values=1.0)
        return np.where(trajectories.is_begun, before, 0.0)

    def _ask(
        self, which: int, trajectories: StageClocks, at_s: Float[np.ndarray, " k *S"], trajectory: Any, stage: Any
    ) -> Float[np.ndarray, " k *S"]:
        model, columns = self.fitted[which]
        known = _frame(trajectories.covariate_names, trajectories.covariates[trajectory, stage], columns)
        return np.asarray(model.survival(at_s, known), dtype=np.float64)


@dataclass(frozen=True)
class CensoringSpec:
    """An unfitted censoring model and its time scale.

    Parameters
    ----------
    model
        ``"kaplan-meier"``, ``"cox"``, ``"kernel"``, or a fitted or unfitted `CensoringModel` for Ĝ.
    by
        ``"trajectory"``: Ĝ on the total-time scale, given the initial covariates; ``"stage"``: a model for each stage,
        on the gap-time scale; ``"pooled"``: one such model for all stages (see `cut_model`). By stage or pooled,
        ``"cox"`` is ``Cox(ridge=1)``.
    covariates
        Covariates of a model that uses them: columns of the stages, and ``"action"`` for the action; for a table
        ``"num_objects"``, ``"mean_occlusion"``, ``"action"``, ``"target_occlusion"``. None for all; by trajectory the
        action is excluded, and for tables only the first two, of the first table, are used.
    truncate_at
        Largest weight 1/Ĝ allowed; None for no truncation.

    Raises
    ------
    ArgumentError
        The model or clock does not exist, the covariates are not a list, or the bound is below 1.
    """

    model: str | CensoringModel = "kaplan-meier"
    by: CensoringBy | str = "trajectory"
    covariates: Sequence[str] | None = None
    truncate_at: float | int | None = None

    def __post_init__(self) -> None:
        named_model(self.model)
        if self.by not in CENSORING_BY:
            raise ArgumentError(f"by is {self.by!r}; give {', '.join(map(repr, CENSORING_BY[:-1]))} or 'pooled'")
        if self.covariates is not None:
            check_names("covariates", self.covariates)
        checked_truncation(self.truncate_at)
        if self.covariates is not None and not self.uses_covariates:
            raise ArgumentError(
                f"covariates is {list(self.covariates)}, but {self.name} uses none; leave them out, or choose 'cox' or "
                "'kernel'"
            )

    @property
    def name(self) -> str:
        """Name of the model, or its repr for an object."""
        return self.model if isinstance(self.model, str) else repr(self.model)

    @property
    def uses_covariates(self) -> bool:
        """Whether the model conditions on covariates."""
        return uses_covariates(named_model(self.model))

    def looks_at(self, clocks: StageClocks) -> StageClocks | None:
        """The part of the clocks that Ĝ is fitted to, besides the ends of the trajectories; None if nothing."""
        if self.by != "trajectory":
            return clocks
        # On the clock of trajectories, Ĝ uses only the initial covariates.
        return clocks.begun() if self.uses_covariates else None

    def fit_cuts(self, clocks: StageClocks) -> CutModel:
        """Fit Ĝ to a log; a fitted model is used as it is.

        Raises
        ------
        ArgumentError
            The model cannot be fitted, or needs the action of a cut stage, which was not logged.
        """
        by: Any = self.by
        model, names, stages = self.model, clocks.covariate_names, np.arange(clocks.num_stages)
        if not isinstance(model, str) and is_fitted(model):
            columns = np.arange(len(names) if uses_covariates(model) else 0)
            fitted = [FittedRows(model, columns)] * (clocks.num_stages if by == "stage" else 1)
        elif by == "trajectory":
            _refuse_unknown(clocks, np.broadcast_to(stages == 0, clocks.is_begun.shape))
            rows = clocks.end_s, clocks.is_finished, clocks.covariates[:, 0]
            fitted = [_fit(model, *rows, names, "a trajectory's first stage")]
        else:
            model, fitted = Cox(ridge=STAGE_RIDGE) if isinstance(model, str) and model == "cox" else model, []
            for t in stages if by == "stage" else [None]:
                wanted = clocks.is_begun if t is None else clocks.is_begun & (stages == t)
                if not wanted.any():
                    # No trajectory reached this stage, so the model is never evaluated either.
                    fitted.append(fitted[-1])
                    continue
                _refuse_unknown(clocks, wanted)
                rows = clocks.watched_s[wanted], clocks.is_completed[wanted], clocks.covariates[wanted]
                fitted.append(_fit(model, *rows, names, "all stages" if t is None else f"stage {t + 1}"))
        return CutModel(by, tuple(fitted), self.truncate_at)


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
    columns = np.flatnonzero(varies(covariates)) if len(covariates) else np.arange(0)
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
            f"trajectory {trajectories.trajectory_ids[trajectory]}, stage {stage + 1}: {name} is not known, but "
            "the model of the cuts uses it; log the action of the stage in which a trajectory is cut, or leave "
            "'action' out of censoring_covariates"
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
