"""With many stages, a smooth Q has to prove itself beside a linear one.

Errors of Q accumulate backwards: the maximum over several Qs favours those that err upwards, and it is the target of
the stage before. Over many stages a smooth Q may exceed everything that was observed, and its policy then waits for
rewards that never come. With few stages a large V̂ may be right: the behaviour policy may be far from optimal. With
many, Q is linear instead in either of two cases.

*Promise.* V̂ of the first stage is a mean. If it exceeds the returns of 95 % of the finished trajectories, while that of
a linear Q does not, the smooth Q is rejected.

*Held-out value.* Both policies are learned from one half of the trajectories, and evaluated on the other by a smooth Q
of the given policy (fitted Q evaluation), which takes no maximum. The linear Q is chosen if its policy earns more, on
average over both halves. A linear evaluation would not do: it cannot see what a smooth policy gains.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from halfseen.errors import LogError
from halfseen.learning.discrete_policy import DiscretePolicy
from halfseen.learning.judging import judged
from halfseen.learning.q_model import QModel
from halfseen.learning.q_space import KernelQ, LinearQ
from halfseen.learning.recursion import fit_q
from halfseen.learning.rows import Transitions
from halfseen.learning.sample import FEWEST_TRAJECTORIES, sampled
from halfseen.learning.streaming import Fit, sample_of
from halfseen.logs import Logs, LogStream
from halfseen.shapes import Bool
from halfseen.workers.threads import one_thread

MANY_STAGES = 10
RARE = 0.95
"""Quantile of the returns of finished trajectories."""
MOST_TRAJECTORIES = 10_000
"""Largest sample of trajectories for both checks."""
FEWEST_FINISHED = 20
"""Fewest finished trajectories for the check of the promise."""


def believable(learn: Callable[[QModel], Fit], model: QModel, logs: Logs | LogStream) -> Fit:
    """Learn; with many stages, keep a default smooth Q only if it proves itself beside a linear one.

    Parameters
    ----------
    learn
        Function that learns from the log with a given model.
    model
        The model.
    logs
        The log.
    """
    smooth = learn(model)
    is_doubted = smooth.model.is_space_free and isinstance(smooth.model.space, KernelQ)
    policy = smooth.model.policy(smooth.q_functions)
    if not is_doubted or model.horizon < MANY_STAGES or not isinstance(policy, DiscretePolicy):
        return smooth
    try:
        linear = learn(replace(model, space=LinearQ()))
    except LogError:  # a covariate that only a scaled Q can hold (`rows.refuse_far`)
        return smooth
    some = _sample(logs, model.random_state)
    hope, why = too_hopeful(policy, some), ""
    if hope and not too_hopeful(linear.model.policy(linear.q_functions), some):
        why = f"Q is linear: a smooth Q promises {hope}"
    elif some.num_trajectories >= FEWEST_TRAJECTORIES:
        lead = held_out_lead(linear.model, smooth.model, some)
        why = f"Q is linear: held out, its policy earns {lead:.3g} more a trajectory than a smooth Q's" * (lead > 0)
    if not why:
        return smooth
    return linear._replace(model=replace(linear.model, space_chosen=(why,)), chosen=(why, *linear.chosen))


def _sample(logs: Logs | LogStream, seed: int) -> Logs:
    """Sample of trajectories, the same in memory and of a stream."""
    if not isinstance(logs, Logs):
        return sample_of(logs, seed, MOST_TRAJECTORIES)
    return logs.select(logs.trajectory_ids[sampled(logs.num_trajectories, seed, MOST_TRAJECTORIES)])


def too_hopeful(policy: DiscretePolicy, logs: Logs) -> str:
    """Describe V̂ of the first stage if it exceeds what the log makes plausible; empty if it does not."""
    finished = logs.trajectory_ids[logs.is_finished]
    if len(finished) < FEWEST_FINISHED:
        return ""
    first: Any = logs.stages[logs.stages["stage"] == 1]
    promised = float(np.where(policy.is_possible[0], policy.q_values(first, 1), -np.inf).max(axis=1).mean())
    brought = logs.stages.groupby("trajectory", sort=False)["reward"].sum().loc[finished]
    rare = float(np.quantile(brought, RARE))
    return (
        ""
        if promised <= rare
        else f"{promised:.3g} a trajectory, but only one trajectory in twenty earned more than {rare:.3g}"
    )


def held_out_lead(model: QModel, other: QModel, logs: Logs) -> float:
    """How much more the policy of a model earns than that of another, by the other's Q on trajectories of neither."""
    trajectories = other.lay_out(logs)
    logs_of = [each.transitions(trajectories) for each in (model, other)]
    evaluation = replace(other, pessimism=0.0).regression(logs.num_trajectories, logs_of[1].is_possible.shape[-1])
    fold = np.random.default_rng([other.random_state, 6]).permutation(logs.num_trajectories) % 2

    def value(each: QModel, log: Transitions, held_out: Bool[np.ndarray, " n"]) -> float:
        policy = each.policy(each.fit(log.counted((~held_out).astype(np.float64))))
        given = logs_of[1]._replace(policy=other.task.target_probabilities(policy, logs, other.horizon))
        fits = fit_q(given.counted(held_out.astype(np.float64)), evaluation)
        found = judged(fits, given, evaluation.block_of_action, other.stages, trajectories.reward)
        return float(found.value[held_out, 0].mean())

    with one_thread():
        ours, others = (
            [value(each, log, fold == k) for k in range(2)] for each, log in zip((model, other), logs_of, strict=True)
        )
    return float(np.mean(ours) - np.mean(others))
