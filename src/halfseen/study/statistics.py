"""Means with their errors, and one-sided paired tests that are adjusted for their number."""

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy import stats


class PairedTest(NamedTuple):
    """A one-sided Wilcoxon signed-rank test over matched replicates, with the mean difference and its 95 % interval."""

    p_value: float
    effect: float
    effect_low: float
    effect_high: float


def mean_and_error(values: Float[np.ndarray, " R"]) -> tuple[float, float]:
    """Mean over replicates and its standard error."""
    return float(np.mean(values)), float(np.std(values, ddof=1) / np.sqrt(len(values)))


def paired_test(ours: Float[np.ndarray, " R"], other: Float[np.ndarray, " R"], is_more_better: bool) -> PairedTest:
    """Test H₁: ours is better than the other, replicate by replicate.

    The effect is the mean of ours − other, with a t interval.
    """
    difference = ours - other
    effect, error = mean_and_error(difference)
    reach = float(stats.t.ppf(0.975, len(difference) - 1)) * error
    if not np.any(difference):
        return PairedTest(1.0, effect, effect, effect)
    alternative = "greater" if is_more_better else "less"
    # The normal approximation, with its correction for ties: block means of a few dozen replicates do tie.
    test: Any = stats.wilcoxon(difference, alternative=alternative, method="approx")
    return PairedTest(float(test.pvalue), effect, effect - reach, effect + reach)


def holm(p_values: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """Holm's step-down adjustment of p-values [Holm1979]_."""
    order = np.argsort(p_values)
    scaled = p_values[order] * np.arange(len(p_values), 0, -1)
    adjusted = np.empty_like(p_values)
    adjusted[order] = np.minimum(1.0, np.maximum.accumulate(scaled))
    return adjusted
