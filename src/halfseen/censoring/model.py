"""The protocol of censoring models, which estimate P(C ≥ u | z) from the ends of trajectories; and models by name."""

from copy import deepcopy
from types import NoneType
from typing import Any, Protocol, runtime_checkable

import numpy as np
from numpy.typing import ArrayLike

from halfseen.censoring.cox import Cox
from halfseen.censoring.kaplan_meier import KaplanMeier
from halfseen.censoring.kernel_kaplan_meier import KernelKaplanMeier
from halfseen.errors import ArgumentError
from halfseen.shapes import Float


@runtime_checkable
class CensoringModel(Protocol):
    """Estimates the distribution of C, the time at which something outside the task cuts (right-censors) a trajectory.

    C is itself right-censored, by the trajectory's own end. At equal times completions come before cuts.

    A fitted model has an attribute whose name ends in ``_``, as in scikit-learn; a model without one is copied and
    fitted by its caller. A model that conditions on covariates has ``uses_covariates = True``; the default is False
    (`uses_covariates`).
    """

    def fit(self, time: ArrayLike, is_finished: ArrayLike, covariates: Any = None) -> "CensoringModel":
        """Fit to the observed ends of trajectories.

        Parameters
        ----------
        time
            Observed end of each trajectory [s], finite and positive, shape (n,).
        is_finished
            False if the trajectory was cut, shape (n,).
        covariates
            Covariates to condition on, one row per trajectory, shape (n, p): array-like, or a table, whose names are
            kept for messages. None for a model without covariates.
        """
        ...

    def survival(self, u: ArrayLike, covariates: Any = None) -> Float[np.ndarray, "..."]:
        """Ĝ(u⁻ | z) = P(C ≥ u | z), the left limit.

        Parameters
        ----------
        u
            Times of the query [s], any shape.
        covariates
            One row for each entry of the first axis of `u`, or a single row for all of `u`; columns as in the fit.

        Returns
        -------
        Float[ndarray, "..."]
            The left limits, in the shape of `u`.
        """
        ...


def is_fitted(model: Any) -> bool:
    """Whether a model, or any estimator, is fitted, as in scikit-learn: it has an attribute that ends in ``_``."""
    own_word = getattr(model, "__sklearn_is_fitted__", None)
    if own_word is not None:
        return bool(own_word())
    return any(name.endswith("_") and not name.startswith("_") for name in getattr(model, "__dict__", ()))


def uses_covariates(model: CensoringModel) -> bool:
    """Whether a model conditions on covariates; False by default."""
    return bool(getattr(model, "uses_covariates", False))


MODELS = {"kaplan-meier": KaplanMeier, "cox": Cox, "kernel": KernelKaplanMeier}
CENSORING_NAMES = tuple(MODELS)
"""Names that `named_model` accepts."""


def named_model(censoring: str | CensoringModel) -> CensoringModel:
    """Make an independent model to fit.

    Parameters
    ----------
    censoring
        ``"kaplan-meier"``, ``"cox"`` or ``"kernel"``; or a model, which is copied, including its fit.

    Raises
    ------
    ArgumentError
        The name does not exist, or the object is not a model.
    """
    if isinstance(censoring, str) and censoring in MODELS:
        return MODELS[censoring]()
    if isinstance(censoring, (str, type)) or not isinstance(censoring, CensoringModel):
        names = ", ".join(repr(name) for name in MODELS)
        raise ArgumentError(f"censoring is {censoring!r}; give {names}, or a model with fit and survival")
    return deepcopy(censoring)


def fitted_model(
    model: str | CensoringModel | None, time: ArrayLike, is_finished: ArrayLike, covariates: Any
) -> CensoringModel:
    """Return a fitted model as it is; fit a named one (None for Kaplan–Meier), or a copy of an unfitted one."""
    if not isinstance(model, (str, type, NoneType)) and is_fitted(model):
        return model
    return named_model("kaplan-meier" if model is None else model).fit(time, is_finished, covariates)
