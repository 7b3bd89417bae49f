"""Who is cut, and when: Ĝ on the clock of a path (total time), or on that of each stage (gap time).

========  ============================================================================================
``by``    what the model is fitted to
========  ============================================================================================
path      one row a path: its end, and the covariates with which it began
stage     for each stage t its own model: how long it was watched, its covariates and its action
pooled    the same, one model for the rows of all stages
========  ============================================================================================

On the clock of stages, a path is uncut until U_t with probability Ĝ(U_t⁻) = Π_{s≤t} K̂_s(D_s⁻ | S_s, A_s), where D_s is
the duration of stage s: cuts may depend on all that a path has shown so far, through S_s and A_s [Robins1992]_.
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

CensoringBy = Literal["path", "stage", "pooled"]
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
        ``"path"``, ``"stage"`` or ``"pooled"``.
    fitted
        One model; or one for each stage.
    truncate_at
        Largest weight 1/Ĝ allowed; None truncates nothing.
    """

    by: CensoringBy
    fitted: tuple[FittedRows, ...]
    truncate_at: float | int | None = None

    def survival(
        self, paths: StageClocks, age_s: Float[np.ndarray, "n T *S"], is_wanted: Bool[np.ndarray, "n T"]
    ) -> Float[np.ndarray, "n T *S"]:
        """K̂: probability that a begun stage is not cut before these ages, given that it began; 1 where not wanted.

        Parameters
        ----------
        paths
            The log, or another one with the same covariates.
        age_s
            Time since the stage began [s].
        is_wanted
            Begun stages that are asked about.
        """
        probabilities = np.ones(age_s.shape)
        if self.by == "path":
            path, stage = np.nonzero(is_wanted)
            start = paths.begun_at_s[path, stage]
            begun = self._ask(0, paths, start, path, np.zeros_like(stage))
            end = self._ask(0, paths, _add(start, age_s[path, stage]), path, np.zeros_like(stage))
            probabilities[path, stage] = end / np.where(begun > 0, begun, 1.0).reshape((-1,) + (1,) * (end.ndim - 1))
            return probabilities
        if self.by == "pooled":
            path, stage = np.nonzero(is_wanted)
            probabilities[path, stage] = self._ask(0, paths, age_s[path, stage], path, stage)
            return probabilities
        for t in range(is_wanted.shape[1]):
            path = np.flatnonzero(is_wanted[:, t])
            if len(path):
                probabilities[path, t] = self._ask(t, paths, age_s[path, t], path, np.full_like(path, t))
        return probabilities

    def weights(self, paths: StageClocks) -> Float[np.ndarray, "n T"]:
        """δ_t / Ĝ(U_t⁻), 0 where a stage was not completed.

        Raises
        ------
        PositivityError
            Ĝ is 0 at an observed completion, and no truncation was asked for; path and stage are named.
        """
        if self.by == "path":
            model, columns = self.fitted[0]
            return stage_weights(
                paths.elapsed_s,
                paths.end_s,
                paths.is_finished,
                model,
                self.truncate_at,
                covariates=_frame(paths.covariate_names, paths.covariates[:, 0], columns),
                path_ids=paths.path_ids,
            )
        within = self.survival(paths, paths.watched_s, paths.is_completed)
        survival = np.cumprod(np.where(paths.is_completed, within, 1.0), axis=1)
        if self.truncate_at is None:
            _refuse_unseen(paths, survival)
            return np.where(paths.is_completed, 1.0 / survival, 0.0)
        return np.where(paths.is_completed, 1.0 / np.maximum(survival, 1.0 / self.truncate_at), 0.0)

    def begun_weights(self, paths: StageClocks) -> Float[np.ndarray, "n T"]:
        """1 / Ĝ(U_{t−1}⁻) of each begun stage: what the stage before it weighed; 0 elsewhere."""
        before = np.concatenate([np.ones((paths.num_paths, 1)), self.weights(paths)[:, :-1]], axis=1)
        return np.where(paths.is_begun, before, 0.0)

    def _ask(
        self, which: int, paths: StageClocks, at_s: Float[np.ndarray, " k *S"], path: Any, stage: Any
    ) -> Float[np.ndarray, " k *S"]:
        model, columns = self.fitted[which]
        return np.asarray(
            model.survival(at_s, _frame(paths.covariate_names, paths.covariates[path, stage], columns)),
            dtype=np.float64,
        )


def fit_cut_model(
    paths: StageClocks,
    censoring: str | CensoringModel,
    by: CensoringBy,
    truncate_at: float | int | None = None,
) -> CutModel:
    """Fit Ĝ to a log; a model that is fitted already is taken as it is.

    Parameters
    ----------
    paths
        The log.
    censoring
        Name of a model, or a model.
    by
        ``"path"``, ``"stage"`` or ``"pooled"``.
    truncate_at
        Largest weight allowed.

    Raises
    ------
    ArgumentError
        The model cannot be fitted, or needs the action of a stage in which a path was cut, which was not logged.
    """
    if not isinstance(censoring, str) and is_fitted(censoring):
        columns = np.arange(len(paths.covariate_names) if uses_covariates(censoring) else 0)
        which = paths.num_stages if by == "stage" else 1
        return CutModel(by, (FittedRows(censoring, columns),) * which, truncate_at)
    if by == "path":
        _refuse_unknown(paths, np.broadcast_to(np.arange(paths.num_stages) == 0, paths.is_begun.shape))
        rows = paths.end_s, paths.is_finished, paths.covariates[:, 0]
        return fit_path_cuts(*rows, paths.covariate_names, censoring, truncate_at)
    if isinstance(censoring, str) and censoring == "cox":
        censoring = Cox(ridge=STAGE_RIDGE)
    fitted = []
    for t in range(paths.num_stages) if by == "stage" else [None]:
        wanted = paths.is_begun if t is None else paths.is_begun & (np.arange(paths.num_stages) == t)
        if not wanted.any():
            # No path came so far: nothing can be asked of it either.
            fitted.append(fitted[-1])
            continue
        _refuse_unknown(paths, wanted)
        rows = paths.watched_s[wanted], paths.is_completed[wanted], paths.covariates[wanted]
        where = "all stages" if t is None else f"stage {t + 1}"
        fitted.append(_fit(censoring, *rows, paths.covariate_names, where))
    return CutModel(by, tuple(fitted), truncate_at)


def fit_path_cuts(
    end_s: Rows,
    is_finished: RowMask,
    covariates: Float[np.ndarray, "n P"],
    names: tuple[str, ...],
    censoring: str | CensoringModel,
    truncate_at: float | int | None = None,
) -> CutModel:
    """Fit Ĝ on the clock of paths, given the covariates with which each began."""
    if not isinstance(censoring, str) and is_fitted(censoring):
        columns = np.arange(len(names) if uses_covariates(censoring) else 0)
        return CutModel("path", (FittedRows(censoring, columns),), truncate_at)
    fitted = _fit(censoring, end_s, is_finished, covariates, names, "a path's first stage")
    return CutModel("path", (fitted,), truncate_at)


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
            f"censoring uses covariates, and none of those of {where} differs between paths; choose 'kaplan-meier'"
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


def _refuse_unknown(paths: StageClocks, wanted: Bool[np.ndarray, "n T"]) -> None:
    unknown = wanted & np.isnan(paths.covariates).any(axis=-1)
    if unknown.any():
        path, stage = np.argwhere(unknown)[0]
        name = paths.covariate_names[int(np.argmax(np.isnan(paths.covariates[path, stage])))]
        raise ArgumentError(
            f"path {paths.path_ids[path]}, stage {stage + 1}: {name} is not known, and cuts are to depend on it; log "
            "the action of the stage in which a path is cut, or leave 'action' out of censoring_covariates"
        )


def _refuse_unseen(paths: StageClocks, survival: Float[np.ndarray, "n T"]) -> None:
    unseen = paths.is_completed & (survival <= 0)
    if unseen.any():
        path, stage = np.argwhere(unseen)[0]
        age_s = paths.watched_s[path, stage]
        raise PositivityError(
            f"path {paths.path_ids[path]}, stage {stage + 1}: completed {age_s:g} s after it began, where the "
            f"censoring model leaves no stage uncut (Ĝ = 0), so its weight is not identified; shorten the stages to "
            f"below {age_s:g} s, pool the stages, or truncate the weights knowingly with truncate_at=…"
        )


def _add(start_s: Float[np.ndarray, " k"], age_s: Float[np.ndarray, " k *S"]) -> Float[np.ndarray, " k *S"]:
    return start_s.reshape((-1,) + (1,) * (age_s.ndim - 1)) + age_s
