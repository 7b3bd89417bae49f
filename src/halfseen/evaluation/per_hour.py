"""What a policy earns in an hour of the clock: its mean reward by the mean duration of a trajectory.

The mean duration is estimated just as the reward is, with the durations of completed stages for rewards. A cell that
takes part after part earns this in the long run (renewal reward), as long as nothing passes between two trajectories.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from halfseen.evaluation.comparison import Contender
from halfseen.evaluation.estimate import Estimate
from halfseen.evaluation.problem import Problem, logging_contribution
from halfseen.evaluation.quotient import rate_of
from halfseen.learning.rows import TrajectoryArrays

SECONDS = 3600.0
STILL_S = 1e-6
"""A stage that takes no longer took no time [s]."""
SAME_TIME = 1e-9
"""Of the longest stage: what clocks that count differ by at most."""


class Rate(NamedTuple):
    """What a policy earns in an hour, and how long its trajectories take."""

    per_hour: Estimate
    """Mean reward by mean duration [reward/h]."""
    duration_s: Estimate
    """Mean duration of a trajectory, had nothing been cut [s]."""


@dataclass(frozen=True)
class PerHour:
    """What the policy and the logging policy earn in an hour.

    Parameters
    ----------
    policy, logging
        None where that is not known.
    why_unknown
        Why, in plain words; None where both are known.
    """

    policy: Rate | None = None
    logging: Rate | None = None
    why_unknown: str | None = None


def per_hour(problem: Problem, policy: Contender, logging: Contender, level: float) -> PerHour:
    """Work out what a policy earns in an hour, and what the logging policy does.

    Parameters
    ----------
    problem
        The log, with the policy.
    policy, logging
        What trajectories add to the rewards of the two.
    level
        Of the intervals.
    """
    why = why_no_rate(problem.trajectories)
    if why is not None:
        return PerHour(why_unknown=why)
    timed = with_durations(problem)
    ours = policy._replace(**timed.contribution(timed.judged(timed.nuisances[:-1]))._asdict())
    own = logging._replace(**logging_contribution(timed)._asdict())
    rates = _rate(policy, ours, level), _rate(logging, own, level)
    is_known = None not in rates
    return PerHour(*rates, None if is_known else "how long a trajectory takes is known too little")


def _rate(earned: Contender, took: Contender, level: float) -> Rate | None:
    rate = rate_of(earned, took, level)
    return None if rate is None else Rate(_times(rate, SECONDS), took.estimate(level))


def _times(estimate: Estimate, factor: float) -> Estimate:
    """The same in another unit."""
    scaled = {name: factor * getattr(estimate, name) for name in ("value", "low", "high", "standard_error", "bias")}
    return replace(estimate, **scaled)


def with_durations(problem: Problem) -> Problem:
    """The same log, with durations of completed stages for rewards."""
    trajectories = problem.trajectories
    took_s = np.where(trajectories.is_completed, trajectories.clocks.watched_s, 0.0)
    # What is known of the noise of rewards says nothing of durations.
    variates = problem.log.control_variates
    still = None if variates is None else np.zeros_like(variates)
    log = problem.log._replace(reward=took_s, control_variates=still)
    return problem._replace(trajectories=trajectories._replace(reward=took_s), log=log)


def why_no_rate(trajectories: TrajectoryArrays) -> str | None:
    """Say why the clock of a log tells no hours; None if it does."""
    took_s, reward = (
        trajectories.clocks.watched_s[trajectories.is_completed],
        trajectories.reward[trajectories.is_completed],
    )
    if not len(took_s) or np.median(took_s) <= STILL_S:
        return "stages take no time on the clock of these logs"
    if len(took_s) > 1 and np.ptp(took_s) <= SAME_TIME * took_s.max():
        return "all stages take the same time, so the clock of these logs seems to count stages"
    if np.allclose(reward * took_s.sum(), took_s * reward.sum(), rtol=1e-6, atol=0.0):
        return "the reward of a stage is its duration, in whatever unit"
    return None
