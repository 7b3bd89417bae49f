"""The verdict on a learned policy from the log that it was learned from, by cross-fitting.

Trajectories are assigned to folds. For each fold a policy is learned in the same way from the other folds and evaluated
on the trajectories of its own. Their contributions are pooled over the folds into one paired difference for each
baseline, with one interval. The result is about *this way of learning from such a log* (a data-adaptive parameter
[Hubbard2016]_): the policy learned from the whole log is usually a little better than those of the folds.

A policy with margins is learned once and evaluated several times: unchanged, as the *best guess*, and with more
caution. The one with the largest claim is *vouched for* (`vouched`), and the verdict is on it.

Choosing a candidate by its lower bound biases that bound upwards, unless the bounds of all hold simultaneously. The
estimates of policies that mostly agree are highly correlated, so simultaneous bounds cost little: with R the
correlation of the contributions of trajectories to the gain of each, the bounds have the level at which the largest of
as many normal variables stays below its quantile (max-t [WestfallYoung1993]_).

*Choosing by some folds and claiming by the others* (as in [Thomas2015]_, over all folds in turn) does not keep the
level: with eight policies of equal value, a claim above 0 was made in 11 % of logs instead of 2.5 %, because nothing is
held out if all folds choose the same policy.
"""

import warnings
from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np

from halfseen.errors import ArgumentError, HalfseenError, HalfseenWarning
from halfseen.estimator import check_fitted, is_count
from halfseen.evaluation.comparison import Contender
from halfseen.evaluation.estimate import Estimate, check_level
from halfseen.evaluation.evaluation import Evaluation, claim_of, guess_of
from halfseen.evaluation.exploring import NOWHERE, Exploration, exploration_of
from halfseen.evaluation.off_policy import doubt_of, judging
from halfseen.evaluation.specification import specification
from halfseen.evaluation.tabular import gain_of
from halfseen.evaluation.targets import LOGGING, CrossFitted
from halfseen.evaluation.verdict import Verdict
from halfseen.learning.discrete_policy import has_margin
from halfseen.learning.q_learner import CensoredQLearner
from halfseen.learning.q_model import checked_log
from halfseen.learning.q_space import TabularQ
from halfseen.learning.sample import latest
from halfseen.logs import Logs
from halfseen.policies.folder.specification import described
from halfseen.shapes import Float, Int
from halfseen.workers import ALONE, Pool, Workers, checked_workers
from halfseen.workers.threads import in_one_thread

NUM_DRAWS = 20_000


class Vouched(NamedTuple):
    """The choice among several policies."""

    chosen: int
    level: float
    """Of one interval, so that all hold simultaneously at the requested level."""


def vouched(candidates: Sequence[Contender], baselines: Sequence[Contender], level: float) -> Vouched:
    """Choose among policies.

    Parameters
    ----------
    candidates
        Evidence of the log on each policy; the first is chosen if none has a known value.
    baselines
        The policies to beat; those of unknown value are ignored.
    level
        Simultaneous level of all intervals.
    """
    theirs = [each for each in baselines if each.values is not None and each.why_unknown is None]
    known = [each.values for each in candidates if each.values is not None and each.why_unknown is None]
    gains = [np.stack(known) - each.values for each in theirs if known]
    # A claim is about all baselines, and false only if one of them is false.
    single = max((level_of_each(each, level) for each in gains), default=level)

    def least(one: Contender) -> float:
        """The smallest lower bound of its gain over a baseline."""
        if one.values is None or one.why_unknown is not None:
            return -np.inf
        return min((one.less(each, single).low for each in theirs), default=-np.inf)

    return Vouched(int(np.argmax([least(one) for one in candidates])), single)


def level_of_each(gains: Float[np.ndarray, "c n"], level: float) -> float:
    """Two-sided level of one interval, so that all lower ends hold simultaneously as often as a single one would.

    Parameters
    ----------
    gains
        Contribution of each trajectory to each gain.
    level
        Level of a single interval.
    """
    spread = gains.std(axis=1)
    varied = gains[spread > 0] - gains[spread > 0].mean(axis=1, keepdims=True)
    if len(varied) < 2:
        return level
    scaled = varied / spread[spread > 0][:, None]
    values, vectors = np.linalg.eigh(scaled @ scaled.T / scaled.shape[1])
    drawn = np.random.default_rng(0).standard_normal((NUM_DRAWS, len(values)))
    largest = (drawn * np.sqrt(np.maximum(values, 0.0)) @ vectors.T).max(axis=1)
    within = NormalDist().cdf(float(np.quantile(largest, (1.0 + level) / 2.0)))
    return max(level, 2.0 * within - 1.0)


NUM_FOLDS = 5

CAUTIONS = (1.0, 2.0, 4.0, 8.0)
"""Multiples of its margin that a policy may use."""

MOST_JUDGED = 10_000
"""Largest number of trajectories to evaluate what was learned from a log in passes."""


@dataclass(frozen=True)
class HeldOutVerdict:
    """Whether policies learned in this way beat the logging policy.

    Parameters
    ----------
    verdict
        ``"better"``, ``"not better"`` or ``"inconclusive"``.
    reason
        The reason, in one sentence.
    num_folds
        Number K of folds: each policy was learned from all but one.
    evaluation
        The evaluation pooled over folds; None if there is none.
    caution
        Multiple of its margin that the evaluated policy uses. What is vouched for is
        ``more_cautious(learner.policy_, caution)`` of `halfseen.learning.discrete_policy`, not `learner.policy_`.
    best
        The evaluation of the policy as learned; None if there is none.
    exploration
        What to explore, and where, so that the next log is more informative about the policy as learned.
    """

    verdict: Verdict
    reason: str
    num_folds: int
    evaluation: Evaluation | None = None
    caution: float = 1.0
    best: Evaluation | None = None
    exploration: Exploration = NOWHERE

    @property
    def of_best(self) -> "HeldOutVerdict":
        """The verdict on the policy as learned."""
        best = self.best
        if best is None:
            return self
        return replace(self, verdict=best.verdict, reason=best.reason, evaluation=best, caution=1.0)

    @property
    def claims(self) -> tuple[str, ...]:
        """The claim that is vouched for, and the best guess, in a sentence each."""
        if self.evaluation is None or self.best is None:
            return ()
        is_alone = self.best.verdict == "better" != self.verdict
        rest = "; it is better if tested alone (--trust best)" if is_alone else ""
        return f"Vouched for: {claim_of(self.evaluation)}.", f"Best guess: {guess_of(self.best)}{rest}."

    @property
    def sentence(self) -> str:
        """The verdict, its reason, and the policies that it is about."""
        part = "four fifths" if self.num_folds == 5 else f"{self.num_folds - 1} of {self.num_folds} parts"
        kind = "policies" if self.caution == 1.0 else "more cautious policies"
        how = f"said of {kind} learned the same way from {part} of the log and judged on the rest"
        return f"{self.verdict.capitalize()}: {self.reason} ({how})."

    def as_dict(self) -> dict[str, Any]:
        """The entries of policy.json."""
        comparisons = () if self.evaluation is None else self.evaluation.comparisons
        return {
            "verdict": self.verdict,
            "reason": self.reason,
            "sentence": self.sentence,
            "claims": list(self.claims),
            "num_folds": self.num_folds,
            "caution": self.caution,
            "value": None if self.evaluation is None else _plain(self.evaluation.doubly_robust),
            "comparisons": [asdict(each) for each in comparisons],
            "exploration": self.exploration.as_dict(),
        }

    def __str__(self) -> str:
        tried = [str(self.exploration)] if self.verdict == "inconclusive" and self.exploration.regions else []
        return "\n".join([self.sentence, *self.claims, *tried])


def _plain(estimate: Estimate) -> dict[str, float]:
    return {name: float(getattr(estimate, name)) for name in ("value", "low", "high", "standard_error")}


@in_one_thread
def held_out_verdict(
    learner: CensoredQLearner,
    logs: Logs,
    *,
    against: Any = None,
    level: float = 0.95,
    num_folds: int = NUM_FOLDS,
    on_progress: Callable[[], object] = lambda: None,
    trust: Collection[str] = (),
    workers: Workers = ALONE,
) -> HeldOutVerdict:
    """Evaluate a way of learning by the log that was learned from, with cross-fitting.

    The verdict is about `num_folds` policies that were learned as `learner` was, each from the trajectories outside one
    fold, and not about the learner's own policy, which used every trajectory. They use the caution with the largest
    claim. If that is impossible (too few trajectories, a fold in which none finished, some missing probabilities), the
    verdict is ``"inconclusive"``, with the reason.

    Parameters
    ----------
    learner
        Fitted to `logs`.
    logs
        The log. Missing probabilities are estimated.
    against, level, trust
        As for `evaluate`.
    num_folds
        Number K of folds, and of policies to learn.
    on_progress
        Called after each policy, and once at the end.
    workers
        Workers for learning and evaluation, used once a policy takes long. The verdict is the same.

    Raises
    ------
    ArgumentError
        `learner` is not a `CensoredQLearner`, `logs` are not `Logs`, there are fewer than 2 folds, or `level` is none.
    """
    if not isinstance(learner, CensoredQLearner):
        raise ArgumentError(
            f"learner is a {type(learner).__name__}; give a CensoredQLearner that was fitted to the log"
        )
    check_fitted(learner, "policy_")
    checked_log(logs, Logs)
    checked_workers(workers)
    if not is_count(num_folds) or num_folds < 2:
        raise ArgumentError(f"num_folds is {num_folds!r}; give a whole number of at least 2")
    check_level(level)
    try:
        with warnings.catch_warnings():
            # Problems in a part of the log are also in the whole log, for which the warning was issued.
            warnings.simplefilter("ignore", HalfseenWarning)
            with workers.ready_if_worth() as pool:
                policy = learn_by_folds(learner, logs, num_folds, on_progress, pool)
            # If later trajectories have larger weights, the question is the present value of the policy.
            present = latest(logs, learner.model_.half_life, len(learner.weights_))
            policy = replace(policy, fold=policy.fold[-present.num_trajectories :])
            if isinstance(learner.model_.space, TabularQ):
                if against not in (None, LOGGING):
                    raise ArgumentError("a tabular policy is compared only with the logging policy; leave against out")
                gain = gain_of(policy, learner.model_, present, float(learner.q_functions_.reg[-1, 0]), level)
                doubt = doubt_of(present, learner.model_.task, False, trust)
                found = HeldOutVerdict(*(gain.verdict(level) if doubt is None else ("inconclusive", doubt)), num_folds)
            else:
                found = _judged(policy, learner, present, num_folds, against, level, trust, workers)
    except HalfseenError as error:
        return HeldOutVerdict("inconclusive", str(error), num_folds)
    on_progress()
    return found


def learn_by_folds(
    learner: CensoredQLearner,
    logs: Logs,
    num_folds: int,
    on_progress: Callable[[], object] = lambda: None,
    pool: Pool = Pool(None),  # noqa: B008 - it has nothing that could change
) -> CrossFitted:
    """Learn one policy for each fold, from the trajectories outside it; report progress after each."""
    if logs.num_trajectories < num_folds:
        raise ArgumentError(f"the log has {logs.num_trajectories} trajectories for {num_folds} folds; record more")
    # The whole log determines how cuts are treated; everything else is chosen again in each fold.
    composed = learner.compose(logs)
    same = learner.unfitted().set_params(censoring=composed.targets, pessimism=composed.pessimism)
    half_life: Any = learner.model_.half_life if hasattr(learner, "model_") else None
    if half_life is not None:
        # With fewer trajectories it must be shorter.
        num_learned = logs.num_trajectories * (1.0 - 1.0 / num_folds)
        same.set_params(half_life=half_life * num_learned / len(learner.weights_))
    if isinstance(composed.space, TabularQ):
        # States that only one fold contains must be known to the others.
        same = same.set_params(q_function=composed.space, actions=learner.model_.task, covariates=())
    fold = np.random.default_rng([learner.random_state, 3]).permutation(logs.num_trajectories) % num_folds
    policies = []
    for policy in pool.in_order(partial(_learned_without, same, logs, fold), range(num_folds)):
        policies.append(policy)
        on_progress()
    return CrossFitted(tuple(policies), fold, learner.horizon)


def _learned_without(learner: CensoredQLearner, logs: Logs, fold: Int[np.ndarray, " n"], k: int) -> Any:
    """Learn a policy from the trajectories outside a fold."""
    return learner.unfitted().fit(logs.select(logs.trajectory_ids[fold != k])).policy_


def has_probabilities(logs: Logs) -> bool:
    """Whether the probability of any action was logged."""
    return "probability" in logs.stages.columns and bool(logs.stages["probability"].notna().to_numpy().any())


def _judged(
    policy: CrossFitted,
    learner: CensoredQLearner,
    logs: Logs,
    num_folds: int,
    against: Any,
    level: float,
    trust: Collection[str],
    workers: Workers,
) -> HeldOutVerdict:
    spec = specification(learner.policy_, described(learner.model_), logs)
    cautions = CAUTIONS if has_margin(learner.policy_) else CAUTIONS[:1]
    with judging(
        policy,
        logs,
        against,
        spec.censoring,
        spec.q,
        "logged" if has_probabilities(logs) else "estimated",
        level,
        learner.random_state,
        trust=trust,
        workers=workers,
    ) as judge:
        cases = [judge.case(judge.problem_of(policy.more_cautious(times))) for times in cautions]
        found = vouched([case.contender for case in cases], judge.baselines, level)
        best, safe = judge.evaluation(cases[0]), judge.evaluation(cases[found.chosen], of_each=found.level)
        exploration = exploration_of(cases[0])
    return HeldOutVerdict(safe.verdict, safe.reason, num_folds, safe, cautions[found.chosen], best, exploration)
