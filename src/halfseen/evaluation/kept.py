"""Was it kept? What a policy was promised to earn, and for which states, beside what a later log says of both."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
import pandas as pd

from halfseen.evaluation.estimate import Estimate
from halfseen.evaluation.evaluation import Evaluation
from halfseen.evaluation.off_policy import QSpec
from halfseen.evaluation.targets import task_of
from halfseen.logs import Logs
from halfseen.policies.folder.log_facts import below
from halfseen.policies.shares import action_shares

APART = 0.1
"""Difference of two distribution functions, or of shares, from which on it may matter."""
CLEARLY = 1.95
"""Of a test by Kolmogorov and Smirnov: the difference, times the root of the harmonic number of states, at .1 %."""
AS_PROMISED = 2.0
"""Standard errors within which what is earned is what was promised."""
OWN = 0.9
"""Share of the actions that a policy would have taken, from which on it is taken for the one that made a log."""


@dataclass(frozen=True)
class Kept:
    """How a later log compares with what a policy was promised.

    Parameters
    ----------
    sentence
        What it earned, or would, beside what was promised; "" where nothing was.
    drifts
        What differs in the states, a sentence each.
    """

    sentence: str
    drifts: tuple[str, ...]

    @property
    def lines(self) -> list[str]:
        """All of it, for people."""
        return [*filter(None, [self.sentence]), *(f"- {each}" for each in self.drifts)]


def earned_here(policy: Any, logs: Logs, q: QSpec | None, found: Evaluation) -> tuple[Estimate, bool]:
    """What a policy earned by a log, if it is the one that made it, or would earn; and whether it is.

    Parameters
    ----------
    policy
        The policy.
    logs
        The log.
    q
        As for `halfseen.evaluation.evaluate`.
    found
        The policy, evaluated by the log.
    """
    task = task_of(policy, logs) if q is None or q.task is None else q.task
    shares = action_shares(policy, task, [logs])
    is_own = bool(np.average(shares["as_logged"].fillna(0.0), weights=shares["num_states"]) >= OWN)
    return (found.logging if is_own else found.doubly_robust), is_own


def kept_promise(promise: Mapping[str, Any], logs: Logs, earned: Estimate, is_own: bool) -> Kept:
    """Compare a later log with a promise.

    Parameters
    ----------
    promise
        As `halfseen.policies.folder` keeps it: ``value``, with ``low``, ``high`` and ``standard_error``, or None, and
        ``stages``, as `halfseen.policies.folder.log_facts.promised_states` gives them.
    logs
        The log.
    earned
        What the policy earned there, or would.
    is_own
        Whether it made the log.
    """
    return Kept(_earned(promise["value"], earned, is_own), drifts_of(promise["stages"], logs))


def _earned(promised: Mapping[str, float] | None, earned: Estimate, is_own: bool) -> str:
    verb = "earned" if is_own else "would earn"
    told = f"{verb} {earned.value:.3g} a trajectory here ({earned.low:.3g} to {earned.high:.3g})"
    if promised is None:
        return ""
    error = float(np.hypot(promised["standard_error"], earned.standard_error))
    less = promised["value"] - earned.value
    words = "less than promised" if less > 0 else "more than promised"
    words = "as promised" if abs(less) <= AS_PROMISED * error else words
    range_ = f"{promised['low']:.3g} to {promised['high']:.3g}"
    return f"Promised {promised['value']:.3g} a trajectory ({range_}); it {told}: {words}."


def drifts_of(promised: Sequence[Mapping[str, Any]], logs: Logs) -> tuple[str, ...]:
    """Tell which covariates have another distribution than the log that a policy was learned from.

    Parameters
    ----------
    promised
        Of each stage, as `halfseen.policies.folder.log_facts.promised_states` gives it.
    logs
        A later log.
    """
    found: dict[str, str] = {}
    for stage in promised:
        rows = logs.stages[logs.stages["stage"] == stage["stage"]]
        told = {name: each for name, each in stage["covariates"].items() if name in rows.columns and len(rows)}
        num = 1.0 / (1.0 / stage["num_states"] + 1.0 / max(len(rows), 1))
        least = max(APART, CLEARLY / np.sqrt(num))
        apart = {name: _apart(each, rows[name]) for name, each in told.items()}
        strange = [name for name, distance in apart.items() if distance > least and name not in found]
        for one, other in combinations(strange, 2):
            if max(_apart(told[one], rows[other]), _apart(told[other], rows[one])) <= least:
                found[one] = found[other] = f"covariates {one} and {other} look swapped"
        for name in strange:
            found.setdefault(
                name,
                f"covariate {name} is distributed otherwise than in the log that it was learned from: from stage "
                f"{stage['stage']} on, {apart[name]:.0%} of the states lie elsewhere",
            )
    return tuple(dict.fromkeys(found.values()))


def _apart(told: Mapping[str, Any], values: Any) -> float:
    """Largest difference of two distribution functions, or half the sum of those of shares; 1 of another kind."""
    is_number = pd.api.types.is_numeric_dtype(values.dtype)
    if is_number != ("values" in told):
        return 1.0
    if not is_number:
        shares = values.astype(str).value_counts(normalize=True)
        was = pd.Series(told["shares"], index=told["names"])
        return float(shares.sub(was, fill_value=0.0).abs().sum() / 2.0)
    knots, numbers = np.array(told["values"]), np.sort(values.to_numpy(dtype=np.float64))
    # Where all lies above a knot as below it, the next one may still tell: what lies below the lowest counts, too.
    under = float(np.searchsorted(numbers, knots[0], side="left") / len(numbers))
    return max(under, float(np.abs(below(numbers, knots) - np.array(told["below"])).max()))
