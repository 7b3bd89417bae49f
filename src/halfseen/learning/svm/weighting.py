"""How much each row counts, by inverse probability of censoring: w = δ / Ĝ(min(T, τ)⁻ | z)."""

import numpy as np

from halfseen.arrays import Rows
from halfseen.censoring import CensoringModel, censoring_weights, named_model, uses_covariates
from halfseen.errors import ArgumentError, PositivityError
from halfseen.learning.svm.targets import Ends


def check_lengths(rows: np.ndarray, targets: np.ndarray) -> None:
    """Refuse rows and targets that do not pair.

    Raises
    ------
    ArgumentError
        Their numbers differ.
    """
    if len(rows) != len(targets):
        raise ArgumentError(f"X has {len(rows)} rows and y has {len(targets)}; give one target a row")


def row_weights(
    ends: Ends | None,
    rows: np.ndarray,
    counts: Rows,
    censoring: str | CensoringModel,
    tau: float | None,
    truncate_at: float | int | None,
) -> tuple[Rows, CensoringModel | None]:
    """Weight of each row, and the censoring model that gave it.

    Parameters
    ----------
    ends
        Times and whether they were seen; None if nothing could be cut.
    rows
        Covariates, for models that use them, shape (n, F), or sets.
    counts
        How many rows each one stands for. Ĝ is fitted to the rows above 0, each once.
    censoring
        Name of a model, a model to fit anew, or ``"none"``: rows that were seen count alike.
    tau
        τ [s], if times are restricted.
    truncate_at
        Largest 1/Ĝ allowed, if any.

    Raises
    ------
    ArgumentError
        The model needs covariates, and the rows are sets.
    PositivityError
        Nothing was seen, or Ĝ is 0 where something was.
    """
    if ends is None:
        return counts, None
    seen, counted = ends.restricted(tau), counts > 0
    if not seen.is_finished[counted].any():
        raise PositivityError(
            f"all {len(rows)} paths were cut before their target was seen; record until some finish, or give a tau "
            "that some outlived"
        )
    if isinstance(censoring, str) and censoring == "none":
        return counts * seen.is_finished, None
    model = named_model(censoring)
    covariates = _covariates(model, rows)
    model.fit(ends.time[counted], ends.is_finished[counted], None if covariates is None else covariates[counted])
    weights = censoring_weights(
        seen.time, seen.is_finished & counted, model, covariates=covariates, truncate_at=truncate_at
    )
    return counts * weights, model


def _covariates(model: CensoringModel, rows: np.ndarray) -> np.ndarray | None:
    if not uses_covariates(model):
        return None
    if rows.dtype == object:
        raise ArgumentError("censoring uses covariates, and X holds sets; choose 'kaplan-meier'")
    return rows
