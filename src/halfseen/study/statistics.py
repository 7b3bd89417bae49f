"""Means over repetitions with Student's t, and one-sided paired tests that are adjusted for their number."""

from typing import Any, Literal, NamedTuple

import numpy as np
import pandas as pd
from scipy import stats

from halfseen.evaluation.estimate import Estimate, around, estimate_of
from halfseen.shapes import Float

LEVEL = 0.95


def over_repetitions(values: Float[np.ndarray, " R"]) -> Estimate:
    """Mean over repetitions with its 95 % interval."""
    return estimate_of(np.asarray(values, dtype=np.float64), len(values), LEVEL)


def columns(estimate: Estimate, value: str, se: str, low: str, high: str) -> dict[str, float]:
    """An estimate as columns of a table."""
    return {value: estimate.value, se: estimate.standard_error, low: estimate.low, high: estimate.high}


def mean_columns(values: Float[np.ndarray, " R"], *names: str) -> dict[str, float]:
    """Mean over repetitions, as columns of these names: value, standard error, and ends of the interval."""
    return columns(over_repetitions(values), *(names or ("mean_reward", "se", "low", "high")))


def estimate_in(row: Any, value: str, se: str, num_repetitions: int) -> Estimate:
    """Read an estimate back from the columns of a table."""
    return around(float(row[value]), float(row[se]), num_repetitions, num_repetitions - 1, LEVEL)


class PairedTest(NamedTuple):
    """A Wilcoxon signed-rank test over matched repetitions, and the mean difference."""

    p_value: float
    effect: Estimate


def paired_test(ours: Float[np.ndarray, " R"], other: Float[np.ndarray, " R"], is_more_better: bool) -> PairedTest:
    """Test H₁: ours is better than the other, repetition by repetition; the effect is ours − other."""
    return signed_rank_test(np.asarray(ours) - np.asarray(other), "greater" if is_more_better else "less")


def signed_rank_test(
    difference: Float[np.ndarray, " R"], alternative: Literal["greater", "less", "two-sided"]
) -> PairedTest:
    """Test H₁: differences lie above 0, below 0, or on one side of it."""
    effect = over_repetitions(difference)
    if not np.any(difference):
        return PairedTest(1.0, effect)
    # The normal approximation, with its correction for ties: block means of a few dozen repetitions do tie.
    test: Any = stats.wilcoxon(difference, alternative=alternative, method="approx")
    return PairedTest(float(test.pvalue), effect)


def tested_columns(test: PairedTest) -> dict[str, float]:
    """Columns p_value, effect, effect_low and effect_high."""
    effect = test.effect
    return {"p_value": test.p_value, "effect": effect.value, "effect_low": effect.low, "effect_high": effect.high}


def holm(p_values: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """Holm's step-down adjustment of p-values [Holm1979]_; what was not tested (NaN) stays so and does not count."""
    tested = np.flatnonzero(np.isfinite(p_values))
    order = tested[np.argsort(p_values[tested])]
    scaled = p_values[order] * np.arange(len(order), 0, -1)
    adjusted = np.full_like(p_values, np.nan)
    adjusted[order] = np.minimum(1.0, np.maximum.accumulate(scaled))
    return adjusted


def adjusted(table: pd.DataFrame, alpha: float) -> pd.DataFrame:
    """Add p_holm and supported to a table of tests, in the order in which such tables are read."""
    table = table.assign(p_holm=holm(table["p_value"].to_numpy(dtype=float)))
    table = table.assign(supported=(table["p_holm"] < alpha).astype("boolean").mask(table["p_holm"].isna()))
    last = ["p_value", "p_holm", "effect", "supported", "effect_low", "effect_high"]
    return table.loc[:, [*table.columns.drop(last), *last]]
