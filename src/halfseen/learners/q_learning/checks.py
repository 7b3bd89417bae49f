"""Which values the parameters of a learner can take: one with those of `CensoredQLearner`."""

from numbers import Real
from typing import Any

import numpy as np
from jaxtyping import Float

from halfseen.arrays import RowMask
from halfseen.censoring import CENSORING_NAMES, is_fitted
from halfseen.errors import ArgumentError, PositivityError
from halfseen.learners.q_learning.cut_model import CENSORING_BY
from halfseen.tables.grasp.grasp_table import GraspEstimator

NONE, BUCKLEY_JAMES = "none", "buckley-james"
CENSORING_CHOICES = (*CENSORING_NAMES, NONE, BUCKLEY_JAMES)
"""Names that ``censoring`` takes."""

Q_FUNCTIONS = ("linear", "kernel")


def check_parameters(learner: Any, is_table: bool) -> None:
    """Refuse a parameter with a value that it cannot take.

    Raises
    ------
    ArgumentError
        The parameter, its value and what it can be are named.
    """
    if learner.horizon < 1:
        raise ArgumentError(f"horizon is {learner.horizon}; a path has at least 1 stage")
    _check_choice("q_function", learner.q_function, Q_FUNCTIONS)
    _check_choice("stages", learner.stages, ("separate", "pooled"))
    _check_choice("censoring_by", learner.censoring_by, CENSORING_BY)
    if isinstance(learner.censoring, str):
        _check_choice("censoring", learner.censoring, CENSORING_CHOICES, "a CensoringModel")
    if learner.reg != "cv" and not _is_number(learner.reg, 0.0):
        raise ArgumentError(f"reg is {learner.reg!r}; it is a λ ≥ 0, or 'cv'")
    if learner.reg == "cv" and learner.num_folds < 2:
        raise ArgumentError(f"num_folds is {learner.num_folds}; cross-validation needs at least 2")
    if learner.num_landmarks < 1:
        raise ArgumentError(f"num_landmarks is {learner.num_landmarks}; a kernel needs at least 1")
    if learner.gamma is not None and not (_is_number(learner.gamma, 0.0) and learner.gamma > 0):
        raise ArgumentError(f"gamma is {learner.gamma!r}; it is a finite number > 0, or None for 1/F")
    _check_table_only(learner, is_table)
    _check_imputation(learner, is_table)


def check_streamable(learner: Any) -> None:
    """Refuse what needs the whole log at once.

    Raises
    ------
    ArgumentError
        The parameter is named.
    """
    wrong = {
        "censoring_by": learner.censoring_by != "path",
        "augmented": learner.augmented,
        "censoring": isinstance(learner.censoring, str) and learner.censoring == BUCKLEY_JAMES,
        "reduces_variance": learner.reduces_variance,
        "grasp": isinstance(learner.grasp, GraspEstimator) and not is_fitted(learner.grasp),
    }
    for name, is_wrong in wrong.items():
        if is_wrong:
            raise ArgumentError(
                f"{name} is {getattr(learner, name)!r}, which needs the whole log in memory, and a stream was given; "
                "learn from read_logs(folder), or choose censoring_by='path', weights, reduces_variance=False and a "
                "grasp model that is fitted"
            )


def refuse_all_cut(is_finished: RowMask) -> None:
    """Refuse a log in which no path came to its own end.

    Raises
    ------
    PositivityError
        All were cut.
    """
    if not is_finished.any():
        raise PositivityError(
            f"all {len(is_finished)} paths were cut, so how a path ends was never seen; record until some finish, or "
            "shorten the horizon so that reaching it counts as finished"
        )


def refuse_too_few(weight: Float[np.ndarray, "*B n T"]) -> None:
    """Refuse to hold out paths where fewer than two completed a stage.

    Raises
    ------
    ArgumentError
        Their number is told.
    """
    num_seen = int((weight > 0).any(axis=-1).sum())
    if num_seen < 2:
        raise ArgumentError(
            f"reg is 'cv', which holds out paths, but {num_seen} of {weight.shape[-2]} completed a stage; give a "
            "number for reg, or record more paths"
        )


def _check_table_only(learner: Any, is_table: bool) -> None:
    if learner.grasp is not None and not is_table:
        raise ArgumentError("grasp is given, but actions are named ones; only a table's objects are grasped")
    if learner.reduces_variance and not is_table:
        raise ArgumentError("reduces_variance is True, but actions are named ones; only a table's noise is known")


def _check_imputation(learner: Any, is_table: bool) -> None:
    if learner.augmented and isinstance(learner.censoring, str) and learner.censoring in (NONE, BUCKLEY_JAMES):
        raise ArgumentError(f"augmented weights need a model of the cuts, but censoring is {learner.censoring!r}")
    if learner.outcome_covariates is None:
        return
    if is_table or learner.q_function != "linear":
        raise ArgumentError("outcome_covariates is given; it chooses among the covariates of a linear Q only")
    unknown = [name for name in learner.outcome_covariates if name not in learner.covariates]
    if unknown:
        raise ArgumentError(
            f"outcome_covariates names {unknown[0]!r}, which is none of the covariates {', '.join(learner.covariates)}"
        )


def _check_choice(name: str, value: Any, choices: tuple[str, ...], other: str = "") -> None:
    if value not in choices:
        listed = [repr(choice) for choice in choices]
        *first, last = [*listed, other] if other else listed
        raise ArgumentError(f"{name} is {value!r}; it is {', '.join(first)} or {last}")


def _is_number(value: Any, least: float) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool) and least <= float(value) < np.inf
