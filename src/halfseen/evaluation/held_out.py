"""The verdict on what was learned, from the log that it was learned from: no policy is judged by what it has seen.

Trajectories are dealt into folds. For each fold a policy is learned in the same way from the others, and judged by the
trajectories of its own; what those add is pooled over the folds into one paired difference for each baseline, with one
interval. That is a statement about *this way of learning from such a log* (a data-adaptive parameter [Hubbard2016]_):
the policy learned from all of it is as a rule a little better than those of the folds.

A policy that holds margins is learned once and judged several times: as it is, the *best guess*, and with more caution.
That for which most can be claimed is *vouched for* (`vouched`), and the verdict is on it.

The lower bound of what was chosen for its large lower bound is too large, unless the bounds of all hold at once. The
estimates of policies that mostly do the same go up and down together, so that costs little: with R the correlation of
what trajectories add to the gain of each, the bounds are those of a level at which the largest of as many normal
variables stays below its quantile (max-t [WestfallYoung1993]_).

*Choosing by some folds and claiming by the others* (as in [Thomas2015]_, over all folds in turn) does not keep the
level: of eight policies that are worth the same, a claim above 0 was made in 11 % of logs instead of 2.5 %, for where
all folds choose alike nothing is held out.
"""

import warnings
from collections.abc import Callable, Collection, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np

from halfseen.errors import ArgumentError, HalfseenError, HalfseenWarning
from halfseen.estimator import check_fitted
from halfseen.evaluation.comparison import Contender
from halfseen.evaluation.estimate import Estimate
from halfseen.evaluation.evaluation import Evaluation, claim_of, guess_of
from halfseen.evaluation.exploring import NOWHERE, Exploration, exploration_of
from halfseen.evaluation.off_policy import judging
from halfseen.evaluation.specification import specification
from halfseen.evaluation.tabular import gain_of
from halfseen.evaluation.targets import LOGGING, CrossFitted
from halfseen.evaluation.verdict import Verdict
from halfseen.learning.discrete_policy import has_margin
from halfseen.learning.q_learner import CensoredQLearner
from halfseen.learning.q_space import TabularQ
from halfseen.learning.sample import latest
from halfseen.logs import Logs
from halfseen.policies.folder.specification import described
from halfseen.shapes import Float, Int
from halfseen.workers import ALONE, Pool, Workers
from halfseen.workers.threads import in_one_thread

NUM_DRAWS = 20_000


class Vouched(NamedTuple):
    """The choice among some policies."""

    chosen: int
    level: float
    """Of one interval, so that those of all hold at once as often as was asked for."""


def vouched(candidates: Sequence[Contender], baselines: Sequence[Contender], level: float) -> Vouched:
    """Choose among policies.

    Parameters
    ----------
    candidates
        What the log knows of each; the first is taken where nothing is known of any.
    baselines
        What each has to beat; those of which nothing is known do not count.
    level
        At which the intervals of all are to hold at once.
    """
    theirs = [each for each in baselines if each.values is not None and each.why_unknown is None]
    known = [each.values for each in candidates if each.values is not None and each.why_unknown is None]
    gains = [np.stack(known) - each.values for each in theirs if known]
    # A claim is on all baselines, and wrong only if one of them is.
    single = max((level_of_each(each, level) for each in gains), default=level)

    def least(one: Contender) -> float:
        """The smallest lower bound of what it earns more than a baseline."""
        if one.values is None or one.why_unknown is not None:
            return -np.inf
        return min((one.less(each, single).low for each in theirs), default=-np.inf)

    return Vouched(int(np.argmax([least(one) for one in candidates])), single)


def level_of_each(gains: Float[np.ndarray, "c n"], level: float) -> float:
    """Level of one interval, two-sided, so that the lower ends of all hold at once as often as those of one would.

    Parameters
    ----------
    gains
        What each trajectory adds to each gain.
    level
        Of one, if there were no others.
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
"""How many times its margin a policy may go by."""

MOST_JUDGED = 10_000
"""Trajectories by which what was learned from a log in passes is judged."""


@dataclass(frozen=True)
class HeldOutVerdict:
    """Whether policies learned this way beat what made the log.

    Parameters
    ----------
    verdict
        ``"better"``, ``"not better"`` or ``"inconclusive"``.
    reason
        Why, in one sentence.
    num_folds
        Number K of folds: each policy was learned from all but one.
    evaluation
        The pooled folds in full; None where there is none.
    caution
        How many times its margin the policy goes by that is judged.
    best
        The same of the policy as it was learned; None where there is none.
    exploration
        What to try more often, and where, so that the next log says more of the policy as it was learned.
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
        """The verdict on the policy as it was learned."""
        best = self.best
        if best is None:
            return self
        return replace(self, verdict=best.verdict, reason=best.reason, evaluation=best, caution=1.0)

    @property
    def claims(self) -> tuple[str, ...]:
        """What is vouched for, and the best guess, in a sentence each."""
        if self.evaluation is None or self.best is None:
            return ()
        is_alone = self.best.verdict == "better" != self.verdict
        rest = "; it is better if nothing but it was asked about (--trust best)" if is_alone else ""
        return f"Vouched for: {claim_of(self.evaluation)}.", f"Best guess: {guess_of(self.best)}{rest}."

    @property
    def sentence(self) -> str:
        """The verdict, its reason, and of which policies that is said."""
        part = "four fifths" if self.num_folds == 5 else f"{self.num_folds - 1} of {self.num_folds} parts"
        how = f"said of policies learned the same way from {part} of the log and judged on the rest"
        return f"{self.verdict.capitalize()}: {self.reason} ({how})."

    def as_dict(self) -> dict[str, Any]:
        """What policy.json keeps."""
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
    """Judge a way of learning by the log that was learned from, cross-fitted.

    The verdict is of `num_folds` policies that were learned as `learner` was, each from the trajectories outside one
    fold, and not of the learner's own policy, which saw every trajectory. They go by as much more caution as lets most
    be claimed. Where that cannot be done (too few trajectories, none of a fold that finished, probabilities that are
    missing), the verdict is ``"inconclusive"``, and the reason says why.

    Parameters
    ----------
    learner
        Fitted to `logs`.
    logs
        The log. Probabilities that it does not have are estimated.
    against, level, trust
        As for `evaluate`.
    num_folds
        Number K of folds, and of policies that are learned.
    on_progress
        Called after each policy, and once at the end.
    workers
        Who learns and judges; they begin once a policy takes long. The verdict is the same.

    Raises
    ------
    ArgumentError
        There are fewer than 2 folds.
    """
    check_fitted(learner, "policy_")
    if num_folds < 2:
        raise ArgumentError(f"num_folds is {num_folds}; at least 2 are needed")
    try:
        with warnings.catch_warnings():
            # What is doubtful in a part of the log is so in all of it, and was said when that was learned.
            warnings.simplefilter("ignore", HalfseenWarning)
            with workers.ready_if_worth() as pool:
                policy = learn_by_folds(learner, logs, num_folds, on_progress, pool)
            # Where later trajectories count more, the question is what the policy is worth now.
            present = latest(logs, learner.model_.half_life, len(learner.weights_))
            policy = replace(policy, fold=policy.fold[-present.num_trajectories :])
            if isinstance(learner.model_.space, TabularQ):
                if against not in (None, LOGGING):
                    raise ArgumentError(
                        "a policy of a table of states is compared with what made the log alone; leave against out"
                    )
                gain = gain_of(policy, learner.model_, present, float(learner.q_functions_.reg[-1, 0]), level)
                found = HeldOutVerdict(*gain.verdict(level), num_folds)
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
    """Learn one policy for each fold, from the trajectories outside it; progress is told after each."""
    if logs.num_trajectories < num_folds:
        raise ArgumentError(f"the log has {logs.num_trajectories} trajectories for {num_folds} folds; record more")
    # How cuts are dealt with is settled by the whole log; whatever else is chosen is chosen again in each fold.
    composed = learner.compose(logs)
    same = learner.unfitted().set_params(censoring=composed.targets, pessimism=composed.pessimism)
    half_life: Any = learner.model_.half_life if hasattr(learner, "model_") else None
    if half_life is not None:
        # Of fewer trajectories it has to be shorter.
        num_learned = logs.num_trajectories * (1.0 - 1.0 / num_folds)
        same.set_params(half_life=half_life * num_learned / len(learner.weights_))
    if isinstance(composed.space, TabularQ):
        # A state that one fold alone has seen is one of the others' too.
        same = same.set_params(q_function=composed.space, actions=learner.model_.task, covariates=())
    fold = np.random.default_rng([learner.random_state, 3]).permutation(logs.num_trajectories) % num_folds
    policies = []
    for policy in pool.in_order(partial(_learned_without, same, logs, fold), range(num_folds)):
        policies.append(policy)
        on_progress()
    return CrossFitted(tuple(policies), fold, learner.horizon)


def _learned_without(learner: CensoredQLearner, logs: Logs, fold: Int[np.ndarray, " n"], k: int) -> Any:
    """Policy from the trajectories outside a fold."""
    return learner.unfitted().fit(logs.select(logs.trajectory_ids[fold != k])).policy_


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
    is_logged = "probability" in logs.stages.columns and bool(logs.stages["probability"].notna().to_numpy().any())
    cautions = CAUTIONS if has_margin(learner.policy_) else CAUTIONS[:1]
    with judging(
        policy,
        logs,
        against,
        spec.censoring,
        spec.q,
        "logged" if is_logged else "estimated",
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
