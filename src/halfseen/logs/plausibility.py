"""Plausibility checks of logs: logged probabilities, covariates known before the action, true endings.

For any policy, given everything known before a stage

    E[1{A = a} / p]  =  P(a has a chance there)  ≤  1,

so in any group of stages that is defined before the action, the sum of 1/p over the stages that took a cannot clearly
exceed the size of the group. If the likeliest action has probability p > ½, another one is taken with probability
1 − p: for the stages that took the likeliest, about Σ (1 − p)/p others must have an action of probability below ½.

Regress the reward on the other covariates, the action, and the covariate's own value in the stage before. A covariate
recorded after the stage explains most of the remaining variance: it repeats the outcome. A covariate known before may
do so, too, if rewards have little noise. But the outcome depends on the action, and covariates known before do not:
the mean of 1{A = a} / p is the same for all their values. A covariate is reported only if both tests fail; in a log
without probabilities, it must explain more.

The end of a task has a visible cause: the action that ends it, its reward, or the number of stages. If stages of one
action with the same reward are sometimes last and sometimes not, nothing recorded distinguishes them; and if only last
stages have reward 0, that 0 may represent an unobserved reward. If such last stages are also clearly shorter,
something stopped them.

Trajectories that agree in a clock of fine resolution and in every reward are one that was logged twice; counted as
several, they make an interval too narrow, and what was learned from one copy is judged by another.
"""

from collections.abc import Collection, Iterator
from statistics import NormalDist
from typing import Any

import numpy as np
import pandas as pd
from pandas.util import hash_pandas_object

from halfseen.arrays import RowIds, RowMask, Rows
from halfseen.logs.columns import shown
from halfseen.logs.grouping import Grouped, coded, grouped_covariates, rows_with
from halfseen.logs.logs import Logs
from halfseen.shapes import Float

LEVEL = 1e-3
"""Largest probability of a false alarm, over all tests of one check."""
FEWEST = 30
TINY = 1e-100
FEWEST_REWARDS, MOST_REWARDS = 100, 2000
MOST_EXPLAINED, UNTESTED = 0.5, 0.8
"""Share of the remaining variance that a covariate may explain: if it also depends on the action, and if that cannot
be tested. Logs of our worlds stay below .3."""
IMBALANCE_LEVEL = 0.01
FEWEST_ENDS, ENDS_LEVEL = 10, 1e-4
MANY_COPIES, FINE = 0.05, 0.5
"""Share of trajectories that are copies from which on a verdict is doubted; and least share of the durations of the
others that are distinct, for a clock so fine that trajectories do not agree by chance."""
COMMON = 0.2
"""Actions with a smaller mean of p do not test covariates for dependence on them: their 1/p is too heavy-tailed."""


def excess_p(inverse: Rows, group: RowIds, num_groups: int, sizes: Float[np.ndarray, " G"]) -> Float[np.ndarray, " G"]:
    """Bernstein bound on the p-value of the sum of 1/p over stages that took an action, in groups of given sizes.

    Parameters
    ----------
    inverse
        1/p of each stage that took the action.
    group
        Group of each of these stages.
    num_groups
        Number of groups G.
    sizes
        Number of stages in each group, with any action.
    """
    total = np.bincount(group, inverse, num_groups)
    spread = np.bincount(group, inverse * (inverse - 1.0), num_groups)
    # If no rare action happened to be taken, use the variance of the expected number.
    largest = inverse.max(initial=1.0)
    beyond = np.maximum(total - sizes, 0.0)
    bound = np.exp(-0.5 * beyond**2 / np.maximum(spread + largest * beyond / 3.0, 1e-12))
    return np.where(beyond > 0.0, bound, 1.0)


def imbalance_p(took: RowMask, probability: Rows, group: RowIds, num_groups: int) -> float:
    """Bernstein bound on the p-value for equal means of 1{A = a} / p in all groups, two-sided, after Bonferroni.

    Stages that took another action with probability 1 are left out, as a had no chance there.

    Parameters
    ----------
    took
        Which stages took the action, or the likeliest one.
    probability
        p of each stage.
    group
        Group of each stage.
    num_groups
        Number of groups G.
    """
    # Where another action was taken, the chance of a is at most this. So 1{A = a} / p varies there even if a is so rare
    # that no stage of a group took it.
    chance = np.where(took, probability, 1.0 - probability)
    took, group, chance = (each[chance > 0.0] for each in (took, group, chance))
    if not len(chance):
        return 1.0
    ratio, sizes = np.where(took, 1.0 / chance, 0.0), np.bincount(group, minlength=num_groups)
    beyond = np.abs(np.bincount(group, ratio - ratio.mean(), num_groups))
    observed = (ratio * np.maximum(ratio - 1.0, 0.0)).mean() * sizes
    spread = np.maximum(np.bincount(group, 1.0 / chance - 1.0, num_groups), observed)
    bound = np.exp(-0.5 * beyond**2 / np.maximum(spread + (1.0 / chance).max() * beyond / 3.0, 1.0))
    return float(min(1.0, 2.0 * num_groups * bound.min()))


def untrue_probabilities(logs: Logs) -> Iterator[str]:
    """Find logged probabilities that no policy can have."""
    stages, probability = _with_probability(logs)
    if not len(stages):
        return
    yield from _too_few_others(probability)
    if logs.has_objects or len(stages) < FEWEST:
        return
    (action, names), stage = coded(stages["action"]), stages["stage"].to_numpy(dtype=np.int64)
    # Groups: the stages of each number, and all stages.
    sizes = np.append(np.bincount(stage)[1:], len(stages)).astype(float)
    for k, name in enumerate(names):
        took = action == k
        inverse = 1.0 / probability[took]
        group = np.concatenate([stage[took] - 1, np.full(len(inverse), len(sizes) - 1)])
        p = excess_p(np.tile(inverse, 2), group, len(sizes), sizes)
        if p.min() * len(p) * len(names) < LEVEL:
            mean = inverse.sum() / len(stages)
            yield (
                f"{took.sum()} of {len(stages)} stages took {name}, and 1/p of these adds up to {mean:.3g} times "
                "all stages, which no policy can produce; log the probability of the action that was taken, when it "
                "was drawn"
            )
            return


def _too_few_others(probability: Rows) -> Iterator[str]:
    from scipy.special import pdtr

    likely = (probability > 0.5) & (probability < 1.0)
    expected, others = float(((1.0 - probability) / probability)[likely].sum()), int((probability <= 0.5).sum())
    if likely.sum() >= FEWEST and float(pdtr(others, expected)) < LEVEL:
        yield (
            f"{likely.sum()} actions were taken with a probability of {probability[likely].mean():.2g} on average, "
            f"so about {expected:.0f} stages must have taken a less likely one, but only {others} did: these look "
            "like the probabilities of a rule's choice, not of the action taken; log the latter"
        )


def leaks(logs: Logs, of: Collection[str] | None = None) -> Iterator[str]:
    """Find covariates, among all or those named, that depend on their own stage's action: recorded after it."""
    stages, probability = _with_probability(logs)
    if len(stages) < FEWEST or logs.has_objects or any(untrue_probabilities(logs)):
        return
    action, names = coded(stages["action"])
    took = {f"{name} was": action == k for k, name in enumerate(names)}
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
            worst = int(p[words].argmin())
            inside = each.group == worst
            weight = float((1.0 / probability[inside & took[words]]).sum() / inside.sum())
            yield (
                f"covariate {each.name} depends on the action of its own stage: where it is {each.words[worst]}, "
                f"{words} taken {weight:.2f} times as often as probabilities allow; it was written down after the "
                "action: leave it out, or log what was known before"
            )


def _with_probability(logs: Logs) -> tuple[Any, Rows]:
    """Stages with known action and probability, and these probabilities."""
    stages: Any = logs.stages
    if "probability" not in stages.columns:
        return stages[:0], np.zeros(0)
    stages = rows_with(stages, "probability", "action")
    # Avoid overflow of (1/p)².
    return stages, np.maximum(stages["probability"].to_numpy(dtype=np.float64), TINY)


def outcomes_among_covariates(
    logs: Logs, of: Collection[str] | None = None, untested: float = UNTESTED
) -> Iterator[str]:
    """Find covariates that repeat the outcome of their stage.

    Parameters
    ----------
    logs
        The log.
    of
        Names of the covariates to test; None for all.
    untested
        Share of the remaining variance that a covariate must explain if the log has no probabilities to test it.
    """
    from scipy.linalg import get_lapack_funcs, solve_triangular

    stages = rows_with(logs.stages, "reward", "action", most=MOST_REWARDS)
    if len(stages) < FEWEST_REWARDS or not logs.stage_covariates or logs.has_objects:
        return
    reward = stages["reward"].to_numpy(dtype=np.float64)
    if not np.ptp(reward) > 0.0:
        return
    action, _ = coded(stages["action"])
    known = list(grouped_covariates(logs, stages))
    blocks = [_indicators(action), _indicators(stages["stage"].to_numpy())]
    blocks += [_indicators(each.group) for each in known]
    blocks += [_before(stages, each) for each in known]
    block = np.repeat(np.arange(len(blocks)), [each.shape[1] for each in blocks])
    columns = np.hstack(blocks)
    if columns.shape[1] - len(blocks) >= len(reward):
        return  # No degree of freedom is left.
    gram, pull, total = columns.T @ columns, columns.T @ reward, float(reward @ reward)
    (cholesky,) = get_lapack_funcs(("pstrf",), (gram,))

    def left(used: RowMask, added: Float[np.ndarray, "m k"]) -> float:
        """Residual variance of the reward after regression on some columns, per remaining degree of freedom."""
        cross = columns[:, used].T @ added
        joint = np.block([[gram[np.ix_(used, used)], cross], [cross.T, added.T @ added]])
        # It is pivoted, and finds the rank in a tenth of the time of an eigendecomposition.
        factor, pivot, rank, _ = cholesky(joint, tol=1e-9 * joint.diagonal().max(), lower=1)
        pulled = np.append(pull[used], added.T @ reward)[pivot[:rank] - 1]
        along = solve_triangular(factor[:rank, :rank], pulled, lower=True)
        return max(total - float(along @ along), 0.0) / max(len(reward) - rank, 1)

    for k, each in enumerate(known):
        if of is not None and each.name not in of:
            continue
        is_other = block != 2 + k
        by_others = left(is_other, columns[:, :0])
        if by_others <= 1e-9 * np.var(reward):
            continue
        explained = 1.0 - left(is_other, _indicators(action * each.num_groups + each.group)) / by_others
        if explained > MOST_EXPLAINED and _is_after(stages, each, explained > untested):
            yield (
                f"covariate {each.name} foretells the reward of its own stage: it explains {explained:.0%} of what all "
                "that was known before leaves open; if it was written down after the action, leave it out"
            )


def _is_after(stages: Any, each: Grouped, untested: bool) -> bool:
    """Whether a covariate that predicts the reward depends on the action; `untested` if there are no probabilities."""
    if "probability" not in stages.columns or stages["probability"].isna().any():
        return untested
    probability, (action, names) = stages["probability"].to_numpy(dtype=np.float64), coded(stages["action"])
    took = [action == k for k in range(len(names))] + [probability > MOST_EXPLAINED]
    common = [rows for rows in took if rows.any() and probability[rows].mean() > COMMON]
    each_p = [imbalance_p(rows, probability, each.group, each.num_groups) for rows in common]
    return len(common) * min(each_p, default=1.0) < IMBALANCE_LEVEL


def _indicators(code: Any) -> Float[np.ndarray, "m k"]:
    return (code[:, None] == np.unique(code)).astype(np.float64)


def _before(stages: Any, each: Grouped) -> Float[np.ndarray, "m k"]:
    """Indicators of the covariate's group in the stage before; all zero in the first stage."""
    trajectory, group = stages["trajectory"].to_numpy(), each.group
    was = np.where(np.append(False, trajectory[1:] == trajectory[:-1]), np.append(0, group[:-1]), -1)
    return (was[:, None] == np.arange(each.num_groups)).astype(np.float64)


def cuts_called_finished(logs: Logs) -> Iterator[str]:
    """Find finished trajectories that look as if they had been cut."""
    stages: Any = logs.stages
    lasted_s: Any = pd.Series(logs.durations_s())
    is_last = ~stages.duplicated("trajectory", keep="last")
    finished = logs.trajectory_ids[logs.is_finished]
    is_end = is_last & stages["trajectory"].isin(finished) & (stages["stage"] < logs.horizon)
    reward = stages["reward"].astype(float)
    for name, rows in stages.groupby(stages["action"].astype(str)).groups.items():
        of_action = reward.loc[rows].dropna()
        ends, goes_on = of_action[is_end.loc[of_action.index]], of_action[~is_last.loc[of_action.index]]
        for paid in {0.0, *goes_on.mode().iloc[:1]}:
            alike = ends.index[ends == paid]
            others, words = goes_on.index[goes_on == paid], "went on after one that paid the same"
            if len(others) < FEWEST_ENDS:
                others, words = of_action.index[of_action != paid], "of the same action paid otherwise"
            if min(len(alike), len(others)) < FEWEST_ENDS:
                continue
            if chance_of_shorter(lasted_s[alike].to_numpy(), lasted_s[others].to_numpy()) < ENDS_LEVEL:
                ended_s, other_s = (float(np.median(lasted_s[each])) for each in (alike, others))
                yield (
                    f"{len(alike)} trajectories are called finished after a {name} that paid {paid:g} and lasted "
                    f"{ended_s:.2g} s, yet {len(others)} {words} and lasted {other_s:.2g} s: if something stopped "
                    "them, their ending is 'cut', and that stage has neither reward nor elapsed_s"
                )
                break


def chance_of_shorter(one: Float[np.ndarray, " n"], other: Float[np.ndarray, " m"]) -> float:
    """One-sided p-value of the rank test that one sample is smaller than another [MannWhitney1947]_.

    Uses the normal approximation with ties and continuity correction, for ten or more values in each sample.
    """
    _, place, ties = np.unique(np.concatenate([one, other]), return_inverse=True, return_counts=True)
    ranks = (ties.cumsum() - (ties - 1) / 2.0)[place]
    n, m = len(one), len(other)
    above = ranks[:n].sum() - n * (n + 1) / 2.0
    spread = np.sqrt(n * m / 12.0 * (n + m + 1.0 - float((ties**3 - ties).sum()) / ((n + m) * (n + m - 1.0))))
    return NormalDist().cdf((above - n * m / 2.0 + 0.5) / spread) if spread > 0.0 else 1.0


def copied_trajectories(logs: Logs, more_than: float = 0.0) -> Iterator[str]:
    """Find copies: trajectories that agree to the last digit in two fractional durations. Whole numbers may agree.

    Parameters
    ----------
    logs
        The log.
    more_than
        Share of trajectories that must be copies.
    """
    stages: Any = logs.stages
    content = stages[["stage", "elapsed_s", "action", "reward"]].astype({"action": str})
    prints: Any = hash_pandas_object(content, index=False)  # pyright: ignore[reportCallIssue]
    first_row = np.flatnonzero(stages["stage"].to_numpy() == 1)
    prints = pd.Series(np.add.reduceat(prints.to_numpy(), first_row), index=logs.trajectory_ids)
    again = prints.index[prints.duplicated()]
    if not len(again):
        return
    lasted_s: Any = pd.Series(logs.durations_s()).round(6)
    trajectory = stages["trajectory"]
    once = lasted_s[~trajectory.isin(again).to_numpy()].dropna()
    part = (lasted_s % 1.0).round(6) % 1.0
    num_measured = part.where(part > 0).groupby(trajectory.to_numpy()).nunique()
    prints = prints[(num_measured >= 2).reindex(prints.index).to_numpy()]
    repeated, num_copies = prints[prints.duplicated(keep=False)], int(prints.duplicated().sum())
    if num_copies and num_copies > more_than * logs.num_trajectories and once.nunique() >= FINE * len(once):
        first = [shown(name) for name in repeated.index[repeated == repeated.iloc[0]][:2]]
        yield (
            f"{num_copies} {'trajectory is a copy' if num_copies == 1 else 'trajectories are copies'} of another (such "
            f"as {' and '.join(first)}): the same clock, actions and rewards to the last digit; drop what was logged "
            "twice"
        )
