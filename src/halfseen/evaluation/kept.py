"""Comparison of a later log with the promise of a policy: the return that was promised, and the states."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd

from halfseen.evaluation.estimate import Estimate
from halfseen.evaluation.evaluation import Evaluation
from halfseen.evaluation.off_policy import QSpec
from halfseen.evaluation.specification import task_of
from halfseen.learning.covariates import Covariates
from halfseen.logs import Logs
from halfseen.policies.folder.promised_parts import below, comparable, outcome_rows, residuals
from halfseen.policies.shares import action_shares

APART = 0.1
"""Difference of two distribution functions, or of shares, that may matter."""
CLEARLY = 1.95
"""Threshold of the Kolmogorov–Smirnov test at 0.1 %, for difference × √(1/(1/n + 1/m)) with n and m states."""
AS_PROMISED = 2.0
"""Standard errors within which the return agrees with the promise."""
OWN = 0.9
"""Share of agreeing actions from which on the policy counts as the one that made the log."""

UNITS = {
    100.0: "percent for shares, or centimetres for metres",
    1e3: "thousandths",
    1e6: "millionths",
    1e9: "billionths",
    60.0: "seconds for minutes, or minutes for hours",
    3600.0: "seconds for hours",
    180.0 / np.pi: "degrees for radians",
    25.4: "millimetres for inches",
    -1.0: "the opposite sign",
}
"""Factors between units of a covariate, described for multiplication; division is the other way round."""
FITS, CLEARER = 0.4, 0.5
"""Largest difference in another unit, as all numbers turn into one by a large factor, which few states may fit; and how
much smaller it must be with the opposite sign than without, as the two are nearly alike around 0."""
CLOCK_UNITS = (60.0, 1e3, 3600.0, 1e6, 1e9)
FEWEST_TIMES, ABOUT = 20, 1.4
"""Fewest stages whose durations tell the unit of a clock, and the factor up to which one is met."""


@dataclass(frozen=True)
class PromiseCheck:
    """A later log compared with the promise of a policy."""

    sentence: str
    """Its return, or estimated return, and the promised one; "" if nothing was promised."""
    units: tuple[str, ...]
    """Covariates, and times, that seem to be in another unit, a sentence each."""
    drifts: tuple[str, ...]
    """Other differences of the states, a sentence each."""

    @property
    def lines(self) -> list[str]:
        """All sentences, for readers: other units first, because they invalidate the rest."""
        units = [f"{each[0].upper()}{each[1:]}." for each in self.units]
        return [*units, *filter(None, [self.sentence]), *(f"- {each}" for each in self.drifts)]


def earned_here(policy: Any, logs: Logs, q: QSpec | None, found: Evaluation) -> tuple[Estimate, bool]:
    """Return of a policy by a log, estimated if another policy made it; and whether the policy made it."""
    task = task_of(policy, logs) if q is None or q.task is None else q.task
    shares = action_shares(policy, task, [logs])
    is_own = bool(np.average(shares["as_logged"].fillna(0.0), weights=shares["num_states"]) >= OWN)
    return (found.logging if is_own else found.doubly_robust), is_own


def kept_promise(
    promise: Mapping[str, Any], logs: Logs, earned: Estimate, is_own: bool, policy: Any = None
) -> PromiseCheck:
    """Compare a later log, and the return of the policy on it, with a promise.

    `halfseen.policies.folder` stores the promise. Without the policy, times are not compared.
    """
    promised, (units, changes) = promise["value"], drifts_of(promise["stages"], logs)
    drifts = ((*_other_clock(promise.get("parts", ()), logs, policy), *units), changes)
    if promised is None:
        return PromiseCheck("", *drifts)
    verb = "earned" if is_own else "would earn"
    earning = f"{verb} {earned.value:.3g} a trajectory here ({earned.low:.3g} to {earned.high:.3g})"
    error = float(np.hypot(promised["standard_error"], earned.standard_error))
    less = promised["value"] - earned.value
    words = "less than promised" if less > 0 else "more than promised"
    words = "as promised" if abs(less) <= AS_PROMISED * error else words
    range_ = f"{promised['low']:.3g} to {promised['high']:.3g}"
    return PromiseCheck(f"Promised {promised['value']:.3g} a trajectory ({range_}); it {earning}: {words}.", *drifts)


def drifts_of(promised: Sequence[Mapping[str, Any]], logs: Logs) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Find covariates in another unit, and those with another distribution, than in the log used for learning.

    `halfseen.policies.folder.promised_parts.promised_states` gives the promised states of each stage.
    """
    units: dict[str, str] = {}
    found: dict[str, str] = {}
    for stage in promised:
        rows = logs.stages[logs.stages["stage"] == stage["stage"]]
        kept = {name: each for name, each in stage["covariates"].items() if name in rows.columns and len(rows)}
        num = 1.0 / (1.0 / stage["num_states"] + 1.0 / max(len(rows), 1))
        least = max(APART, CLEARLY / np.sqrt(num))
        apart = {name: _apart(each, rows[name]) for name, each in kept.items()}
        strange = [name for name, distance in apart.items() if distance > least and name not in units | found]
        for one, other in combinations(strange, 2):
            if max(_apart(kept[one], rows[other]), _apart(kept[other], rows[one])) <= least:
                found[one] = found[other] = f"covariates {one} and {other} look swapped"
        for name in strange:
            unit = _other_unit(kept[name], rows[name], least, apart[name])
            if unit and name not in found:
                units[name] = f"covariate {name} {unit}"
                continue
            found.setdefault(
                name,
                f"covariate {name} is distributed differently than in the training log: from stage {stage['stage']} "
                f"on, {apart[name]:.0%} of the states lie elsewhere",
            )
    return tuple(units.values()), tuple(dict.fromkeys(found.values()))


def _other_clock(parts: Sequence[Mapping[str, Any]], logs: Logs, policy: Any) -> list[str]:
    """Name the unit in which stages would last as long as promised; empty if they do, or if there is none."""
    by_action = {part["action"]: part for part in parts if part["what"] == "duration"}
    if policy is None or not by_action:
        return []
    rows = outcome_rows(logs).dropna(subset=list(policy.covariates))
    known = rows["action"].astype(str).isin(list(by_action))
    for name, categories in policy.categories.items():
        known &= rows[name].isin(categories)
    rows = rows[known]
    if len(rows) < FEWEST_TIMES:
        return []
    looks_at = Covariates(tuple(policy.covariates), policy.categories)
    each = [
        residuals(by_action[action], looks_at.encode(some), some["duration"].to_numpy(float))
        for action, some in rows.groupby(rows["action"].astype(str))
    ]
    longer = float(np.median(np.concatenate(each)))
    near = [f**power for f in CLOCK_UNITS for power in (1, -1) if abs(longer - power * np.log(f)) < np.log(ABOUT)]
    return [f"the time of a stage {_unit_words(near[0])}"] if near else []


def _other_unit(kept: Mapping[str, Any], values: Any, least: float, apart_now: float) -> str:
    """Name the unit in which a number would have the promised distribution; "" if there is none."""
    if "values" not in kept or not pd.api.types.is_numeric_dtype(values.dtype):
        return ""
    factors = [factor**power for factor in UNITS for power in (1, -1)]
    apart = [_apart(kept, values / factor) for factor in factors]
    best = int(np.argmin(apart))
    is_unclear = factors[best] == -1.0 and apart_now - apart[best] < CLEARER
    if apart[best] > min(least, FITS) or is_unclear:
        return ""
    return _unit_words(factors[best])


def _unit_words(factor: float) -> str:
    """Describe what is this many times as large as it should be."""
    if factor == -1.0:
        return f"has {UNITS[factor]} of that in the training log, as if in another direction: multiply it by -1"
    is_inverse, by = factor not in UNITS, f"{max(factor, 1.0 / factor):,.4g}"
    size, mend = ("small", "multiply") if is_inverse else ("large", "divide")
    what = (
        f"{UNITS[min(UNITS, key=lambda unit: abs(unit * factor - 1.0))]} the other way round"
        if is_inverse
        else UNITS[factor]
    )
    return f"is {by} times as {size} as in the training log, as if in another unit ({what}): {mend} it by {by}"


def _apart(kept: Mapping[str, Any], values: Any) -> float:
    """Largest difference of two distribution functions, or total variation of shares; 1 for text among numbers."""
    if "values" not in kept:  # a policy reads numbers as the categories that are written so
        shares = values.astype(str).value_counts(normalize=True)
        was = pd.Series(kept["shares"], index=kept["names"])
        return float(shares.sub(was, fill_value=0.0).abs().sum() / 2.0)
    if not pd.api.types.is_numeric_dtype(values.dtype):
        return 1.0
    knots, numbers = map(np.sort, comparable(kept["values"], values))
    # A difference between two knots shows at the next one; below the lowest, the mass itself is the difference.
    under = float(np.searchsorted(numbers, knots[0], side="left") / len(numbers))
    return max(under, float(np.abs(below(numbers, knots) - np.array(kept["below"])).max()))
