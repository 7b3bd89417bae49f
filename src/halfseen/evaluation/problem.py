"""A log, a policy to evaluate, and everything fitted before Q, which give the contribution of each trajectory."""

from collections.abc import Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from halfseen.errors import ArgumentError
from halfseen.evaluation.comparison import Contender
from halfseen.evaluation.estimate import possible
from halfseen.evaluation.marginal import CLEARLY, Marginal, history_deviate, marginal_weights, states_of
from halfseen.evaluation.specification import is_alike
from halfseen.evaluation.targets import target_probabilities
from halfseen.evaluation.weights import (
    Nuisances,
    StageWeights,
    begun_weights,
    completed_weights,
    cross_fitted,
    estimated_chances,
    held_out_chances,
    judged_without,
    likelihood_ratios,
    logged_propensity,
    mean_squared_ratio,
    nuisances_by_folds,
    nuisances_of,
    of_own_fold,
    of_taken,
    single_ratios,
    uncut_before,
)
from halfseen.learning.judging import FittedValues
from halfseen.learning.named_task import NamedActions
from halfseen.learning.q_model import QModel
from halfseen.learning.rows import TrajectoryArrays, Transitions
from halfseen.logs import Logs
from halfseen.shapes import Bool, Float
from halfseen.workers import Pool

SURE = 1.0 - 1e-9
"""With this probability or more, the log takes no other action."""


class EvaluationProblem(NamedTuple):
    """A log, the probabilities of a policy in it, and everything fitted before Q."""

    logs: Logs
    trajectories: TrajectoryArrays
    log: Transitions
    model: QModel
    fold: np.ndarray
    likely: Float[np.ndarray, "n T"]
    """b(A_t | S_t)."""
    nuisances: tuple[Nuisances, ...]
    """Fitted without each fold, and last to all trajectories."""
    ratio: Float[np.ndarray, "n T"]
    support: Float[np.ndarray, " L"]
    """Of the stages in the log."""
    beyond: Float[np.ndarray, "n T G"]
    """Covariates that Q does not use."""
    unseen: str | None
    """An action of the policy that was never completed in the log, in words."""
    unexplored: float = 0.0
    """Share of the stages in which the policy deviates where the log never did."""
    chances: Float[np.ndarray, "n T A"] | None = None
    """b(a | S_t) of known stages, if it is estimated; without the trajectory's own fold."""
    squared_ratio: float = 1.0
    """E[ρ²] of whole trajectories."""
    is_revealed: bool = False
    """Whether the log itself reveals where the policy was followed."""
    marginal: Marginal | None = None
    """Marginal weights; None to use ρ itself."""
    has_history: bool = False
    """Whether the log shows that states are incomplete."""
    pool: Pool = Pool(None)
    """Workers that fit Q."""

    @property
    def is_imputed(self) -> bool:
        """Whether stages that began have a target; otherwise completed ones."""
        return self.nuisances[-1].imputation is not None

    @property
    def effective_sample_size(self) -> float:
        """Of the trajectories, as weighted for the policy."""
        return self.stage_weights[-1].effective_sample_size

    @property
    def stage_weights(self) -> tuple[StageWeights, ...]:
        """Of the stages with a target, without each fold, and last of all trajectories."""
        return self.marginal.by_fold if self.marginal else tuple(self.weights(given) for given in self.nuisances)

    @property
    def trajectories_for_one(self) -> float:
        """Approximate number of logged trajectories that are worth one of the policy."""
        size = (self if self.marginal else as_logged(self)).effective_sample_size
        squared = 1.0 if self.marginal else self.squared_ratio
        return squared * self.trajectories.num_trajectories / size if size > 0 else np.inf

    @property
    def completed(self) -> StageWeights:
        """Weights of the completed stages."""
        return completed_weights(self.ratio, self.nuisances[-1].uncut, self.trajectories)

    def weights(self, given: Nuisances) -> StageWeights:
        """By ρ, of the stages with a target: those that began if targets are imputed, else completed ones."""
        stage_weights = completed_weights if given.imputation is None else begun_weights
        return stage_weights(self.ratio, given.uncut, self.trajectories)

    def settled(self, judged: FittedValues) -> "EvaluationProblem":
        """The same with products of ratios if the history predicts the outcome of a stage beyond its state."""
        if self.marginal is None or self.history_deviate(judged) <= CLEARLY:
            return self
        return self._replace(marginal=None, has_history=True)

    def history_deviate(self, judged: FittedValues) -> float:
        """How clearly the history predicts the outcome of a stage beyond its state."""
        own, has_target = of_own_fold(judged, self.fold), self.trajectories.is_completed
        has_target = self.trajectories.is_begun if self.is_imputed else has_target
        return history_deviate(own.target - own.taken, has_target, self.trajectories, self.beyond)

    def judged(self, nuisances: Sequence[Nuisances]) -> FittedValues:
        """Fitted values of the policy's Qs without each fold, and last of that of all trajectories, if requested."""
        fit = partial(judged_without, self.model, self.log, self.trajectories.reward, self.fold)
        return FittedValues(*map(np.stack, zip(*self.pool.in_order(fit, enumerate(nuisances)), strict=True)))

    def contribution(self, judged: FittedValues, name: str = "") -> Contender:
        """Contribution of each trajectory to the doubly robust value."""
        own = of_own_fold(judged, self.fold)
        # If only actions of the policy have weight, their Q is the value of the state. So the value may replace Q, and
        # the result is right even where a model of the policy predicts another action.
        taken = own.value if self.is_revealed else own.taken
        judged = judged._replace(taken=judged.value) if self.is_revealed else judged
        values, without = cross_fitted(judged, self.stage_weights[:-1], self.fold)
        successor = np.concatenate([own.value[:, 1:], np.zeros_like(own.value[:, :1])], axis=1)
        target = self.trajectories.reward + np.where(self.trajectories.is_last, 0.0, successor)
        deviation, within = self.deviation(target - own.taken), possible(self.trajectories)
        return Contender(
            name,
            within.moved_within(values),
            without,
            self.errors(target - taken),
            uncorrected=self.uncorrected_weight * deviation,
            truncated=self.marginal.lost * deviation if self.marginal else 0.0,
            possible=within,
            by_model=float(own.value[:, 0].mean()),
            weights=self.stage_weights[-1].normalised,
            deviation=deviation,
            effective_sample_size=self.effective_sample_size,
        )

    def errors(self, residual: Float[np.ndarray, "n T"]) -> Float[np.ndarray, "n T"]:
        """Factor of 1/Ĝ of each completed stage, given that the stage contributes its weighted residual."""
        uncut = self.nuisances[-1].uncut
        weights = self.marginal.by_fold[-1] if self.marginal else self.completed
        per = uncut_before(uncut) if self.marginal and self.is_imputed else uncut
        return np.where(uncut > 0, weights.normalised / np.where(uncut > 0, per, 1.0) * residual, 0.0)

    @property
    def uncorrected_weight(self) -> float:
        """Stages of a trajectory for which only the regression of cut stages has information.

        They end so late that completed stages represent them with no weight, or with a truncated one.
        """
        imputation = self.nuisances[-1].imputation
        if imputation is None:
            return 0.0
        missing = np.where(self.trajectories.is_begun, 1.0 - imputation.share, 0.0)
        return max(0.0, float((self.stage_weights[-1].normalised * missing).sum() / self.trajectories.num_trajectories))

    def deviation(self, residual: Float[np.ndarray, "n T"]) -> float:
        """Standard deviation of the targets of stages about Q."""
        weight = self.nuisances[-1].uncut * self.trajectories.is_completed
        return float(np.sqrt(np.sum(weight * residual**2) / weight.sum())) if weight.any() else 0.0

    @property
    def excess(self) -> Float[np.ndarray, "n T"]:
        """1/Ĝ − 1 of each completed stage: the number of cut stages that it represents."""
        uncut = self.nuisances[-1].uncut
        return np.where(uncut > 0, uncut - 1.0, 0.0)


def problem_of(
    policy: Any, logs: Logs, model: QModel, propensity: str, rng: np.random.Generator, num_folds: int
) -> EvaluationProblem:
    """Fit everything before Q, to all trajectories and without each fold."""
    model, trajectories = model.fitted(logs)
    if model.cut_model is None and not logs.is_finished.all():
        raise ArgumentError(
            f"censoring is {model.targets.name!r}, which gives no weights, but {int((~logs.is_finished).sum())} "
            "trajectories were cut; choose 'kaplan-meier', 'cox' or 'kernel'"
        )
    task, is_begun = model.task, trajectories.is_begun
    fold = rng.permutation(trajectories.num_trajectories) % num_folds
    probabilities = target_probabilities(policy, logs, trajectories, task)
    whole = nuisances_of(model, trajectories)
    log = model.weighted(trajectories, whole.weight, whole.imputation, model.folds(trajectories.num_trajectories))
    needed = (is_begun if whole.imputation else trajectories.is_completed) & trajectories.has_action
    chances = None
    if propensity == "logged":
        likely = logged_propensity(trajectories, needed)
    else:
        is_pooled = model.stages == "pooled" and is_alike(task)
        blocks = model.blocks(probabilities.shape[-1])
        likely = np.where(needed, of_taken(estimated_chances(trajectories, blocks, is_pooled), trajectories), 1.0)
        chances = held_out_chances(trajectories, blocks, is_pooled, fold, NUM_FOLDS)
    nuisances = (*nuisances_by_folds(model, trajectories, whole, fold), whole)
    alike, support = np.ones_like(likely), np.ones(logs.horizon)
    beyond = np.zeros((*is_begun.shape, 0))
    if isinstance(task, NamedActions):
        beyond = states_of(logs, trajectories, task.categories, left_out=task.covariates)
    given = EvaluationProblem(logs, trajectories, log, model, fold, likely, nuisances, alike, support, beyond, None)
    return following(given._replace(chances=chances), probabilities)


def following(
    problem: EvaluationProblem,
    probabilities: Float[np.ndarray, "n T A"],
    is_taken: Bool[np.ndarray, "n T"] | None = None,
) -> EvaluationProblem:
    """The same log with another policy; `is_taken` is whether it takes the logged action, if the log reveals it."""
    trajectories = problem.trajectories
    followed = probabilities if is_taken is None else _one_hot(trajectories) * is_taken[..., None]
    uncut = np.stack([given.uncut for given in problem.nuisances])
    single = single_ratios(followed, problem.likely, trajectories)
    marginal = None
    # A set of objects is not a state of covariates common to all actions.
    if problem.model.task.is_shared:
        marginal = marginal_weights(single, uncut, trajectories, problem.beyond, problem.fold, problem.is_imputed)
    return problem._replace(
        log=problem.log._replace(policy=probabilities),
        ratio=likelihood_ratios(single, trajectories),
        squared_ratio=mean_squared_ratio(single, trajectories),
        support=_support(followed, trajectories)[: problem.logs.horizon],
        unseen=_unseen(probabilities, trajectories, problem.model),
        unexplored=_unexplored(followed, problem),
        is_revealed=is_taken is not None,
        marginal=marginal,
        has_history=False,
    )


def as_logged(problem: EvaluationProblem) -> EvaluationProblem:
    """The same log, with the logged actions as the policy: ρ is 1, and no propensity is needed."""
    log = problem.log._replace(policy=_one_hot(problem.trajectories))
    ratio = np.ones_like(problem.ratio)
    return problem._replace(log=log, ratio=ratio, squared_ratio=1.0, is_revealed=False, marginal=None)


def logging_contribution(problem: EvaluationProblem, name: str = "") -> Contender:
    """Contribution of each trajectory to the logging policy's value; also doubly robust if targets are imputed."""
    own = as_logged(problem)
    if own.log.imputation is not None:
        return own.contribution(own.judged(own.nuisances[:-1]), name)
    reward, whole = own.trajectories.reward, own.stage_weights[-1]
    kept = [own.fold != k for k in range(len(own.nuisances) - 1)]
    each = zip(own.stage_weights, kept, strict=False)
    without = np.array([weights.take(rows).influence(reward[rows]).mean() for weights, rows in each])
    values = whole.influence(reward)
    return Contender(
        name,
        values,
        without,
        own.errors(reward),
        possible=possible(own.trajectories),
        by_model=float(values.mean()),
        effective_sample_size=whole.effective_sample_size,
    )


def _one_hot(trajectories: TrajectoryArrays) -> Float[np.ndarray, "n T A"]:
    """1 for the logged action."""
    is_action = trajectories.action[..., None] == np.arange(trajectories.is_possible.shape[-1])
    return (is_action & trajectories.is_begun[..., None]).astype(np.float64)


def _support(probabilities: Float[np.ndarray, "n T A"], trajectories: TrajectoryArrays) -> Float[np.ndarray, " T"]:
    """Share of the known actions of each stage that the policy would take; 1 if the log has no such stage."""
    known = trajectories.is_begun & trajectories.has_action
    taken = of_taken(probabilities, trajectories) > 0
    return np.where(known.any(axis=0), (known & taken).sum(axis=0) / np.maximum(known.sum(axis=0), 1), 1.0)


def _unexplored(probabilities: Float[np.ndarray, "n T A"], problem: EvaluationProblem) -> float:
    """Share of the completed stages in which the policy would take an action that the log could not take."""
    trajectories, likely = problem.trajectories, problem.likely
    known = trajectories.is_completed & trajectories.has_action
    other = np.where(known & (likely >= SURE), 1.0 - of_taken(probabilities, trajectories), 0.0)
    share = float(other.sum() / max(int(known.sum()), 1))
    if problem.chances is None:
        return share
    least = np.maximum(of_taken(problem.chances, trajectories), 1.0 / LARGEST_RATIO)
    single = of_taken(probabilities, trajectories) / least
    return max(share, _not_stood_for(single, trajectories), _not_tried(probabilities, problem.chances, trajectories))


CLEAR_LACK = 2.0
"""Standard errors by which a sum is too small by more than chance."""

LARGEST_RATIO = 100.0
"""Of π/b: one stage just beyond an estimated border says nothing of the others."""

NUM_FOLDS = 5
"""Of the estimate of b."""


def _not_stood_for(single: Float[np.ndarray, "n T"], trajectories: TrajectoryArrays) -> float:
    """Share of the stages that those which follow the policy do not represent; 0 unless it is clear.

    π/b has mean 1 wherever the log may do what the policy does. An estimated b is above 0 also where the log never
    does, but no stage there has the weight. Fitted to the same actions, b would be too large, and the mean too small.
    """
    known = trajectories.is_begun & trajectories.has_action
    lacking, num_known = np.where(known, 1.0 - single, 0.0).sum(axis=1), max(int(known.sum()), 1)
    error = float(np.sqrt(((lacking - lacking.mean()) ** 2).sum()))
    return float(lacking.sum()) / num_known if lacking.sum() > CLEAR_LACK * error else 0.0


def _not_tried(
    probabilities: Float[np.ndarray, "n T A"], chances: Float[np.ndarray, "n T A"], trajectories: TrajectoryArrays
) -> float:
    """Share of the stages in which the policy deviates from the log's most probable action; 0 if the log does, too.

    An estimated b is smooth, so beside the border between two actions it is above 0 for both, even if the log follows a
    rule without exploration. Then stages that deviate as the policy does are clearly fewer than half of what b says.
    """
    known = trajectories.is_begun & trajectories.has_action
    is_other = np.arange(chances.shape[-1]) != chances.argmax(axis=-1)[..., None]
    deviates = np.where(is_other & known[..., None], probabilities, 0.0)
    each = (deviates * chances).sum(axis=-1)
    expected, observed = float(each.sum()), float(of_taken(deviates, trajectories).sum())
    error = float(np.sqrt(max(((deviates**2 * chances).sum(axis=-1) - each**2).sum(), 0.0)))
    is_rule = observed < expected / 2.0 and expected - observed > CLEAR_LACK * error
    return float(deviates.sum()) / max(int(known.sum()), 1) if is_rule else 0.0


def _unseen(probabilities: Float[np.ndarray, "n T A"], trajectories: TrajectoryArrays, model: QModel) -> str | None:
    """The first action without a value that the policy would take in a stage that began."""
    assert model.support is not None
    blocks = model.kinds(probabilities.shape[-1])
    is_taken = ((probabilities > 0) & trajectories.is_begun[..., None]).any(axis=0)
    lacking = np.argwhere(is_taken & ~model.support.is_seen(model.stages)[:, blocks])
    if not len(lacking):
        return None
    stage, action = lacking[0]
    where = "" if model.stages == "pooled" else f" in stage {stage + 1}"
    return f"{model.task.block_names[blocks[action]]}{where}"
