"""From a policy and a log to an `Evaluation`.

A log may be implausible: impossible probabilities, covariates recorded after the action, cuts labelled as ends, or
copies. An estimate from it is biased, or its interval too narrow. So the verdict is inconclusive, unless the caller
declares the log trustworthy in this respect.
"""

from collections.abc import Collection, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, get_args

import numpy as np

from halfseen.censoring import CensoringModel
from halfseen.errors import ArgumentError
from halfseen.estimator import check_seed, is_count
from halfseen.evaluation.comparison import Contender, compared, deciding, joint_reason, share_of
from halfseen.evaluation.estimate import around, check_level, estimate_of
from halfseen.evaluation.evaluation import Evaluation, per_hour
from halfseen.evaluation.logging_rule import logging_rule
from halfseen.evaluation.problem import EvaluationProblem, Nuisances, following, logging_contribution, problem_of
from halfseen.evaluation.specification import QSpec, default_q, default_targets, q_model_of, task_of
from halfseen.evaluation.stepped_back import with_its_rule
from halfseen.evaluation.targets import (
    DEFAULT,
    LOGGING,
    LOGGING_RULE,
    Baseline,
    baseline_probabilities,
    baselines_of,
    target_probabilities,
)
from halfseen.evaluation.verdict import FEWEST_BY_STATES, FEWEST_TRAJECTORIES, why_unknown
from halfseen.evaluation.weights import Propensity, jackknifed
from halfseen.learning.judging import FittedValues
from halfseen.learning.q_model import checked_log
from halfseen.learning.targets import Targets, targets_of
from halfseen.learning.task import Task
from halfseen.logs import Logs
from halfseen.logs.plausibility import (
    MANY_COPIES,
    copied_trajectories,
    cuts_called_finished,
    leaks,
    outcomes_among_covariates,
    untrue_probabilities,
)
from halfseen.workers import ALONE, Workers, checked_workers
from halfseen.workers.threads import in_one_thread

PROBABILITIES, COVARIATES, ENDINGS, TRAJECTORIES = TRUST = ("probabilities", "covariates", "endings", "trajectories")
"""Aspects in which a log may be trusted."""


def doubt_of(logs: Logs, task: Task, has_probability: bool, trust: Collection[str] = ()) -> str | None:
    """Return why no verdict can rest on a log; None if no check fails.

    Parameters
    ----------
    logs
        The log.
    task
        The task; only covariates that it uses are checked.
    has_probability
        Whether the logged probabilities are used.
    trust
        Subset of `TRUST`: checks to omit.
    """
    is_list = isinstance(trust, Collection) and not isinstance(trust, str)
    unknown = [name for name in trust if name not in TRUST] if is_list else [trust]
    if unknown:
        raise ArgumentError(f"trust is {unknown[0]!r}; give a list of some of {', '.join(TRUST)}")
    looked_at = getattr(task, "covariates", ())
    checks = {
        PROBABILITIES: (untrue_probabilities(logs) if has_probability else ()),
        COVARIATES: (*(leaks(logs, looked_at) if has_probability else ()), *outcomes_among_covariates(logs, looked_at)),
        ENDINGS: cuts_called_finished(logs),
        TRAJECTORIES: copied_trajectories(logs, MANY_COPIES),
    }
    for name, found in checks.items():
        first = next(iter(found), None) if name not in trust else None
        if first is not None:
            return f"the log cannot be true: {first} (or trust its {name}: --trust-{name})"
    return None


HISTORY_COUNTS = (
    "earlier stages predict the outcome of a stage beyond the covariates, so trajectories are weighted as a whole; "
    "record what the stages of a trajectory have in common as a covariate"
)
"""Note for states that are incomplete."""


class Case(NamedTuple):
    """A policy, with the evidence of a log on it."""

    problem: EvaluationProblem
    judged: FittedValues
    contender: Contender


@dataclass(frozen=True)
class Judge:
    """A log prepared for evaluating policies of one task, each against the same baselines."""

    problem: EvaluationProblem
    """The log, with the first policy."""
    logs: Logs
    """The log as given."""
    own: Contender
    """Value of the logging policy."""
    baselines: tuple[Contender, ...]
    """Evidence of the log on each."""
    notes: tuple[str, ...]
    """How they were estimated."""
    level: float
    """Of the intervals."""
    doubt: str | None = None
    """Why no verdict can rest on the log; None if no check fails."""

    def problem_of(self, policy: Any) -> EvaluationProblem:
        """The same log with another policy."""
        given = self.problem
        return following(given, target_probabilities(policy, given.logs, given.trajectories, given.model.task))

    def case(self, problem: EvaluationProblem) -> Case:
        """Fit Q of a policy, and compute the contribution of each trajectory."""
        return _case("the policy", problem, problem.nuisances)

    def evaluation(self, case: Case, is_hourly: bool = False, of_each: float | None = None) -> Evaluation:
        """Compare a policy with the baselines.

        Parameters
        ----------
        case
            The policy.
        is_hourly
            Also estimate the reward per hour of the clock.
        of_each
            Level of each interval, if the policy was chosen among several whose intervals must hold simultaneously.
        """
        ours, own, level, problem = case.contender, self.own, of_each or self.level, case.problem
        compared_ = compared(ours, self.baselines, level, problem.excess, self.logs.reward_unit)
        shares = [share_of(each, own, level) for each in self.baselines]
        comparisons = tuple(replace(one, share=share) for one, share in zip(compared_, shares, strict=True))
        main, completed = deciding(comparisons), problem.completed
        num_trajectories = problem.trajectories.num_trajectories
        by_ratio = estimate_of(completed.influence(problem.trajectories.reward), completed.effective_sample_size, level)
        by_model = jackknifed(case.judged.value[..., 0], problem.fold)
        found = Evaluation(
            importance_sampling=by_ratio,
            fitted_q=around(*by_model, num_trajectories, int(problem.fold.max()), level),
            doubly_robust=ours.estimate(level),
            logging=own.estimate(level),
            difference=main.difference or ours.less(own, level),
            verdict=main.verdict,
            reason=joint_reason(comparisons),
            support=tuple(map(float, problem.support)),
            num_trajectories=num_trajectories,
            level=self.level,
            comparisons=comparisons,
            notes=(*self.notes, HISTORY_COUNTS) if problem.has_history else self.notes,
            reward_unit=self.logs.reward_unit,
            share=share_of(ours, own, level),
            per_hour=per_hour(problem, ours, own, level) if is_hourly else None,
        )
        return found if self.doubt is None else _undecided(found, self.doubt)


def _undecided(found: Evaluation, doubt: str) -> Evaluation:
    """The same numbers with an inconclusive verdict.

    A verdict that is already inconclusive keeps its reason, and the doubt becomes a note.
    """

    def open_(one: Any) -> Any:
        return one if one.verdict == "inconclusive" else replace(one, verdict="inconclusive", reason=doubt)

    notes = (doubt, *found.notes) if found.verdict == "inconclusive" else found.notes
    return replace(open_(found), comparisons=tuple(map(open_, found.comparisons)), notes=notes, doubt=doubt)


def _contenders(
    baselines: Sequence[Baseline],
    own: Contender,
    problem: EvaluationProblem,
    logs: Logs,
    known: Logs,
    is_logged: bool,
    is_default: bool,
) -> tuple[tuple[Contender, ...], tuple[str, ...]]:
    """Evidence of the log on each baseline, and how it was obtained.

    A default baseline that the log does not show is omitted.
    """
    contenders, notes, task = [], [], problem.model.task
    for name, policy in ((each.name, each.policy) for each in baselines):
        if isinstance(policy, str) and policy == LOGGING:
            contenders.append(own._replace(name=name))
            continue
        is_taken, unseen = None, None
        if isinstance(policy, str) and policy == LOGGING_RULE:
            # The problem's log also has the second-order terms of Q.
            rule = logging_rule(known, problem.trajectories, task, problem.fold, is_logged)
            notes.append(f"{name}: {rule if isinstance(rule, str) else rule.note}")
            if isinstance(rule, str):
                contenders += [] if is_default else [Contender(name, why_unknown=rule)]
                continue
            probabilities, is_taken = rule.probabilities, rule.is_taken
        else:
            probabilities = baseline_probabilities(policy, name, logs, problem.trajectories, task)
            unseen = probabilities if isinstance(probabilities, str) else None
        if isinstance(probabilities, str):
            contenders.append(Contender(name, why_unknown=why_unknown(name, problem.support, 0.0, unseen)))
        else:
            theirs = following(problem, probabilities, is_taken)
            contenders.append(_case(name, theirs, theirs.nuisances[:-1]).contender)
    return tuple(contenders), tuple(notes)


def _case(name: str, problem: EvaluationProblem, nuisances: Sequence[Nuisances]) -> Case:
    judged = problem.judged(nuisances)
    settled = problem.settled(judged)
    found = settled.contribution(judged, name)
    why = why_unknown(
        name,
        settled.support,
        found.effective_sample_size,
        settled.unseen,
        settled.trajectories.num_trajectories,
        settled.trajectories_for_one,
        FEWEST_TRAJECTORIES if settled.marginal is None else FEWEST_BY_STATES,
        settled.unexplored,
        is_estimated=settled.chances is not None,
    )
    return Case(settled, judged, found._replace(why_unknown=why))


@in_one_thread
def evaluate(
    policy: Any,
    logs: Logs,
    *,
    against: Any = None,
    censoring: Targets | CensoringModel | str | None = None,
    q: QSpec | None = None,
    propensity: Propensity | str = "logged",
    level: float = 0.95,
    random_state: int = 0,
    num_folds: int = 10,
    is_hourly: bool = False,
    trust: Collection[str] = (),
    workers: Workers = ALONE,
) -> Evaluation:
    """Estimate the value of a policy from a log of another policy, with some trajectories right-censored.

    Parameters
    ----------
    policy
        For named actions any object with `actions`, `horizon` and `probabilities`, such as `DiscretePolicy` and
        `FixedSequence`; for tables any deterministic `halfseen.world.Policy`, or one mixed with `UniformPolicy`.
    logs
        The log; other than the policy's training log, for which the estimate is optimistic (`held_out_verdict` is not).
    against
        One baseline or a list (see `halfseen.evaluation.targets.baselines_of`): the logging policy (``"logging"``), the
        same without its exploration (``"logging-rule"``), a sequence, a rule, or another policy. The verdict
        ``"better"`` is better than each. None for the first two; the second is then omitted if the log does not show
        it.
    censoring
        How the rewards that cuts removed are replaced, as in `CensoredQLearner`. With ``DoublyRobust(…)`` the value is
        doubly robust towards cuts, too; this needs the actions of cut stages. None for
        ``DoublyRobust("cox", by="pooled", truncate_at=10)`` if the log has all actions, else ``"kaplan-meier"``.
    q
        How Q of the policy is fitted; None for one Q for all stages, linear in the covariates, their squares and
        products, and the stage; for a table, the defaults of `QSpec`.
    propensity
        ``"logged"``: the column probability; ``"estimated"``: by a conditional logit on the covariates of Q.
    level
        Of the intervals.
    random_state
        Seed for assigning trajectories to folds, and drawing the landmarks of a kernel.
    num_folds
        Folds of the cross-fitting, and of the jackknife for the interval of fitted Q.
    is_hourly
        Also estimate the reward per hour of the clock.
    trust
        Aspects in which the log is trusted although a check fails (`halfseen.evaluation.off_policy.TRUST`); otherwise
        the verdict is "inconclusive".
    workers
        Workers that fit Q without each fold, used once a fit takes long. The result is the same.

    Raises
    ------
    ArgumentError
        An argument has an invalid value, or policy, log and specifications do not fit together.
    LogError
        A required probability was not logged.
    PositivityError
        A weight is not identified.
    """
    with judging(
        policy, logs, against, censoring, q, propensity, level, random_state, num_folds, trust, workers
    ) as judge:
        return judge.evaluation(judge.case(judge.problem), is_hourly)


@contextmanager
def judging(
    policy: Any,
    logs: Logs,
    against: Any = None,
    censoring: Targets | CensoringModel | str | None = None,
    q: QSpec | None = None,
    propensity: Propensity | str = "logged",
    level: float = 0.95,
    random_state: int = 0,
    num_folds: int = 10,
    trust: Collection[str] = (),
    workers: Workers = ALONE,
) -> Iterator[Judge]:
    """Prepare a log for evaluating a policy, and others of the same task; parameters as in `evaluate`."""
    checked_log(logs, Logs)
    checked_workers(workers)
    if not isinstance(q, QSpec | None):
        raise ArgumentError(f"q is {q!r}; give QSpec(q_function=…), or None for the default")
    check_level(level)
    check_seed(random_state)
    if propensity not in get_args(Propensity):
        raise ArgumentError(f"propensity is {propensity!r}; give 'logged' or 'estimated'")
    if not is_count(num_folds) or num_folds < 2:
        raise ArgumentError(f"num_folds is {num_folds!r}; give a whole number of at least 2")
    if logs.num_trajectories < 2 * num_folds:
        raise ArgumentError(
            f"the log has {logs.num_trajectories} trajectories, but {num_folds} folds need {2 * num_folds}; record more"
        )
    is_logged, is_default = propensity == "logged", against is None
    baselines = baselines_of(DEFAULT if is_default else against, logs)
    policy, known, taken_for = with_its_rule(policy, logs)
    spec, widened = default_q(policy, known) if q is None else (q, known)
    targets = default_targets(logs) if censoring is None else targets_of(censoring)
    model = q_model_of(policy, widened, targets, spec, random_state)
    doubt = doubt_of(logs, task_of(policy, known) if spec.task is None else spec.task, is_logged, trust)
    problem = problem_of(policy, widened, model, propensity, np.random.default_rng([random_state, 1]), num_folds)
    with workers.ready_if_worth() as pool:
        problem = problem._replace(pool=pool)
        own = logging_contribution(problem, LOGGING)
        theirs, notes = _contenders(baselines, own, problem, logs, known, is_logged, is_default)
        yield Judge(problem, logs, own, theirs, (*taken_for, *notes), level, doubt)
