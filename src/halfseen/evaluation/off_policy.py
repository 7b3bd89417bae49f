"""From a policy and a log to an `Evaluation`."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from halfseen.censoring import CensoringModel
from halfseen.errors import ArgumentError
from halfseen.evaluation.cross_fitting import Nuisances, nuisances_by_folds, nuisances_of
from halfseen.evaluation.doubly_robust import cross_fitted
from halfseen.evaluation.estimate import around, check_level, estimate_of
from halfseen.evaluation.evaluation import Evaluation
from halfseen.evaluation.fitted_q import jackknifed, judged_by_folds
from halfseen.evaluation.propensity import Propensity, check_propensity, estimated_propensity, logged_propensity
from halfseen.evaluation.ratios import StageWeights, begun_weights, completed_weights, likelihood_ratios
from halfseen.evaluation.second_order import with_second_order
from halfseen.evaluation.targets import horizon_of, target_probabilities, task_of
from halfseen.evaluation.verdict import verdict_of
from halfseen.learners.q_learning.judging import Judged
from halfseen.learners.q_learning.named_actions import NamedActions
from halfseen.learners.q_learning.path_arrays import PathArrays
from halfseen.learners.q_learning.q_model import QModel
from halfseen.learners.q_learning.q_space import CrossValidation, QSpace, q_space_of, reg_of, stage_mode_of
from halfseen.learners.q_learning.recursion import StageMode, Transitions
from halfseen.learners.q_learning.targets import DoublyRobust, Targets, Weighted, targets_of
from halfseen.learners.q_learning.task import Task
from halfseen.logs import Logs

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
        As for `halfseen.learners.CensoredQLearner`.
    stages
        The same; None for pooled ones where an action ends a path wherever it is taken, as on a table, else separate.
    """

    task: Task | None = None
    q_function: QSpace | Literal["linear", "kernel"] | str = "linear"
    stages: StageMode | str | None = None
    reg: CrossValidation | float | int | Literal["cv"] | str = "cv"


def evaluate(
    policy: Any,
    logs: Logs,
    *,
    censoring: Targets | CensoringModel | str | None = None,
    q: QSpec | None = None,
    propensity: Propensity | str = "logged",
    level: float = 0.95,
    random_state: int = 0,
    num_folds: int = 10,
) -> Evaluation:
    """Estimate the value of a policy from a log of another one of which paths were right-censored.

    Parameters
    ----------
    policy
        For named actions anything with `actions`, `horizon` and `probabilities`, such as `FlatPolicy` and
        `FixedSequence`; for tables any deterministic `halfseen.world.Policy`, or one mixed with `UniformPolicy`.
    logs
        The log.
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
    spec, logs = default_q(policy, logs) if q is None else (q, logs)
    targets = default_targets(logs) if censoring is None else targets_of(censoring)
    model = q_model_of(policy, logs, targets, spec, random_state)
    problem = _problem(policy, logs, model, propensity, np.random.default_rng([random_state, 1]), num_folds)
    return _evaluation(problem, logs.horizon, level)


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
    by_task = "separate" if task.end_action is None else "pooled"
    return QModel(
        horizon=horizon_of(policy, logs.horizon),
        task=task,
        targets=targets,
        space=q_space_of(q.q_function),
        reg=reg_of(q.reg),
        stages=stage_mode_of(by_task if q.stages is None else q.stages),
        random_state=random_state,
    )


def _evaluation(problem: "_Problem", num_reached: int, level: float) -> Evaluation:
    num_paths = problem.paths.num_paths
    size, own_size = (_effective_size(problem, ratio) for ratio in (problem.ratio, np.ones_like(problem.ratio)))
    completed = completed_weights(problem.ratio, problem.nuisances[-1].uncut, problem.paths)
    by_ratio = estimate_of(completed.influence(problem.paths.reward), completed.effective_sample_size, level)
    judged = _judged(problem, problem.log, problem.nuisances)
    values, without = cross_fitted(judged, _weights_by_fold(problem, problem.ratio), problem.fold)
    own, own_without = _logging_values(problem)
    difference = estimate_of(values - own, size, level, without - own_without)
    verdict, reason = verdict_of(difference, problem.support, num_reached, problem.unseen)
    return Evaluation(
        importance_sampling=by_ratio,
        fitted_q=around(*jackknifed(judged.value[..., 0], problem.fold), num_paths, len(without) - 1, level),
        doubly_robust=estimate_of(values, size, level, without),
        logging=estimate_of(own, own_size, level, own_without if problem.log.imputation else None),
        difference=difference,
        verdict=verdict,
        reason=reason,
        support=tuple(map(float, problem.support[:num_reached])),
        num_paths=num_paths,
        level=level,
    )


class _Problem(NamedTuple):
    """A log, the policy's probabilities in it, and all that is fitted before Q."""

    paths: PathArrays
    log: Transitions
    model: QModel
    fold: np.ndarray
    ratio: Float[np.ndarray, "n T"]
    nuisances: tuple[Nuisances, ...]
    """Fitted without each fold, and last to all paths."""
    support: Float[np.ndarray, " T"]
    unseen: str | None
    """An action that the policy takes and that the log never saw completed, in words."""


def _problem(
    policy: Any, logs: Logs, model: QModel, propensity: str, rng: np.random.Generator, num_folds: int
) -> _Problem:
    model, paths = model.fitted(logs)
    if model.cut_model is None and not logs.is_finished.all():
        raise ArgumentError(
            f"censoring is {model.targets.name!r}, which gives no weights, but {int((~logs.is_finished).sum())} paths "
            "were cut; choose 'kaplan-meier', 'cox' or 'kernel'"
        )
    probabilities = target_probabilities(policy, logs, paths, model.task)
    whole = nuisances_of(model, paths)
    log = model.weighted(paths, whole.weight, whole.imputation, model.folds(paths.num_paths))
    needed = (paths.is_begun if whole.imputation else paths.is_completed) & paths.has_action
    if propensity == "logged":
        likely = logged_propensity(paths, needed)
    else:
        blocks = model.task.block_of_action(probabilities.shape[-1])
        is_pooled = model.stages == "pooled" and model.task.end_action is not None
        likely = estimated_propensity(paths, needed, blocks, is_pooled)
    fold = rng.permutation(paths.num_paths) % num_folds
    return _Problem(
        paths=paths,
        log=log._replace(policy=probabilities),
        model=model,
        fold=fold,
        ratio=likelihood_ratios(probabilities, likely, paths),
        nuisances=(*nuisances_by_folds(model, paths, whole, fold), whole),
        support=_support(probabilities, paths),
        unseen=_unseen(probabilities, paths, model),
    )


def _support(probabilities: Float[np.ndarray, "n T A"], paths: PathArrays) -> Float[np.ndarray, " T"]:
    """Share of the known actions of each stage that the policy would take; 1 where the log has no such stage."""
    known = paths.is_begun & paths.has_action
    taken = np.take_along_axis(probabilities, paths.action[..., None], axis=2)[..., 0] > 0
    return np.where(known.any(axis=0), (known & taken).sum(axis=0) / np.maximum(known.sum(axis=0), 1), 1.0)


def _unseen(probabilities: Float[np.ndarray, "n T A"], paths: PathArrays, model: QModel) -> str | None:
    """The first action that the policy would take in a stage that was begun, and that has no value."""
    assert model.support is not None
    blocks = model.blocks(probabilities.shape[-1])
    is_taken = ((probabilities > 0) & paths.is_begun[..., None]).any(axis=0)
    lacking = np.argwhere(is_taken & ~model.support.is_seen(model.stages)[:, blocks])
    if not len(lacking):
        return None
    stage, action = lacking[0]
    where = "" if model.stages == "pooled" else f" in stage {stage + 1}"
    return f"{model.task.block_names[blocks[action]]}{where}"


def _judged(problem: _Problem, log: Transitions, nuisances: Sequence[Nuisances]) -> Judged:
    return judged_by_folds(problem.model, log, problem.paths.reward, problem.fold, nuisances)


def _weights(problem: _Problem, ratio: Float[np.ndarray, "n T"], given: Nuisances) -> StageWeights:
    """Of the stages that have a target: begun ones if targets are imputed, else completed ones."""
    stage_weights = completed_weights if given.imputation is None else begun_weights
    return stage_weights(ratio, given.uncut, problem.paths)


def _weights_by_fold(problem: _Problem, ratio: Float[np.ndarray, "n T"]) -> list[StageWeights]:
    return [_weights(problem, ratio, given) for given in problem.nuisances[:-1]]


def _effective_size(problem: _Problem, ratio: Float[np.ndarray, "n T"]) -> float:
    return _weights(problem, ratio, problem.nuisances[-1]).effective_sample_size


def _logging_values(problem: _Problem) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " K"]]:
    """What each path adds to the value of the logging policy; and that value without each fold.

    Where targets are imputed, that is doubly robust, too: with the logged action for a policy, ρ is 1, and no
    propensity is needed.
    """
    paths, alike = problem.paths, np.ones_like(problem.ratio)
    weights = _weights_by_fold(problem, alike)
    if problem.log.imputation is None:
        whole = _weights(problem, alike, problem.nuisances[-1]).influence(paths.reward)
        kept = [(one, problem.fold != k) for k, one in enumerate(weights)]
        return whole, np.array([one.take(rows).influence(paths.reward[rows]).mean() for one, rows in kept])
    actions = np.arange(problem.log.is_possible.shape[-1])
    logged = (paths.action[..., None] == actions) & paths.is_begun[..., None]
    judged = _judged(problem, problem.log._replace(policy=logged.astype(np.float64)), problem.nuisances[:-1])
    return cross_fitted(judged, weights, problem.fold)
