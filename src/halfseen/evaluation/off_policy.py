"""From a policy and a log to an `Evaluation`."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
from jaxtyping import Bool, Float

from halfseen.censoring import CensoringModel
from halfseen.errors import ArgumentError
from halfseen.evaluation.comparison import Contender, compared, deciding, joint_reason
from halfseen.evaluation.doubly_robust import doubly_robust, held_out
from halfseen.evaluation.estimate import around, check_level, estimate_of
from halfseen.evaluation.evaluation import Evaluation
from halfseen.evaluation.fitted_q import jackknifed, judged_by_folds
from halfseen.evaluation.logging_rule import logging_rule
from halfseen.evaluation.opponents import (
    DEFAULT,
    LOGGING,
    LOGGING_RULE,
    Opponent,
    opponent_probabilities,
    opponents_of,
)
from halfseen.evaluation.propensity import Propensity, check_propensity, estimated_propensity, logged_propensity
from halfseen.evaluation.ratios import StageWeights, begun_weights, completed_weights, likelihood_ratios
from halfseen.evaluation.targets import horizon_of, target_probabilities, task_of
from halfseen.evaluation.verdict import why_unknown
from halfseen.learners.q_learning.judging import Judged
from halfseen.learners.q_learning.path_arrays import PathArrays
from halfseen.learners.q_learning.q_model import QModel
from halfseen.learners.q_learning.q_space import CrossValidation, QSpace, q_space_of, reg_of, stage_mode_of
from halfseen.learners.q_learning.targets import DoublyRobust, Targets, Weighted, targets_of
from halfseen.learners.q_learning.task import Task
from halfseen.learners.q_learning.transitions import StageMode, Transitions
from halfseen.logs import Logs


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
    against: Any = None,
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
    against
        What the policy is compared with, one or a list (see `halfseen.evaluation.opponents.opponents_of`): the logging
        policy (``"logging"``), the same without its exploration (``"logging-rule"``), a sequence, a rule, another
        policy. ``"better"`` is better than each. None for the first two; the second is then left out where the log
        does not show it.
    censoring
        What stands for what cuts took away, as for `CensoredQLearner`. With ``DoublyRobust(…)`` the value is doubly
        robust towards cuts, too; that needs the action of the stage in which a path was cut. None for
        ``DoublyRobust("kaplan-meier")`` where the log has all actions, else ``"kaplan-meier"``.
    q
        How Q of the policy is fitted; None for a linear one.
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
    model = q_model_of(
        policy,
        logs,
        default_targets(logs) if censoring is None else targets_of(censoring),
        q or QSpec(),
        random_state,
    )
    opponents = opponents_of(DEFAULT if against is None else against, logs)
    problem = _problem(policy, logs, model, propensity, np.random.default_rng([random_state, 1]), num_folds)
    return _evaluation(problem, opponents, propensity == "logged", against is None, level)


def default_targets(logs: Logs) -> Targets:
    """Doubly robust by Kaplan and Meier where the log has all actions, else weights alone."""
    return DoublyRobust() if not logs.stages["action"].isna().to_numpy().any() else Weighted()


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


def _evaluation(
    problem: "_Problem", opponents: Sequence[Opponent], has_probability: bool, is_default: bool, level: float
) -> Evaluation:
    num_paths = problem.paths.num_paths
    by_ratio = estimate_of(
        problem.completed.influence(problem.paths.reward), problem.completed.effective_sample_size, level
    )
    judged = _judged(problem, problem.log)
    num_folds = int(problem.fold.max()) + 1
    values = doubly_robust(held_out(judged, problem.fold), problem.weights)
    size = problem.weights.effective_sample_size
    ours = Contender("the policy", values, size, _why_unknown("the policy", problem))
    own = Contender(LOGGING, _logging_values(problem), problem.logging_weights.effective_sample_size)
    theirs, notes = _contenders(opponents, own, problem, has_probability, is_default)
    comparisons = compared(ours, theirs, level)
    main = deciding(comparisons)
    assert own.values is not None
    return Evaluation(
        importance_sampling=by_ratio,
        fitted_q=around(*jackknifed(judged.value[..., 0], problem.fold), num_paths, num_folds - 1, level),
        doubly_robust=estimate_of(values, size, level),
        logging=estimate_of(own.values, own.effective_sample_size, level),
        difference=main.difference or estimate_of(values - own.values, size, level),
        verdict=main.verdict,
        reason=joint_reason(comparisons),
        support=tuple(map(float, problem.support)),
        num_paths=num_paths,
        level=level,
        comparisons=comparisons,
        notes=notes,
    )


def _contenders(
    opponents: Sequence[Opponent], own: Contender, problem: "_Problem", has_probability: bool, is_default: bool
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
                contenders.append(_contender(name, _following(problem, rule.probabilities, rule.is_taken)))
            elif not is_default:
                contenders.append(Contender(name, None, 0.0, rule))
        else:
            chances = opponent_probabilities(policy, name, problem.logs, problem.paths, problem.model.task)
            is_unseen = isinstance(chances, str)
            contenders.append(
                Contender(name, None, 0.0, why_unknown(name, problem.support, 0.0, chances))
                if is_unseen
                else _contender(name, _following(problem, chances))
            )
    return contenders, tuple(notes)


def _contender(name: str, problem: "_Problem") -> Contender:
    judged = held_out(_judged(problem, problem.log), problem.fold)
    # Where weight is put on the actions of the opponent alone, what they are worth is the value of the state. So it may
    # stand for Q, and then the value is right even where the model of the opponent says another action.
    judged = judged._replace(taken=judged.value) if problem.is_revealed else judged
    values = doubly_robust(judged, problem.weights)
    return Contender(name, values, problem.weights.effective_sample_size, _why_unknown(name, problem))


def _why_unknown(who: str, problem: "_Problem") -> str | None:
    return why_unknown(who, problem.support, problem.weights.effective_sample_size, problem.unseen)


class _Problem(NamedTuple):
    """A log, the probabilities of a policy in it, and all weights."""

    logs: Logs
    paths: PathArrays
    log: Transitions
    model: QModel
    fold: np.ndarray
    likely: Float[np.ndarray, "n T"]
    """b(A_t | S_t)."""
    uncut: Float[np.ndarray, "n T"]
    """δ_t / Ĝ(U_t⁻)."""
    weights: StageWeights
    """Of the stages that have a target: begun ones if targets are imputed, else completed ones."""
    completed: StageWeights
    logging_weights: StageWeights
    support: Float[np.ndarray, " L"]
    """Of the stages that the log holds."""
    unseen: str | None
    """An action that the policy takes and that the log never saw completed, in words."""
    is_revealed: bool = False
    """Whether the log itself says where the policy was followed."""


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
    log = model.transitions(paths)
    is_imputed = log.imputation is not None
    needed = (paths.is_begun if is_imputed else paths.is_completed) & paths.has_action
    if propensity == "logged":
        likely = logged_propensity(paths, needed)
    else:
        blocks = model.task.block_of_action(probabilities.shape[-1])
        likely = estimated_propensity(paths, needed, blocks, model.stages == "pooled")
    uncut = paths.is_completed.astype(float) if model.cut_model is None else model.cut_model.weights(paths.clocks)
    as_logged = (begun_weights if is_imputed else completed_weights)(np.ones_like(likely), uncut, paths)
    fold = rng.permutation(paths.num_paths) % num_folds
    unfollowed = _Problem(
        logs, paths, log, model, fold, likely, uncut, as_logged, as_logged, as_logged, np.ones(logs.horizon), None
    )
    return _following(unfollowed, probabilities)


def _following(
    problem: _Problem,
    probabilities: Float[np.ndarray, "n T A"],
    is_taken: Bool[np.ndarray, "n T"] | None = None,
) -> _Problem:
    """The same log, with another policy; `is_taken` is whether it takes the logged action, where the log says so."""
    paths, log = problem.paths, problem.log._replace(policy=probabilities)
    followed = probabilities if is_taken is None else _one_hot(paths) * is_taken[..., None]
    ratio = likelihood_ratios(followed, problem.likely, paths)
    stage_weights = completed_weights if log.imputation is None else begun_weights
    return problem._replace(
        log=log,
        weights=stage_weights(ratio, problem.uncut, paths),
        completed=completed_weights(ratio, problem.uncut, paths),
        support=_support(followed, paths)[: problem.logs.horizon],
        unseen=_unseen(probabilities, paths, problem.model),
        is_revealed=is_taken is not None,
    )


def _one_hot(paths: PathArrays) -> Float[np.ndarray, "n T A"]:
    """1 for the action that was logged."""
    is_action = paths.action[..., None] == np.arange(paths.is_possible.shape[-1])
    return (is_action & paths.is_begun[..., None]).astype(np.float64)


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


def _judged(problem: _Problem, log: Transitions) -> Judged:
    return judged_by_folds(problem.model, log, problem.paths.reward, problem.fold)


def _logging_values(problem: _Problem) -> Float[np.ndarray, " n"]:
    """What each path adds to the value of the logging policy.

    Where targets are imputed, that is doubly robust, too: with the logged action for a policy, ρ is 1, and no
    propensity is needed.
    """
    if problem.log.imputation is None:
        return problem.logging_weights.influence(problem.paths.reward)
    judged = _judged(problem, problem.log._replace(policy=_one_hot(problem.paths)))
    return doubly_robust(held_out(judged, problem.fold), problem.logging_weights)
