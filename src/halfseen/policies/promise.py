"""What states a policy was learned for, so that whoever serves it can be told when its cell differs from the log."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pandas as pd

from halfseen.errors import PolicyError
from halfseen.logs import Logs
from halfseen.shapes import Float

NUM_KNOTS = 21


def promised_states(logs: Logs, covariates: Sequence[str]) -> list[dict[str, Any]]:
    """Describe the covariates of each stage of a log: of numbers a distribution function, of names their shares.

    Parameters
    ----------
    logs
        The log.
    covariates
        Columns that the policy looks at.

    Returns
    -------
    list of dict
        For each stage its number, the number of states, and by covariate ``values`` with the share of states ``below``
        or at each, or ``names`` with their ``shares``.
    """
    return [
        {
            "stage": int(number),
            "num_states": len(rows),
            "covariates": {name: _described(rows[name]) for name in covariates},
        }
        for number, rows in _by_stage(logs)
    ]


def _by_stage(logs: Logs) -> Iterable[tuple[Any, Any]]:
    return logs.stages.groupby("stage")


def _described(values: Any) -> dict[str, list[Any]]:
    if pd.api.types.is_numeric_dtype(values.dtype):
        numbers = np.sort(values.to_numpy(dtype=np.float64))
        knots = np.unique(np.quantile(numbers, np.linspace(0.0, 1.0, NUM_KNOTS), method="lower"))
        return {"values": knots.tolist(), "below": below(numbers, knots).tolist()}
    shares = values.astype(str).value_counts(normalize=True).sort_index()
    return {"names": shares.index.tolist(), "shares": shares.tolist()}


def check_promise(promise: Any) -> None:
    """Refuse a promise that is none.

    Parameters
    ----------
    promise
        What policy.json holds; folders that were written before there were any have none.

    Raises
    ------
    PolicyError
        It is not as it is written.
    """
    if not (_is_value(promise.get("value")) and all(map(_is_stage, promise["stages"]))):
        raise PolicyError("promise holds other than a value and the states of each stage; learn the policy anew")


def _is_value(value: Any) -> bool:
    return value is None or all(np.isfinite(float(value[name])) for name in ("value", "low", "high", "standard_error"))


def _is_stage(stage: Any) -> bool:
    told = stage["covariates"].values()
    return stage["stage"] >= 1 and stage["num_states"] >= 1 and all(map(_is_distribution, told))


def _is_distribution(told: Any) -> bool:
    places, shares = (told["values"], told["below"]) if "values" in told else (told["names"], told["shares"])
    is_sorted = "values" not in told or bool((np.diff(np.array(places, dtype=float)) > 0.0).all())
    return is_sorted and len(places) == len(shares) > 0 and all(0.0 <= float(each) <= 1.0 for each in shares)


def below(sorted_numbers: Float[np.ndarray, " n"], knots: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """Share of numbers, in order, that lie below each knot or at it."""
    return np.searchsorted(sorted_numbers, knots, side="right") / len(sorted_numbers)
