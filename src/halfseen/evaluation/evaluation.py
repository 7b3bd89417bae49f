"""What a policy earns in an hour of the clock: its mean reward by the mean duration of a trajectory.

The mean duration is estimated just as the reward is, with the durations of completed stages for rewards. A cell that
takes part after part earns this in the long run (renewal reward), as long as nothing passes between two trajectories.

What is known of a policy from a log: three estimates, what its baselines earn, and a verdict.

What can be claimed of a policy, what is guessed, and how long a log would decide, in plain words.
"""

from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from halfseen.evaluation.comparison import Comparison, Contender, deciding, rate_of
from halfseen.evaluation.estimate import Estimate
from halfseen.evaluation.problem import Problem, logging_contribution
from halfseen.evaluation.verdict import Needed, Verdict, in_words
from halfseen.learning.rows import TrajectoryArrays
from halfseen.text_table import aligned

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
    """What the policy and the logging policy earn in an hour."""

    policy: Rate | None = None
    logging: Rate | None = None
    """None where that is not known."""
    why_unknown: str | None = None
    """Why, in plain words; None where both are known."""


def per_hour(problem: Problem, policy: Contender, logging: Contender, level: float) -> PerHour:
    """Work out what a policy earns in an hour, and what the logging policy does, by what they add."""
    why = why_no_rate(problem.trajectories)
    if why is not None:
        return PerHour(why_unknown=why)
    timed = with_durations(problem)
    ours = timed.contribution(timed.judged(timed.nuisances[:-1]))
    own = logging_contribution(timed)
    rates = _rate(policy, ours, level), _rate(logging, own, level)
    is_known = None not in rates
    return PerHour(*rates, None if is_known else "how long a trajectory takes is known too little")


def _rate(earned: Contender, took: Contender, level: float) -> Rate | None:
    rate = rate_of(earned, took, level)
    if rate is None:
        return None
    scaled = {name: SECONDS * getattr(rate, name) for name in ("value", "low", "high", "standard_error", "bias")}
    return Rate(replace(rate, **scaled), took.estimate(level))


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
    took_s, reward = (each[trajectories.is_completed] for each in (trajectories.clocks.watched_s, trajectories.reward))
    if not len(took_s) or np.median(took_s) <= STILL_S:
        return "stages take no time on the clock of these logs"
    if len(took_s) > 1 and np.ptp(took_s) <= SAME_TIME * took_s.max():
        return "all stages take the same time, so the clock of these logs seems to count stages"
    if np.allclose(reward * took_s.sum(), took_s * reward.sum(), rtol=1e-6, atol=0.0):
        return "the reward of a stage is its duration, in whatever unit"
    return None


@dataclass(frozen=True)
class Evaluation:
    """The value E[Σ_t R_t] of a policy, from a log that another one made.

    Parameters
    ----------
    importance_sampling
        From the weights alone: rewards of trajectories that did as the policy would.
    fitted_q
        From the model alone: Q̂ of the policy where trajectories begin. Its interval does not know of a wrong model.
    doubly_robust
        From both, right if one of them is; this is the one to read.
    logging
        What the logging policy earns, had nothing been cut.
    difference
        Doubly robust value less that of the baseline that the verdict rests on, trajectory by trajectory; less that of
        the logging policy where the log has not what this baseline does.
    verdict
        ``"better"``: than every baseline; ``"not better"``: than some; or ``"inconclusive"``.
    reason
        Why, in one sentence that names the baseline.
    support
        Of each stage, the share of the logged actions that the policy would take at all.
    num_trajectories
        Trajectories of the log.
    level
        Of the intervals.
    comparisons
        The policy against each baseline.
    notes
        How the logging policy without its exploration was found, or why it was not.
    reward_unit
        What rewards are counted in; None if nobody has said.
    share
        The doubly robust value as a multiple of what the logging policy earns; None where that is not known to be
        above 0.
    per_hour
        What the policy and the logging policy earn in an hour of the clock; None where nobody asked.
    doubt
        Why no verdict can rest on the log; None where nothing speaks against it.
    """

    importance_sampling: Estimate
    fitted_q: Estimate
    doubly_robust: Estimate
    logging: Estimate
    difference: Estimate
    verdict: Verdict
    reason: str
    support: tuple[float, ...]
    num_trajectories: int
    level: float
    comparisons: tuple[Comparison, ...] = ()
    notes: tuple[str, ...] = ()
    reward_unit: str | None = None
    share: Estimate | None = None
    per_hour: PerHour | None = None
    doubt: str | None = None

    def as_dict(self) -> dict[str, Any]:
        """Everything, ready for JSON."""
        return asdict(self)

    @property
    def sentence(self) -> str:
        """The verdict and its reason."""
        return f"{self.verdict.capitalize()}: {self.reason}."

    @property
    def sensitivity(self) -> str:
        """How strong an unrecorded cause of cuts would have to be to undo the verdict, in one sentence; "" if open."""
        if self.verdict == "inconclusive":
            return ""
        gammas = [one.gamma for one in self.comparisons if one.verdict == self.verdict and one.gamma is not None]
        # "Better" falls with the first baseline that is not beaten; "not better" stands while one is not.
        return in_words((min if self.verdict == "better" else max)(gammas)) + "." if gammas else ""

    def __str__(self) -> str:
        interval = f"{100.0 * self.level:g}% interval"
        rows = {
            "doubly robust": self.doubly_robust,
            "importance sampling": self.importance_sampling,
            "fitted Q": self.fitted_q,
        }
        head = ("", "value", interval, "effective sample size")
        values = [head, *((name, *_cells(each), f"{each.effective_sample_size:.1f}") for name, each in rows.items())]
        head = ("against", "value", interval, "difference", interval, "adjusted p", "verdict")
        against: list[tuple[str, ...]] = [head]
        for one in self.comparisons:
            p = "" if one.adjusted_p is None else f"{one.adjusted_p:.2g}"
            against.append((one.baseline, *_cells(one.value), *_cells(one.difference), p, one.verdict))
        said = [self.sentence, *filter(None, [self.sensitivity])]
        return "\n".join([*said, "", *aligned(values), "", *aligned(against)])


def _cells(estimate: Estimate | None) -> tuple[str, str]:
    if estimate is None:
        return "", ""
    return f"{estimate.value:.4g}", f"{estimate.low:.4g} to {estimate.high:.4g}"


def claim_of(found: Evaluation) -> str:
    """The least that a policy earns more than each of its baselines."""
    if found.verdict != "better":
        return "nothing; no policy on the way from what the log does to the best guess is surely better"
    baseline = deciding(found.comparisons).baseline
    return f"at least {found.difference.low:.3g}{_unit(found)} more a trajectory than {baseline}"


def guess_of(found: Evaluation) -> str:
    """What a policy earns more than the baseline that is hardest to beat, and what is still to be recorded."""
    main = deciding(found.comparisons)
    if main.difference is None or main.p is None:
        return f"unknown; {main.reason}"
    gain = main.difference.value
    gained = f"{abs(gain):.3g}{_unit(found)} {'more' if gain > 0 else 'less'} a trajectory than {main.baseline}"
    if found.verdict == "better":
        return gained
    if found.doubt is not None:
        return f"{gained}, not provable while the log is in doubt"
    return f"{gained}, not yet provable; {more_trajectories(main.needed, found.num_trajectories)}"


def more_trajectories(needed: Needed | None, num_trajectories: int) -> str:
    """How many more trajectories would decide."""
    if needed is None or np.isinf(needed.times):
        return "no log of a size that can be recorded would show so small a difference"

    def more(times: float) -> str:
        number = (times - 1.0) * num_trajectories
        size = 10.0 ** max(np.floor(np.log10(max(number, 1.0))) - 1.0, 0.0)
        return f"{np.ceil(number / size) * size:,.0f}"

    most = more(needed.high) if np.isfinite(needed.high) else "many"
    return f"about {more(needed.times)} more trajectories like these would decide ({more(needed.low)} to {most})"


def _unit(found: Evaluation) -> str:
    return f" {found.reward_unit}" if found.reward_unit else ""
