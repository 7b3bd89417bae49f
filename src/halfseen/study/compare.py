"""Tidy tables: means with Student's t, the paired test of two policies, and how both are written."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
import pandas as pd
from scipy import stats

from halfseen.evaluation.estimate import Estimate, around, estimate_of
from halfseen.shapes import Float
from halfseen.study.experiment import Row
from halfseen.wording import INCONCLUSIVE, MISSING, NOT_SUPPORTED, SUPPORTED, estimated, p_value, share_in_words

LEVEL = 0.95
MEAN = ("mean_reward", "se", "low", "high")
"""Columns of a mean reward: value, standard error, ends of the confidence interval."""
EFFECT = ("effect", "effect_low", "effect_high")
"""Columns of a paired difference, ours − other, in tables of tests."""
TESTED = ["p_value", "p_holm", "effect", "supported", "effect_low", "effect_high"]


def where(table: Any, **values: Any) -> pd.DataFrame:
    """Rows of a data frame with these values, in order; None matches missing values."""
    kept = table
    for name, value in values.items():
        kept = kept[kept[name].isna() if value is None else (kept[name] == value).fillna(False)]
    return pd.DataFrame(kept)


def records(table: Any, **values: Any) -> list[Row]:
    """Rows with these values, as dictionaries."""
    return [{str(name): value for name, value in row.items()} for row in where(table, **values).to_dict("records")]


def row_of(table: Any, **values: Any) -> Row:
    """The first row with these values."""
    return records(table, **values)[0]


def stacked(repetitions: Sequence[Mapping[str, Any]], name: str, *measures: str) -> list[Row]:
    """Rows of this name, the same in all repetitions, with arrays over repetitions for the measures."""
    return [
        rows[0] | {measure: np.array([row[measure] for row in rows]) for measure in measures}
        for rows in zip(*(piece[name] for piece in repetitions), strict=True)
    ]


def four(name: str) -> tuple[str, str, str, str]:
    """Columns of an estimate: value, standard error, and ends of the confidence interval."""
    return name, f"{name}_se", f"{name}_low", f"{name}_high"


def three(name: str) -> list[str]:
    """Columns of a value and its interval."""
    return [name, f"{name}_low", f"{name}_high"]


def over_repetitions(values: Float[np.ndarray, " R"]) -> Estimate:
    """Mean over repetitions with its 95 % confidence interval."""
    return estimate_of(np.asarray(values, dtype=np.float64), len(values), LEVEL)


def columns(estimate: Estimate, value: str, se: str, low: str, high: str) -> dict[str, float]:
    """An estimate as columns of a table."""
    return {value: estimate.value, se: estimate.standard_error, low: estimate.low, high: estimate.high}


def mean_columns(values: Float[np.ndarray, " R"], names: Sequence[str] = MEAN) -> dict[str, float]:
    """Mean over repetitions, as columns of these names."""
    value, se, low, high = names
    return columns(over_repetitions(values), value, se, low, high)


def estimate_in(row: Any, value: str, se: str, num_repetitions: int) -> Estimate:
    """Read an estimate back from the columns of a table."""
    return around(float(row[value]), float(row[se]), num_repetitions, num_repetitions - 1, LEVEL)


class PairedTest(NamedTuple):
    """A Wilcoxon signed-rank test over matched repetitions, and the mean difference."""

    p_value: float
    effect: Estimate

    @property
    def columns(self) -> dict[str, float]:
        """Columns p_value, effect, effect_low and effect_high."""
        effect = self.effect
        return {"p_value": self.p_value, "effect": effect.value, "effect_low": effect.low, "effect_high": effect.high}


def signed_rank_test(
    difference: Float[np.ndarray, " R"], alternative: Literal["greater", "less", "two-sided"]
) -> PairedTest:
    """Test H₁: differences lie above 0, below 0, or on one side of it."""
    effect = over_repetitions(difference)
    if not np.any(difference):
        return PairedTest(1.0, effect)
    # Normal approximation with tie correction: block means of a few dozen repetitions do tie.
    test: Any = stats.wilcoxon(difference, alternative=alternative, method="approx")
    return PairedTest(float(test.pvalue), effect)


def better(ours: Float[np.ndarray, " R"], other: Float[np.ndarray, " R"], measure: str) -> PairedTest:
    """Test H₁: ours is better than the other, repetition by repetition; the effect is ours − other."""
    return signed_rank_test(np.asarray(ours) - np.asarray(other), "greater" if is_reward(measure) else "less")


def holm(p_values: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """Holm's step-down adjustment of p-values [Holm1979]_; NaN (not tested) stays NaN and does not count."""
    tested = np.flatnonzero(np.isfinite(p_values))
    order = tested[np.argsort(p_values[tested])]
    scaled = p_values[order] * np.arange(len(order), 0, -1)
    adjusted = np.full_like(p_values, np.nan)
    adjusted[order] = np.minimum(1.0, np.maximum.accumulate(scaled))
    return adjusted


def adjusted(table: pd.DataFrame, alpha: float) -> pd.DataFrame:
    """Add p_holm and supported to a table of tests, and move the columns of the test to the end."""
    table = table.assign(p_holm=holm(table["p_value"].to_numpy(dtype=float)))
    table = table.assign(supported=(table["p_holm"] < alpha).astype("boolean").mask(table["p_holm"].isna()))
    return table.loc[:, [*table.columns.drop(TESTED), *TESTED]]


def is_reward(measure: str) -> bool:
    """Whether larger values of a measure are better; for times and scores smaller ones are."""
    return measure.endswith("reward")


def learned_from(num_trajectories: int, cut_share: float) -> str:
    """Describe the log that a policy was learned from."""
    cut = "none of them cut" if cut_share == 0 else f"of which about {share_in_words(cut_share)} were cut"
    return f"learned from {num_trajectories} logged trajectories, {cut},"


def estimated_in(row: Row, names: Sequence[str], decimals: int = 2) -> str:
    """Write a value and its interval from these columns of a row."""
    return estimated(*(row[name] for name in names), decimals=decimals)


def gain_in(row: Row) -> Estimate:
    """The effect in a row of a table of tests, above 0 if ours is better."""
    value, low, high = (float(row[name]) for name in EFFECT)
    value, low, high = (value, low, high) if is_reward(row["measure"]) else (-value, -high, -low)
    return Estimate(value, low, high, float("nan"), float("nan"))


def verdict_of(row: Row) -> str:
    """Verdict on a row of a table of tests; a dash if there was no test."""
    if pd.isna(row["supported"]):
        return MISSING
    if row["supported"]:
        return SUPPORTED
    return NOT_SUPPORTED if gain_in(row).high < 0 else INCONCLUSIVE


TEST_CELLS: dict[str, Callable[[Row], str]] = {
    "p": lambda row: p_value(row["p_value"]),
    "p, adjusted": lambda row: p_value(row["p_holm"]),
    "claim": verdict_of,
}
"""Last columns of a listing of tests."""
