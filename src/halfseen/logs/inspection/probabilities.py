"""Logged probabilities that cannot be those of the actions that were taken.

Whatever the policy, given all that was known before a stage

    E[1{A = a} / p]  =  P(a has a chance there)  ≤  1,

so in no group of stages that was formed before the action may 1/p of those that took a add up to clearly more than
their number. And where the likeliest action has probability p > ½, another one is taken 1 − p of the time: beside the
stages that took it, some Σ (1 − p)/p more must have taken another one, with a probability below ½ of its own.
"""

from collections.abc import Collection, Iterator
from typing import Any

import numpy as np

from halfseen.arrays import RowIds, RowMask, Rows
from halfseen.logs.inspection.groups import Grouped, grouped_covariates
from halfseen.logs.logs import Logs
from halfseen.shapes import Float

LEVEL = 1e-3
"""Chance with which what is true is called impossible, at most, over all that is looked at in one check."""
FEWEST = 30
TINY = 1e-100


def excess_p(inverse: Rows, group: RowIds, num_groups: int, sizes: Float[np.ndarray, " G"]) -> Float[np.ndarray, " G"]:
    """Bound the chance that 1/p of those who took an action add up to so much in groups of given sizes, by Bernstein.

    Parameters
    ----------
    inverse
        1/p of each stage that took the action.
    group
        Of each of these.
    num_groups
        G.
    sizes
        Stages of each group, whatever they took.
    """
    total = np.bincount(group, inverse, num_groups)
    spread = np.bincount(group, inverse * (inverse - 1.0), num_groups)
    # Where none happened to be rare, the spread is that of as many as were to be expected.
    largest = inverse.max(initial=1.0)
    beyond = np.maximum(total - sizes, 0.0)
    bound = np.exp(-0.5 * beyond**2 / np.maximum(spread + largest * beyond / 3.0, 1e-12))
    return np.where(beyond > 0.0, bound, 1.0)


def imbalance_p(took: RowMask, probability: Rows, group: RowIds, num_groups: int) -> float:
    """Chance that 1{A = a} / p differs so much between groups, two-sided, of all groups together.

    Parameters
    ----------
    took
        Which stages took the action, or the likeliest one.
    probability
        p of each stage.
    group
        Of each.
    num_groups
        G.
    """
    from scipy.special import ndtr

    ratio = np.where(took, 1.0 / probability, 0.0)
    beyond = np.bincount(group, ratio - ratio.mean(), num_groups)
    spread = np.bincount(group, ratio * np.maximum(ratio - 1.0, 0.0), num_groups)
    z = np.abs(beyond) / np.sqrt(np.maximum(spread, 1.0))
    return float(min(1.0, 2.0 * num_groups * ndtr(-z.max())))


def untrue_probabilities(logs: Logs) -> Iterator[str]:
    """Tell of probabilities that no policy can have had."""
    found = _known(logs)
    if found is None:
        return
    stages, probability = found
    yield from _too_few_others(probability)
    actions = stages["action"].astype(str).to_numpy()
    if logs.has_objects or len(probability) < FEWEST:
        return
    stage = stages["stage"].to_numpy(dtype=np.int64) - 1
    names, num_stages = sorted(set(actions.tolist())), int(stage.max()) + 1
    sizes = np.bincount(stage, minlength=num_stages).astype(float)
    for name in names:
        took = actions == name
        inverse = 1.0 / probability[took]
        whole = excess_p(inverse, np.zeros(len(inverse), dtype=np.int64), 1, np.array([float(len(probability))]))
        each = excess_p(inverse, stage[took], num_stages, sizes)
        p = np.append(each, whole)
        if p.min() * len(p) * len(names) < LEVEL:
            mean = inverse.sum() / len(probability)
            yield (
                f"{took.sum()} of {len(probability)} stages took {name}, and 1/p of these adds up to {mean:.2f} times "
                "all stages, which no policy can bring about; log the probability of the action that was taken, at the "
                "moment it was drawn"
            )
            return


def leaks(logs: Logs, of: Collection[str] | None = None) -> Iterator[str]:
    """Tell of covariates that depend on the action of their own stage, so that they were written down after it.

    Parameters
    ----------
    logs
        The log.
    of
        Names of covariates; None for all.
    """
    found = _known(logs)
    if found is None or logs.has_objects or any(untrue_probabilities(logs)):
        return
    stages, probability = found
    actions = stages["action"].astype(str).to_numpy()
    if len(probability) < FEWEST:
        return
    took = {f"{name} was": actions == name for name in sorted(set(actions.tolist()))}
    took["the likeliest action was"] = probability > 0.5
    groups = [each for each in grouped_covariates(logs, stages) if of is None or each.name in of]
    num_tests = sum(each.num_groups for each in groups) * len(took)
    for each in groups:
        sizes = np.bincount(each.group, minlength=each.num_groups).astype(float)
        p = {
            words: excess_p(1.0 / probability[rows], each.group[rows], each.num_groups, sizes)
            for words, rows in took.items()
        }
        words = min(p, key=lambda one: p[one].min())
        if p[words].min() * num_tests < LEVEL:
            yield _leaked(each, int(p[words].argmin()), words, probability, took[words])


def _leaked(each: Grouped, worst: int, words: str, probability: Rows, took: RowMask) -> str:
    inside = each.group == worst
    weighed = float((1.0 / probability[inside & took]).sum() / inside.sum())
    return (
        f"covariate {each.name} depends on the action of its own stage: where it is {each.words[worst]}, {words} taken "
        f"{weighed:.2f} times as often as probabilities allow; it was written down after the action: leave it out, or "
        "log what was known before"
    )


def _known(logs: Logs) -> tuple[Any, Rows] | None:
    """Stages whose action and its probability are known."""
    if "probability" not in logs.stages.columns:
        return None
    rows = logs.stages["probability"].notna() & logs.stages["action"].notna()
    stages: Any = logs.stages[rows]
    # So that no square of 1/p overflows.
    return (stages, np.maximum(stages["probability"].to_numpy(dtype=np.float64), TINY)) if len(stages) else None


def _too_few_others(probability: Rows) -> Iterator[str]:
    from scipy.special import pdtr

    likely = (probability > 0.5) & (probability < 1.0)
    expected, others = float(((1.0 - probability) / probability)[likely].sum()), int((probability <= 0.5).sum())
    if likely.sum() >= FEWEST and float(pdtr(others, expected)) < LEVEL:
        yield (
            f"{likely.sum()} actions were taken with a probability of {probability[likely].mean():.2g} on average, so "
            f"some {expected:.0f} stages must have taken a less likely one, and {others} say so: these look like "
            "the chances of a rule, whatever was taken; log that of the action that was taken"
        )
