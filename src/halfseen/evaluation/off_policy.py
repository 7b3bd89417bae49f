"""From a policy and a log to an `Evaluation`."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from halfseen.censoring import CensoringModel
from halfseen.errors import ArgumentError
from halfseen.evaluation.comparison import Comparison, Contender, compared, deciding, joint_reason
from halfseen.evaluation.doubts import doubt_of
from halfseen.evaluation.estimate import around, check_level, estimate_of
from halfseen.evaluation.evaluation import Evaluation
from halfseen.evaluation.fitted_q import jackknifed
from halfseen.evaluation.logging_rule import logging_rule
from halfseen.evaluation.opponents import (
    DEFAULT,
    LOGGING,
    LOGGING_RULE,
    Opponent,
    opponent_probabilities,
    opponents_of,
)
from halfseen.evaluation.per_hour import per_hour
from halfseen.evaluation.problem import Problem, as_logged, following, logging_contribution, problem_of
from halfseen.evaluation.propensity import Propensity, check_propensity
from halfseen.evaluation.quotient import share_of
from halfseen.evaluation.second_order import with_second_order
from halfseen.evaluation.targets import horizon_of, is_alike, task_of
from halfseen.evaluation.verdict import FEWEST_BY_STATES, FEWEST_PATHS, why_unknown
from halfseen.learning.judging import Judged
from halfseen.learning.named_task import NamedActions
from halfseen.learning.q_model import QModel
from halfseen.learning.q_space import CrossValidation, QSpace, StageMode, q_space_of, reg_of, stage_mode_of
from halfseen.learning.targets import DoublyRobust, Targets, Weighted, targets_of
from halfseen.learning.task import Task
from halfseen.logs import Logs
from halfseen.workers import ALONE, Workers
from halfseen.workers.threads import in_one_thread

LARGEST_WEIGHT = 10.0
"""Bound of 1/Ĝ where a user has said nothing of cuts."""

HISTORY_COUNTS = (
    "what went before a stage foretells its outcome beyond the covariates, so trajectories are weighted as a whole; "
    "record what they have in common as a covariate"
)
"""Said where states do not tell all."""

LITTLE_REG = 1e-3
"""λ where a user has said nothing of Q. One that held-out stages choose suits those that are seen to end, and shrinks
away what is to be said of those that are not; the bias that it leaves is in no interval."""


@dataclass(frozen=True)
class QSpec:
    """How Q of a policy is fitted for its evaluation.

    Parameters
    ----------
    task
        What is decided; None for what the policy says.
    q_function, reg
        As for `halfseen.learning.CensoredQLearner`.
    stages
        The same; None for pooled ones where stages are alike, as on tables, else separate.
    """

    task: Task | None = None
    q_function: QSpace | Literal["linear", "quadratic", "kernel", "smooth"] | str = "linear"
    stages: StageMode | str | None = None
    reg: CrossValidation | float | int | Literal["cv"] | str = "cv"


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
    """Estimate the value of a policy from a log of another one of which paths were right-censored.

    Parameters
    ----------
    policy
        For named actions anything with `actions`, `horizon` and `probabilities`, such as `FlatPolicy` and
        `FixedSequence`; for tables any deterministic `halfseen.world.Policy`, or one mixed with `UniformPolicy`.
    logs
        The log.
    against
        What the policy is compared with, one or a list (see `halfseen.evaluation.opponents.opponents_of`): the logging
        policy (``"logging"``), the same without its exploration (``"logging-rule"``), a sequence, a rule, another
        policy. ``"better"`` is better than each. None for the first two; the second is then left out where the log
        does not show it.
    censoring
        What stands for what cuts took away, as for `CensoredQLearner`. With ``DoublyRobust(…)`` the value is doubly
        robust towards cuts, too; that needs the action of the stage in which a path was cut. None for
        ``DoublyRobust("cox", by="pooled", truncate_at=10)`` where the log has all actions, else ``"kaplan-meier"``.
    q
        How Q of the policy is fitted; None for one that all stages share, linear in the covariates, their squares and
        products, and the stage; of a table, as `QSpec` has it.
    propensity
        ``"logged"``: the column probability; ``"estimated"``: by a conditional logit on what Q looks at.
    level
        Of the intervals.
    random_state
        Seed that deals paths into folds, and draws the landmarks of a kernel.
    num_folds
        Folds of the cross-fitting, and of the jackknife behind the interval of fitted Q.
    is_hourly
        Work out what is earned in an hour of the clock, too.
    trust
        In what the log is trusted, though it looks untrue (`halfseen.evaluation.doubts.TRUST`): without that its
        verdict is "cannot be said".
    workers
        Who fits Q without each fold; they begin once a fit takes long. The answer is the same.

    Raises
    ------
    ArgumentError
        An argument has a value that it cannot take, or policy, log and specifications do not fit together.
    LogError
        A probability that is needed was not logged.
    PositivityError
        A weight is not identified.
    """
    check_level(level)
    check_propensity(propensity)
    if num_folds < 2:
        raise ArgumentError(f"num_folds is {num_folds}; at least 2 are needed")
    if logs.num_paths < 2 * num_folds:
        raise ArgumentError(
            f"the log has {logs.num_paths} path(s), and {num_folds} folds need {2 * num_folds}; record more"
        )
    is_logged = propensity == "logged"
    opponents = opponents_of(DEFAULT if against is None else against, logs)
    spec, widened = default_q(policy, logs) if q is None else (q, logs)
    targets = default_targets(logs) if censoring is None else targets_of(censoring)
    model = q_model_of(policy, widened, targets, spec, random_state)
    doubt = doubt_of(logs, task_of(policy, logs) if spec.task is None else spec.task, is_logged, trust)
    problem = problem_of(policy, widened, model, propensity, np.random.default_rng([random_state, 1]), num_folds)
    with workers.ready_if_worth() as pool:
        shared = problem._replace(pool=pool)
        found = _evaluation(shared, logs, opponents, is_logged, against is None, level, is_hourly)
    return found if doubt is None else _undecided(found, doubt)


def _undecided(found: Evaluation, doubt: str) -> Evaluation:
    """The same numbers, by which nothing is called better or worse.

    What cannot be said anyway keeps its own reason, and the doubt is noted.
    """
    comparisons = tuple(
        one if one.verdict == "cannot be said" else replace(one, verdict="cannot be said", reason=doubt)
        for one in found.comparisons
    )
    if found.verdict == "cannot be said":
        return replace(found, comparisons=comparisons, notes=(doubt, *found.notes))
    return replace(found, comparisons=comparisons, verdict="cannot be said", reason=doubt)


def default_targets(logs: Logs) -> Targets:
    """Doubly robust where the log has all actions, by Cox on the clock of stages, with weights truncated; else weights.

    Cuts may depend on all that a path has shown so far, and on how long its stage drags on. Where a stage is hardly
    ever seen to end, no weight is believed beyond `LARGEST_WEIGHT`; there the regression of cut stages has to serve.
    """
    if logs.stages["action"].isna().to_numpy().any():
        return Weighted()
    return DoublyRobust("cox", by="pooled", truncate_at=LARGEST_WEIGHT)


def default_q(policy: Any, logs: Logs) -> tuple[QSpec, Logs]:
    """Q of named actions is one for all stages, given the stage and second-order terms, which the log then has."""
    task = task_of(policy, logs)
    if not isinstance(task, NamedActions):
        return QSpec(task), logs
    task, logs = with_second_order(task, logs)
    return QSpec(task, stages="pooled", reg=LITTLE_REG), logs


def q_model_of(policy: Any, logs: Logs, targets: Targets, q: QSpec, random_state: int = 0) -> QModel:
    """Compose how Q of a policy is fitted to a log."""
    task = task_of(policy, logs) if q.task is None else q.task
    by_task = "pooled" if is_alike(task) else "separate"
    return QModel(
        horizon=horizon_of(policy, logs.horizon),
        task=task,
        targets=targets,
        space=q_space_of(q.q_function),
        reg=reg_of(q.reg),
        stages=stage_mode_of(by_task if q.stages is None else q.stages),
        random_state=random_state,
    )


def _evaluation(
    problem: Problem,
    logs: Logs,
    opponents: Sequence[Opponent],
    has_probability: bool,
    is_default: bool,
    level: float,
    is_hourly: bool,
) -> Evaluation:
    judged = problem.judged(problem.nuisances)
    problem = problem.settled(judged)
    ours, own = _contender("the policy", problem, judged), _logging(problem)
    theirs, notes = _contenders(opponents, own, problem, logs, has_probability, is_default)
    comparisons = _with_shares(compared(ours, theirs, level, problem.excess, logs.reward_unit), theirs, own, level)
    main = deciding(comparisons)
    notes = (*notes, HISTORY_COUNTS) if problem.has_history else notes
    num_paths, num_folds = problem.paths.num_paths, int(problem.fold.max()) + 1
    completed = problem.completed
    by_ratio = estimate_of(completed.influence(problem.paths.reward), completed.effective_sample_size, level)
    return Evaluation(
        importance_sampling=by_ratio,
        fitted_q=around(*jackknifed(judged.value[..., 0], problem.fold), num_paths, num_folds - 1, level),
        doubly_robust=ours.estimate(level),
        logging=own.estimate(level),
        difference=main.difference or ours.less(own, level),
        verdict=main.verdict,
        reason=joint_reason(comparisons),
        support=tuple(map(float, problem.support)),
        num_paths=num_paths,
        level=level,
        comparisons=comparisons,
        notes=notes,
        reward_unit=logs.reward_unit,
        share=share_of(ours, own, level),
        per_hour=per_hour(problem, ours, own, level) if is_hourly else None,
    )


def _with_shares(
    comparisons: Sequence[Comparison], theirs: Sequence[Contender], own: Contender, level: float
) -> tuple[Comparison, ...]:
    shares = [share_of(each, own, level) for each in theirs]
    return tuple(replace(one, share=share) for one, share in zip(comparisons, shares, strict=True))


def _contenders(
    opponents: Sequence[Opponent],
    own: Contender,
    problem: Problem,
    logs: Logs,
    has_probability: bool,
    is_default: bool,
) -> tuple[list[Contender], tuple[str, ...]]:
    """What each path adds to the value of each opponent, and what is to be known of how that was found."""
    contenders, notes = [], []
    for name, policy in ((each.name, each.policy) for each in opponents):
        if isinstance(policy, str) and policy == LOGGING:
            contenders.append(own._replace(name=name))
        elif isinstance(policy, str) and policy == LOGGING_RULE:
            rule = logging_rule(problem.logs, problem.paths, problem.model.task, problem.fold, has_probability)
            notes.append(f"{name}: {rule if isinstance(rule, str) else rule.note}")
            if not isinstance(rule, str):
                contenders.append(_contender(name, following(problem, rule.probabilities, rule.is_taken)))
            elif not is_default:
                contenders.append(Contender(name, why_unknown=rule))
        else:
            probabilities = opponent_probabilities(policy, name, logs, problem.paths, problem.model.task)
            contenders.append(
                Contender(name, why_unknown=why_unknown(name, problem.support, 0.0, probabilities))
                if isinstance(probabilities, str)
                else _contender(name, following(problem, probabilities))
            )
    return contenders, tuple(notes)


def _contender(name: str, problem: Problem, judged: Judged | None = None) -> Contender:
    judged = problem.judged(problem.nuisances[:-1]) if judged is None else judged
    problem = problem.settled(judged)
    added = problem.contribution(judged)
    size, num_paths = problem.effective_sample_size, problem.paths.num_paths
    fewest = FEWEST_PATHS if problem.marginal is None else FEWEST_BY_STATES
    why = why_unknown(name, problem.support, size, problem.unseen, num_paths, problem.paths_for_one, fewest)
    return Contender(name, effective_sample_size=size, why_unknown=why, **added._asdict())


def _logging(problem: Problem) -> Contender:
    size = as_logged(problem).effective_sample_size
    return Contender(LOGGING, effective_sample_size=size, **logging_contribution(problem)._asdict())
