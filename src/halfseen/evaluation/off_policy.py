"""From a policy and a log to an `Evaluation`."""

from copy import copy
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from halfseen.errors import ArgumentError
from halfseen.evaluation.doubly_robust import doubly_robust, held_out
from halfseen.evaluation.estimate import around, check_level, estimate_of
from halfseen.evaluation.evaluation import Evaluation
from halfseen.evaluation.fitted_q import Fitting, Judged, fitting_of, jackknifed
from halfseen.evaluation.propensity import Propensity, check_propensity, estimated_propensity, logged_propensity
from halfseen.evaluation.ratios import StageWeights, begun_weights, completed_weights, likelihood_ratios
from halfseen.evaluation.targets import target_probabilities
from halfseen.evaluation.verdict import verdict_of
from halfseen.learners.q_learning.path_arrays import PathArrays
from halfseen.learners.q_learning.q_learner import CensoredQLearner
from halfseen.learners.q_learning.recursion import Transitions
from halfseen.logs import Logs


def evaluate(
    policy: Any,
    logs: Logs,
    model: CensoredQLearner,
    *,
    propensity: Propensity | str = "logged",
    level: float = 0.95,
    random_state: int = 0,
    num_folds: int = 10,
) -> Evaluation:
    """Say what a policy is worth, from a log of another one of which paths were cut.

    Parameters
    ----------
    policy
        For named actions anything with `actions`, `horizon` and `probabilities`, such as `FlatPolicy` and
        `FixedSequence`; for tables any `halfseen.world.Policy` without chance, or mixed with `UniformPolicy`.
    logs
        The log.
    model
        How Q is fitted and what cuts depend on; only its parameters count. With ``augmented=True`` the value is doubly
        robust towards cuts, too; that needs the action of the stage in which a path was cut.
    propensity
        ``"logged"``: the column probability; ``"estimated"``: by a conditional logit on what Q looks at.
    level
        Of the intervals.
    random_state
        Seed that deals paths into folds.
    num_folds
        Folds of the cross-fitting, and of the jackknife behind the interval of fitted Q.

    Raises
    ------
    ArgumentError
        An argument has a value that it cannot take, or policy, log and model do not fit together.
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
    problem = _problem(policy, logs, model, propensity, np.random.default_rng([random_state, 1]), num_folds)
    size = problem.weights.effective_sample_size
    own_size = problem.logging_weights.effective_sample_size
    by_ratio = estimate_of(
        problem.completed.influence(problem.paths.reward), problem.completed.effective_sample_size, level
    )
    judged = _judged(problem, problem.log)
    values = doubly_robust(held_out(judged, problem.fold), problem.weights)
    own = _logging_values(problem)
    difference = estimate_of(values - own, size, level)
    verdict, reason = verdict_of(difference, problem.support, logs.horizon)
    return Evaluation(
        importance_sampling=by_ratio,
        fitted_q=around(*jackknifed(judged.value[..., 0], problem.fold), logs.num_paths, num_folds - 1, level),
        doubly_robust=estimate_of(values, size, level),
        logging=estimate_of(own, own_size, level),
        difference=difference,
        verdict=verdict,
        reason=reason,
        support=tuple(map(float, problem.support[: logs.horizon])),
        num_paths=logs.num_paths,
        level=level,
    )


class _Problem(NamedTuple):
    """A log, the policy's chances in it, and all weights."""

    paths: PathArrays
    log: Transitions
    fitting: Fitting
    fold: np.ndarray
    weights: StageWeights
    """Of the stages that have a target: begun ones if targets are imputed, else completed ones."""
    completed: StageWeights
    logging_weights: StageWeights
    support: Float[np.ndarray, " T"]


def _problem(
    policy: Any, logs: Logs, model: CensoredQLearner, propensity: str, rng: np.random.Generator, num_folds: int
) -> _Problem:
    # A copy and no clone: a model of the cuts that is fitted already is to stay so.
    learner = copy(model).fit(logs)
    if learner.cut_model_ is None and not logs.is_finished.all():
        raise ArgumentError(
            f"censoring is {model.censoring!r}, which gives no weights, but {int((~logs.is_finished).sum())} paths "
            "were cut; choose 'kaplan-meier', 'cox' or 'kernel'"
        )
    paths = learner.lay_out(logs)
    chances = target_probabilities(policy, logs, paths, learner)
    log = learner.transitions(paths, learner.cut_model_)._replace(policy=chances)
    fitting = fitting_of(learner, paths.num_paths, chances.shape[-1])
    needed = (paths.is_begun if learner.augmented else paths.is_completed) & paths.has_action
    if propensity == "logged":
        likely = logged_propensity(paths, needed)
    else:
        likely = estimated_propensity(paths, needed, fitting.blocks, learner.stages == "pooled")
    ratio = likelihood_ratios(chances, likely, paths)
    uncut = paths.is_completed.astype(float) if learner.cut_model_ is None else learner.cut_model_.weights(paths)
    stage_weights = begun_weights if learner.augmented else completed_weights
    return _Problem(
        paths=paths,
        log=log,
        fitting=fitting,
        fold=rng.permutation(paths.num_paths) % num_folds,
        weights=stage_weights(ratio, uncut, paths),
        completed=completed_weights(ratio, uncut, paths),
        logging_weights=stage_weights(np.ones_like(ratio), uncut, paths),
        support=_support(chances, paths),
    )


def _support(chances: Float[np.ndarray, "n T A"], paths: PathArrays) -> Float[np.ndarray, " T"]:
    """Share of the known actions of each stage that the policy would take; 1 where the log has no such stage."""
    known = paths.is_begun & paths.has_action
    taken = np.take_along_axis(chances, paths.action[..., None], axis=2)[..., 0] > 0
    return np.where(known.any(axis=0), (known & taken).sum(axis=0) / np.maximum(known.sum(axis=0), 1), 1.0)


def _judged(problem: _Problem, log: Transitions) -> Judged:
    """By the Qs that were fitted without each fold, and last by that of all paths."""
    without = problem.fold != np.arange(problem.fold.max() + 2)[:, None]
    return problem.fitting.judge(log, problem.paths.reward, without.astype(np.float64))


def _logging_values(problem: _Problem) -> Float[np.ndarray, " n"]:
    """What each path adds to the value of the logging policy.

    Where targets are imputed, that is doubly robust, too: with the logged action for a policy, ρ is 1, and no
    propensity is needed.
    """
    if problem.log.imputation is None:
        return problem.logging_weights.influence(problem.paths.reward)
    actions = np.arange(problem.log.is_possible.shape[-1])
    logged = (problem.paths.action[..., None] == actions) & problem.paths.is_begun[..., None]
    judged = _judged(problem, problem.log._replace(policy=logged.astype(np.float64)))
    return doubly_robust(held_out(judged, problem.fold), problem.logging_weights)
