"""What was found in words: a table, and one sentence that is worked out from the numbers."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Float
from scipy import stats

from cut_regression.comparison import Comparison
from cut_regression.methods import CONSTANT, METHODS
from cut_regression.settings import TAU, Setting

_HEADS = {
    "kaplan-meier": "K–M Ĝ",
    "cox": "Cox Ĝ",
    "kernel": "kernel Ĝ",
    "true": "true Ĝ",
    "uncut": "uncut only",
    "cox-times": "Cox times",
    CONSTANT: "constant",
}
"""Method → head of its column; Ĝ is what weighs the SVM's rows."""
_NAMES = {**METHODS, CONSTANT: "the best constant"}


class Contrast(NamedTuple):
    """Errors of two methods on the same samples [s]: their means, and the 95 % interval of ours − other."""

    ours: float
    other: float
    low: float
    high: float


def contrast(ours: Float[np.ndarray, " R"], other: Float[np.ndarray, " R"]) -> Contrast:
    """Compare errors sample by sample; with one sample the interval knows nothing."""
    difference = ours - other
    if len(difference) < 2:
        return Contrast(float(ours.mean()), float(other.mean()), -np.inf, np.inf)
    error = float(np.std(difference, ddof=1) / np.sqrt(len(difference)))
    reach = float(stats.t.ppf(0.975, len(difference) - 1)) * error
    middle = float(difference.mean())
    return Contrast(float(ours.mean()), float(other.mean()), middle - reach, middle + reach)


def table(comparison: Comparison) -> str:
    """Mean error of each method [s], a line for each setting and size, with the measured share of cut rows."""
    lines = [
        {"median": setting.median, "F": setting.num_covariates, "cuts": setting.cuts, "n": size}
        | {"rows cut": f"{_cut_share(comparison, setting, size):.1%}"}
        | {head: f"{comparison.errors_of(setting, size, method).mean():.3f}" for method, head in _HEADS.items()}
        for setting in comparison.settings
        for size in comparison.sizes
    ]
    text = (
        f"Mean |estimate − true median| [s] over {_samples(comparison)}; F covariates, n rows, times restricted to "
        f"{TAU:g} s"
    )
    return f"{text}\n{pd.DataFrame(lines).to_string(index=False)}\n{_at_tau(comparison)}"


def sentence(comparison: Comparison, pairs: Sequence[tuple[str, str]]) -> str:
    """Say for each pair of methods which one is nearer to the truth, and where, at the largest size.

    Parameters
    ----------
    comparison
        What was found.
    pairs
        Methods (ours, other).
    """
    parts = [_clause(comparison, ours, other) for ours, other in pairs]
    return f"With {comparison.sizes[-1]} rows, {'; '.join(parts)}."


def headline(comparison: Comparison, setting: Setting, weighted: Sequence[str] = ("kaplan-meier",)) -> str:
    """Tell how far from the truth the SVM on uncut rows, weighted SVMs and Cox's model are, at the largest size."""

    def miss(method: str) -> str:
        return f"{comparison.errors_of(setting, comparison.sizes[-1], method).mean():.2f} s"

    names = {"kaplan-meier": "weighted by Kaplan–Meier", "cox": "weighted by Cox's model of the cuts"}
    text = [f"{miss('uncut')} on uncut rows only", *(f"{miss(method)} {names[method]}" for method in weighted)]
    return f"the SVM misses the truth by {_listed(text)}; Cox's model of the times by {miss('cox-times')}"


def _clause(comparison: Comparison, ours: str, other: str) -> str:
    size = comparison.sizes[-1]
    found = [
        contrast(comparison.errors_of(setting, size, ours), comparison.errors_of(setting, size, other))
        for setting in comparison.settings
    ]
    nearer, further = sum(c.high < 0 for c in found), sum(c.low > 0 for c in found)
    counts = {
        "nearer to the truth": nearer,
        "further from the truth": further,
        f"not told apart by {_samples(comparison)}": len(found) - nearer - further,
    }
    verdicts = [f"{verdict} in {count}" for verdict, count in counts.items() if count]
    means = np.mean([(c.ours, c.other) for c in found], axis=0)
    return (
        f"compared with {_NAMES[other]}, {_NAMES[ours]} is {_listed(verdicts)} of {len(found)} settings "
        f"(mean error {means[0]:.2f} against {means[1]:.2f} s)"
    )


def _listed(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else f"{', '.join(parts[:-1])} and {parts[-1]}"


def _samples(comparison: Comparison) -> str:
    return "one sample" if comparison.num_repetitions == 1 else f"{comparison.num_repetitions} samples"


def _cut_share(comparison: Comparison, setting: Setting, size: int) -> float:
    frame = comparison.errors
    return float(frame.loc[(frame["setting"] == setting) & (frame["num_rows"] == size), "cut_share"].mean())


def _at_tau(comparison: Comparison) -> str:
    frame = comparison.errors
    share = float(frame.loc[frame["method"] == "cox-times", "share_at_tau"].mean())
    return f"Cox's curve of the times stays above ½ in {share:.1%} of the answers, which are then {TAU:g} s."
