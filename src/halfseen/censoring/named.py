"""Censoring models by name, and what else may stand for one."""

from copy import deepcopy
from types import NoneType
from typing import Any

from numpy.typing import ArrayLike

from halfseen.censoring.cox import Cox
from halfseen.censoring.kaplan_meier import KaplanMeier
from halfseen.censoring.kernel_kaplan_meier import KernelKaplanMeier
from halfseen.censoring.model import CensoringModel, is_fitted
from halfseen.errors import ArgumentError

MODELS = {"kaplan-meier": KaplanMeier, "cox": Cox, "kernel": KernelKaplanMeier}
CENSORING_NAMES = tuple(MODELS)
"""Names that `named_model` takes."""


def named_model(censoring: str | CensoringModel) -> CensoringModel:
    """Make a model of one's own to fit.

    Parameters
    ----------
    censoring
        ``"kaplan-meier"``, ``"cox"`` or ``"kernel"``; or a model, which is copied, with what it was fitted to.

    Raises
    ------
    ArgumentError
        There is no such name, or the object is no model.
    """
    if isinstance(censoring, str) and censoring in MODELS:
        return MODELS[censoring]()
    if isinstance(censoring, (str, type)) or not isinstance(censoring, CensoringModel):
        names = ", ".join(repr(name) for name in MODELS)
        raise ArgumentError(f"censoring is {censoring!r}; it is {names}, or a model with fit and survival")
    return deepcopy(censoring)


def fitted_model(
    model: str | CensoringModel | None, time: ArrayLike, is_finished: ArrayLike, covariates: Any
) -> CensoringModel:
    """Take a fitted model as it is; fit a name, or a copy of an unfitted model, to these trajectories.

    Parameters
    ----------
    model
        A name, a model, or None for Kaplan–Meier.
    time
        Observed end of each trajectory [s], shape (n,).
    is_finished
        False where the trajectory was cut, shape (n,).
    covariates
        One row for each trajectory, or None.

    Raises
    ------
    ArgumentError
        There is no such model, or it cannot be fitted.
    """
    if not isinstance(model, (str, type, NoneType)) and is_fitted(model):
        return model
    return named_model("kaplan-meier" if model is None else model).fit(time, is_finished, covariates)
