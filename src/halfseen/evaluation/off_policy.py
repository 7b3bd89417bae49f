"""From a policy and a log to an `Evaluation`."""

from collections.abc import Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from halfseen.censoring import CensoringModel
from halfseen.errors import ArgumentError
from halfseen.evaluation.doubts import doubt_of
from halfseen.evaluation.estimate import check_level
from halfseen.evaluation.evaluation import Evaluation
from halfseen.evaluation.judge import Judge, judge_of
from halfseen.evaluation.opponents import DEFAULT, opponents_of
from halfseen.evaluation.problem import problem_of
from halfseen.evaluation.propensity import Propensity, check_propensity
from halfseen.evaluation.second_order import with_second_order
from halfseen.evaluation.targets import horizon_of, is_alike, task_of
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
    """Estimate the value of a policy from a log of another one of which trajectories were right-censored.

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
        robust towards cuts, too; that needs the action of the stage in which a trajectory was cut. None for
        ``DoublyRobust("cox", by="pooled", truncate_at=10)`` where the log has all actions, else ``"kaplan-meier"``.
    q
        How Q of the policy is fitted; None for one that all stages share, linear in the covariates, their squares and
        products, and the stage; of a table, as `QSpec` has it.
    propensity
        ``"logged"``: the column probability; ``"estimated"``: by a conditional logit on what Q looks at.
    level
        Of the intervals.
    random_state
        Seed that deals trajectories into folds, and draws the landmarks of a kernel.
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
    with judging(
        policy,
        logs,
        against=against,
        censoring=censoring,
        q=q,
        propensity=propensity,
        level=level,
        random_state=random_state,
        num_folds=num_folds,
        trust=trust,
        workers=workers,
    ) as judge:
        return judge.evaluation(judge.case(judge.problem), is_hourly)


@contextmanager
def judging(
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
    trust: Collection[str] = (),
    workers: Workers = ALONE,
) -> Iterator[Judge]:
    """Make a log ready to judge a policy, and others that decide about the same; parameters are those of `evaluate`."""
    check_level(level)
    check_propensity(propensity)
    if num_folds < 2:
        raise ArgumentError(f"num_folds is {num_folds}; at least 2 are needed")
    if logs.num_trajectories < 2 * num_folds:
        raise ArgumentError(
            f"the log has {logs.num_trajectories} trajectories, and {num_folds} folds need {2 * num_folds}; record more"
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
        yield judge_of(shared, logs, opponents, level, doubt, has_probability=is_logged, is_default=against is None)


def default_targets(logs: Logs) -> Targets:
    """Doubly robust where the log has all actions, by Cox on the clock of stages, with weights truncated; else weights.

    Cuts may depend on all that a trajectory has shown so far, and on how long its stage drags on. Where a stage is
    hardly ever seen to end, no weight is believed beyond `LARGEST_WEIGHT`; there the regression of cut stages has to
    serve.
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
