"""Tidy tables: cells by repetitions, means with Student's t, and the paired test of two policies."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np
import pandas as pd
from scipy import stats

from halfseen.evaluation.estimate import Estimate, estimate_of
from halfseen.shapes import Float
from halfseen.wording import INCONCLUSIVE, MISSING, NOT_SUPPORTED, SUPPORTED, estimated, share_in_words, with_interval

Row: TypeAlias = dict[str, Any]  # row of a table
Frame: TypeAlias = Any  # data frame of pandas, whose stubs do not tell what indexing returns
LEVEL = 0.95
MEAN = ("mean_reward", "se", "low", "high")
"""Columns of a mean reward: value, standard error, ends of the confidence interval."""
EFFECT = ("effect", "effect_low", "effect_high")
"""Columns of a paired difference, ours − other, in tables of tests."""
TESTED = ["p_value", "p_holm", "effect", "supported", "effect_low", "effect_high"]


def where(table: Frame, **values: Any) -> Frame:
    """Rows of a data frame with these values, in order; None matches missing values, and a list each of its values."""
    for name, value in values.items():
        column = table[name]
        is_kept = column.isna() if value is None else column.isin(value if isinstance(value, list) else [value])
        table = table[is_kept]
    return pd.DataFrame(table)


def records(table: Frame, **values: Any) -> list[Row]:
    """Rows with these values, as dictionaries."""
    return where(table, **values).to_dict("records")


def row_of(table: Frame, **values: Any) -> Row:
    """The first row with these values."""
    return records(table, **values)[0]


def wide(rows: Frame, by: Sequence[str], measure: str) -> Frame:
    """A measure by cell, in the order in which cells first appear, and by repetition; NaN where there is none."""
    by = list(by)
    return rows.pivot(index=by, columns="repetition", values=measure).reindex(rows.set_index(by).index.unique())


def four(name: str) -> tuple[str, str, str, str]:
    """Columns of an estimate: value, standard error, and ends of the confidence interval."""
    return name, f"{name}_se", f"{name}_low", f"{name}_high"


def ends_of(names: str | Sequence[str]) -> Sequence[str]:
    """Columns of a value and its interval, which may be given by how they begin."""
    return [names, f"{names}_low", f"{names}_high"] if isinstance(names, str) else names


def over_repetitions(values: Float[np.ndarray, " R"] | pd.Series) -> Estimate:
    """Mean over repetitions with its 95 % confidence interval."""
    return estimate_of(np.asarray(values, dtype=np.float64), len(values), LEVEL)


def columns(estimate: Estimate, names: Sequence[str] = MEAN) -> dict[str, float]:
    """An estimate as columns of these names: value, standard error, ends of the interval."""
    ends = estimate.value, estimate.standard_error, estimate.low, estimate.high
    return dict(zip(names, ends, strict=True))


def means(cells: Frame, names: Sequence[str] = MEAN) -> Frame:
    """Mean of each cell over its repetitions, as columns of these names."""
    rows = [columns(over_repetitions(row[~np.isnan(row)]), names) for row in cells.to_numpy(dtype=np.float64)]
    return pd.DataFrame(rows, cells.index)


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


def adjusted(rows: Sequence[Row] | Frame, alpha: float) -> Frame:
    """Add p_holm and supported to a table of tests, and move the columns of the test to the end."""
    table = pd.DataFrame(rows)
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


def estimated_in(row: Mapping[str, Any], names: str | Sequence[str], decimals: int = 2) -> str:
    """Write a value and its interval from these columns of a row, or from those that begin with one name."""
    return estimated(*(row[name] for name in ends_of(names)), decimals=decimals)


def effect_in(row: Row) -> str:
    """Write the effect of a test, with decimals by its interval; without one if it was not tested."""
    mean, ends = with_interval(*(row[name] for name in EFFECT))
    return mean if ends == MISSING else f"{mean} ({ends})"


def gain_in(row: Mapping[str, Any], names: str | Sequence[str] = EFFECT) -> Estimate:
    """The value and interval in these columns of a row, above 0 if ours is better."""
    value, low, high = (float(row[name]) for name in ends_of(names))
    value, low, high = (value, low, high) if is_reward(row.get("measure", "reward")) else (-value, -high, -low)
    return Estimate(value, low, high, float("nan"), float("nan"))


def verdict_of(row: Row, names: str | Sequence[str] = EFFECT) -> str:
    """Verdict on a row: by its test, if it has that column, or by these columns; a dash if it was not tested."""
    gain = gain_in(row, names)
    is_supported = row.get("supported", gain.low > 0)
    if pd.isna(is_supported):
        return MISSING
    return SUPPORTED if is_supported else NOT_SUPPORTED if gain.high < 0 else INCONCLUSIVE


def grouped(values: Iterable[Any], key: Callable[[Any], Any]) -> dict[Any, list[Any]]:
    """Values by key, in order."""
    found: dict[Any, list[Any]] = {}
    for each in values:
        found.setdefault(key(each), []).append(each)
    return found


def by_verdict(rows: Sequence[Row]) -> dict[str, Any]:
    """Where one of two policies earns more: by verb, sizes of logs by the proportions that were cut."""
    found = grouped(
        (row for row in rows if row["supported"]), lambda row: "earns more" if row["effect"] > 0 else "earns less"
    )
    places = {}
    for verb in sorted(found, reverse=True):
        shares = grouped(found[verb], lambda row: row["num_trajectories"])
        places[verb] = grouped(shares, lambda size, of=shares: tuple(row["cut_share"] for row in of[size]))
    return {"places": places, "is_all": sum(map(len, found.values())) == len(rows)}


def over_peer(
    learned: Float[np.ndarray, " B"], mean: Float[np.ndarray, " B"], some: Sequence[int], own: Float[np.ndarray, " E"]
) -> float:
    """Gain of the learned policy over the planner, which earned `own` on `some` of the B episodes.

    `mean` is the control variate, the mean of all learned policies (see `experiments.reward`).
    """
    return float((learned - mean).mean() + (mean[list(some)] - own).mean())
