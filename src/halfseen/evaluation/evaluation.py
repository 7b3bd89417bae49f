"""The evaluation of a policy on a log: three estimates, the values of its baselines, and a verdict.

Also its reward per hour of the clock: mean reward divided by the mean duration of a trajectory. The mean duration is
estimated like the reward, with the durations of completed stages as rewards. A cell that handles part after part earns
this in the long run (renewal reward), if no time passes between trajectories.

Also the claim, the best guess and the length of log that would decide, in plain words.
"""

from dataclasses import asdict, dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from halfseen.evaluation.comparison import Comparison, Contender, deciding, rate_of
from halfseen.evaluation.estimate import Estimate
from halfseen.evaluation.problem import EvaluationProblem, logging_contribution
from halfseen.evaluation.verdict import Needed, Verdict, in_words
from halfseen.learning.rows import TrajectoryArrays
from halfseen.text_table import aligned

SECONDS = 3600.0
STILL_S = 1e-6
"""A stage that takes no longer counts as instantaneous [s]."""
SAME_TIME = 1e-9
"""Largest difference between stages on a clock that counts stages, as a share of the longest."""


class Rate(NamedTuple):
    """Reward per hour of a policy, and the duration of its trajectories."""

    per_hour: Estimate
    """Mean reward divided by mean duration [reward/h]."""
    duration_s: Estimate
    """Mean duration of a trajectory without cuts [s]."""


@dataclass(frozen=True)
class PerHour:
    """Reward per hour of the policy and of the logging policy."""

    policy: Rate | None = None
    logging: Rate | None = None
    """None if it is not known."""
    why_unknown: str | None = None
    """The reason, in plain words; None if both are known."""


def per_hour(problem: EvaluationProblem, policy: Contender, logging: Contender, level: float) -> PerHour:
    """Estimate the reward per hour of a policy and of the logging policy from their contributions."""
    why = why_no_rate(problem.trajectories)
    if why is not None:
        return PerHour(why_unknown=why)
    timed = with_durations(problem)
    ours = timed.contribution(timed.judged(timed.nuisances[:-1]))
    own = logging_contribution(timed)
    rates = _rate(policy, ours, level), _rate(logging, own, level)
    is_known = None not in rates
    return PerHour(*rates, None if is_known else "the duration of a trajectory is too uncertain")


def _rate(earned: Contender, took: Contender, level: float) -> Rate | None:
    rate = rate_of(earned, took, level)
    if rate is None:
        return None
    scaled = {name: SECONDS * getattr(rate, name) for name in ("value", "low", "high", "standard_error", "bias")}
    return Rate(replace(rate, **scaled), took.estimate(level))


def with_durations(problem: EvaluationProblem) -> EvaluationProblem:
    """The same log, with durations of completed stages as rewards."""
    trajectories = problem.trajectories
    took_s = np.where(trajectories.is_completed, trajectories.clocks.watched_s, 0.0)
    # The model of the noise of rewards does not apply to durations.
    variates = problem.log.control_variates
    still = None if variates is None else np.zeros_like(variates)
    log = problem.log._replace(reward=took_s, control_variates=still)
    return problem._replace(trajectories=trajectories._replace(reward=took_s), log=log)


def why_no_rate(trajectories: TrajectoryArrays) -> str | None:
    """Return why the clock of a log does not measure hours; None if it does."""
    took_s, reward = (each[trajectories.is_completed] for each in (trajectories.clocks.watched_s, trajectories.reward))
    if not len(took_s) or np.median(took_s) <= STILL_S:
        return "stages take no time on the clock of these logs"
    if len(took_s) > 1 and np.ptp(took_s) <= SAME_TIME * took_s.max():
        return "all stages take the same time, so the clock of these logs seems to count stages"
    if np.allclose(reward * took_s.sum(), took_s * reward.sum(), rtol=1e-6, atol=0.0):
        return "the reward of a stage is its duration, in some unit"
    return None


@dataclass(frozen=True)
class Evaluation:
    """The value E[Σ_t R_t] of a policy, from a log of another policy.

    Parameters
    ----------
    importance_sampling
        By the weights alone: rewards of trajectories that agree with the policy. Where weights 1/Ĝ are truncated, by
        default at 10, it is biased towards stages that end early, and its interval does not include that.
    fitted_q
        By the model alone: Q̂ of the policy at the first states. Its interval does not include model error.
    doubly_robust
        By both, right if one of them is; use this one.
    logging
        Value of the logging policy without cuts.
    difference
        Doubly robust value minus that of the baseline that decides the verdict, by paired differences; minus that of
        the logging policy if the log does not have that baseline's actions.
    verdict
        ``"better"`` than every baseline, ``"not better"`` than some, or ``"inconclusive"``.
    reason
        The reason, in one sentence that names the baseline.
    support
        For each stage, the share of the logged actions to which the policy gives positive probability.
    num_trajectories
        Trajectories of the log.
    level
        Of the intervals.
    comparisons
        The policy against each baseline.
    notes
        How the logging policy without its exploration was estimated, or why it was not.
    reward_unit
        Unit of rewards; None if not given.
    share
        The doubly robust value as a multiple of that of the logging policy; None if the latter is not known to be above
        0.
    per_hour
        Reward per hour of the clock for the policy and the logging policy; None if not requested.
    doubt
        Why no verdict can rest on the log; None if nothing speaks against it.
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
        """Strength of an unrecorded cause of cuts that would overturn the verdict, in one sentence; "" if none."""
        if self.verdict == "inconclusive":
            return ""
        gammas = [one.gamma for one in self.comparisons if one.verdict == self.verdict and one.gamma is not None]
        # "Better" fails with the first baseline that is not beaten; "not better" holds as long as one is not.
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
    """The smallest gain over each baseline that can be claimed."""
    if found.verdict != "better":
        return "nothing; no policy between the logging policy and the best guess is surely better"
    baseline = deciding(found.comparisons).baseline
    return f"at least {found.difference.low:.3g}{_unit(found)} more a trajectory than {baseline}"


def guess_of(found: Evaluation) -> str:
    """The estimated gain over the strongest baseline, and how much is still to be recorded."""
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
        return "no log of practical size would show so small a difference"
    if needed.times <= 1.0:
        return "most logs of this size would show the difference that Q says, so Q may be wrong"

    def more(times: float) -> str:
        number = (times - 1.0) * num_trajectories
        size = 10.0 ** max(np.floor(np.log10(max(number, 1.0))) - 1.0, 0.0)
        return f"{np.ceil(number / size) * size:,.0f}"

    most = more(needed.high) if np.isfinite(needed.high) else "many"
    return f"about {more(needed.times)} more trajectories like these would decide ({more(needed.low)} to {most})"


def _unit(found: Evaluation) -> str:
    return f" {found.reward_unit}" if found.reward_unit else ""
