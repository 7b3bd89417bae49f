"""Fitted values of every stage of a log, and the choices made by them: how stages are pooled, and the half-life.

*Stages.* A pooled Q is fitted to more rows, but is biased if the effect of an action depends on the stage. Pooled
stages, the same with a trend (`stage_trend`) and separate ones predict the same targets of held-out trajectories: those
of pooled stages, fitted without the trajectory's own fold. A trend is chosen if it predicts better by a standard error,
separate stages if they do so by two, because the errors are asymmetric: with few rows, separate stages lose more by
variance than pooled ones by bias.

*Half-life* of recency weights. The latest fifth of the log is predicted block by block, each block from the
trajectories before it, in the function class and with the weights of eq. 3. The targets are those of completed stages,
R_t + V̂(S_{t+1}), with one V̂ for all half-lives, learned with equal weights from the trajectories before the fifth; so
the future effects of an action count, too. Of half-lives that predict better than none, the longest that does not
predict clearly worse than the best is chosen, because it leaves the most data.
"""

from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from halfseen.errors import warn
from halfseen.learning.q_model import QModel
from halfseen.learning.q_space import CrossValidation, StageMode
from halfseen.learning.recursion import QFunctions, fit_each_stage, fit_q, fit_to_values
from halfseen.learning.rows import Imputation, TrajectoryArrays, Transitions, q_values
from halfseen.learning.sample import FEWEST_TRAJECTORIES, recency_weights
from halfseen.learning.sums import or_nothing
from halfseen.logs.data_quality import text_order
from halfseen.shapes import Float, Int
from halfseen.workers.threads import one_thread

NUM_FOLDS, NUM_INNER_FOLDS = 5, 2
"""Folds that are held out, and of the cross-validation of λ within the rest."""
FEWEST_HELD_OUT = 20
"""Fewest trajectories for a choice between stage modes."""
CLEARLY_SEPARATE, CLEARLY_TREND, CLEARLY_WORSE = 2.0, 1.0, 1.0
"""Standard errors by which separate stages or a trend must predict better to be chosen, and a half-life worse to be
rejected."""
UNIT = "squared error a trajectory"
SHARES = (1 / 2, 1 / 4, 1 / 8, 1 / 16)
"""Half-lives to try, as fractions of the log."""
LATEST, NUM_BLOCKS = 1 / 5, 4


class FittedValues(NamedTuple):
    """Fitted values of a Q for every stage of a log, for one weighting or for each of B."""

    value: Float[np.ndarray, "*B n T"]
    """V̂_t(S_t)."""
    taken: Float[np.ndarray, "*B n T"]
    """Q̂_t(S_t, A_t)."""
    target: Float[np.ndarray, "*B n T"]
    """X_t = R_t + V̂_{t+1}(S_{t+1}), or Y_t if targets are imputed; 0 if there is none."""


def judged(
    fits: QFunctions,
    log: Transitions,
    block_of_action: Int[np.ndarray, " A"],
    stages: StageMode,
    reward: Float[np.ndarray, "n T"],
) -> FittedValues:
    """Evaluate each stage by its own Q, with rewards as logged; those of `log` may be variance-reduced."""
    in_order = _in_order(stages)
    q = q_of_stages(fits, log, block_of_action, stages)
    value = _values(q, log)
    taken = np.take_along_axis(q, log.action[..., None], axis=2)[..., 0]
    target = targets(log._replace(reward=reward), value)
    if fits.outcome is not None:
        target = _imputed(log, fits.outcome[in_order], target, block_of_action)
    return FittedValues(value, taken, target)


def q_of_stages(
    fits: QFunctions, log: Transitions, block_of_action: Int[np.ndarray, " A"], stages: StageMode
) -> Float[np.ndarray, "n T A"]:
    """Q̂ of every action in each stage, by the stage's own Q."""
    each = zip(fits.coefficients[_in_order(stages)], np.moveaxis(log.features, 1, 0), strict=True)
    return np.stack([q_values(of_stage, features, block_of_action) for of_stage, features in each], axis=1)


def _in_order(stages: StageMode) -> slice:
    """Order of the Q-functions by stage."""
    return slice(None, None, -1 if stages == "pooled" else 1)


def _values(q: Float[np.ndarray, "n T A"], log: Transitions) -> Float[np.ndarray, "n T"]:
    """V̂ of every state: max_a Q over the possible actions, or Σ_a π(a) Q of the given policy."""
    if log.policy is not None:
        return np.sum(np.where(log.policy > 0, log.policy * q, 0.0), axis=-1)
    return or_nothing(np.max(np.where(log.is_possible, q, -np.inf), axis=-1))


def targets(log: Transitions, value: Float[np.ndarray, "n T"]) -> Float[np.ndarray, "n T"]:
    """Return X_t = R_t + V̂(S_{t+1}); V̂ is 0 after a trajectory finished and after the last stage."""
    successor = np.pad(value[:, 1:], ((0, 0), (0, 1)))
    return log.reward + np.where(log.is_last, 0.0, successor)


def _imputed(
    log: Transitions,
    outcome: Float[np.ndarray, "T K M"],
    target: Float[np.ndarray, "n T"],
    block_of_action: Int[np.ndarray, " A"],
) -> Float[np.ndarray, "n T"]:
    """Y_t of every stage that began (see `Imputation`); X is `target`, and `outcome` its regression in each stage."""
    given = log.imputation
    assert given is not None
    num_terms = given.terms.shape[-1]
    each = outcome[np.arange(log.action.shape[1]), block_of_action[log.action]]
    own = log.action[..., None, None] if log.features.shape[2] > 1 else np.zeros_like(log.action)[..., None, None]
    features = np.take_along_axis(log.features, own, axis=2)[:, :, 0]
    at_state = each[..., 0] + np.sum(features * given.is_used * each[..., 1:-num_terms], axis=-1)
    of_time = np.sum(given.expected * each[..., -num_terms:], axis=-1)
    return given.share * target + (1.0 - given.share) * at_state + of_time


def with_stages(model: QModel, trajectories: TrajectoryArrays) -> tuple[QModel, tuple[str, ...]]:
    """Choose between pooled and separate stages by a log or a sample of it; return the model and the reason.

    There is a choice only if there are several stages, no action that ends a trajectory, and enough trajectories.
    """
    if model.horizon == 1 or model.task.end_action is not None or trajectories.num_trajectories < FEWEST_HELD_OUT:
        return model, model.chosen
    if not model.is_affordable(trajectories.features.shape[-1]):
        return model, (*model.chosen, "stages are pooled: trying separate ones too would take minutes")
    reg = CrossValidation(NUM_INNER_FOLDS) if isinstance(model.reg, CrossValidation) else model.reg
    pooled = replace(model, stages="pooled", pessimism=0.0, reg=reg)
    of_trend, of_separate = gains_over_pooled(pooled, trajectories)
    by_trend = _mean_and_error(of_trend)
    has_trend = by_trend[0] > CLEARLY_TREND * by_trend[1]
    gain, error = _mean_and_error(of_separate - of_trend if has_trend else of_separate)
    if gain > CLEARLY_SEPARATE * error:
        than = "pooled ones with a trend" if has_trend else "pooled ones"
        why = f"stages are separate: held out, they predict better than {than} by {gain:.3g} ± {error:.2g}"
        return replace(model, stages="separate"), (*model.chosen, f"{why} {UNIT}")
    numbers = f"{by_trend[0]:.3g} ± {by_trend[1]:.2g} and {gain:.3g} ± {error:.2g} {UNIT}"
    if has_trend:
        why = "stages are pooled with a trend over them: held out, it predicts better, and separate ones not clearly so"
        return model.with_trend(trajectories.features.shape[-1]), (*model.chosen, f"{why} (by {numbers})")
    why = "stages are pooled: held out, neither a trend over them nor separate ones predict clearly better"
    return replace(model, stages="pooled"), (*model.chosen, f"{why} (by {numbers})")


def gains_over_pooled(pooled: QModel, trajectories: TrajectoryArrays) -> Float[np.ndarray, "2 n"]:
    """Squared error of pooled stages minus that with a trend, and of separate ones, of each trajectory held out.

    Only completed stages are predicted, so only they are learned from.
    """
    weight, imputed = pooled.weights_and_imputation(trajectories)
    seen = _seen(weight, imputed)
    modes = pooled, pooled.with_trend(trajectories.features.shape[-1])
    inner = pooled.folds(trajectories.num_trajectories)
    log, of_trend = (mode.weighted(trajectories, seen, None, inner) for mode in modes)
    regression = pooled.regression(trajectories.num_trajectories, log.is_possible.shape[-1])
    fold = np.random.default_rng([pooled.random_state, 2]).permutation(trajectories.num_trajectories) % NUM_FOLDS
    blocks = regression.block_of_action

    def gains(k: int) -> Float[np.ndarray, "2 n"]:
        counts = (fold != k).astype(np.float64)
        some = log.counted(counts)
        fits = fit_q(some, regression)
        plain = judged(fits, log, blocks, "pooled", log.reward)
        # All are fitted to the targets of the pooled ones.
        to_be = some._replace(reward=targets(some, plain.value))
        separate = judged(fit_each_stage(to_be, regression), log, blocks, "separate", log.reward)
        trend = judged(
            fit_to_values(of_trend.counted(counts), regression, fits), of_trend, blocks, "pooled", log.reward
        )
        errors = [(each.taken - plain.target) ** 2 for each in (plain, trend, separate)]
        return np.stack([np.where(seen > 0, seen * (errors[0] - each), 0.0).sum(axis=1) for each in errors[1:]])

    with one_thread():
        return np.choose(fold, [gains(k) for k in range(NUM_FOLDS)])


def with_half_life(
    model: QModel, trajectories: TrajectoryArrays, num_trajectories: int
) -> tuple[QModel, tuple[str, ...]]:
    """Choose a half-life on held-out later trajectories of a log, if requested; return the model and the reason."""
    for trouble in text_order(trajectories.trajectory_ids if model.half_life else ()):
        warn("half_life", trouble)
    if model.half_life != "auto":
        return model, ()
    plain = replace(model, half_life=None)
    if trajectories.num_trajectories < FEWEST_TRAJECTORIES:
        why = f"{trajectories.num_trajectories} are too few to choose a half-life"
        return plain, (f"all trajectories have equal weight: {why}",)
    gains = _gains_of_recency(replace(plain, pessimism=0.0, has_many_actions=False), trajectories)
    best = gains[int(np.argmax(gains.mean(axis=1)))]
    if best.mean() <= 0.0:
        gain, error = _mean_and_error(best)
        why = f"no half-life predicts the latest ones better ({gain:.3g} ± {error:.2g} {UNIT})"
        return plain, (f"all trajectories have equal weight: {why}",)
    lacks, is_better = [_mean_and_error(best - each) for each in gains], gains.mean(axis=1) > 0.0
    # The longest half-life that does not predict clearly worse than the best leaves the most data.
    chosen = next(h for h, (lack, error) in enumerate(lacks) if is_better[h] and lack <= CLEARLY_WORSE * error)
    gain, error = _mean_and_error(gains[chosen])
    found = f"({gain:.3g} ± {error:.2g} {UNIT})"
    half_life = float(max(round(SHARES[chosen] * num_trajectories), 1))
    why = (
        f"the weight of a trajectory halves every {half_life:g} trajectories: this predicts the latest ones better "
        f"{found}"
    )
    return replace(model, half_life=half_life), (why,)


def _gains_of_recency(plain: QModel, trajectories: TrajectoryArrays) -> Float[np.ndarray, "H k"]:
    """Squared error without a half-life minus that with each, for each of the latest trajectories."""
    num, log = trajectories.num_trajectories, plain.transitions(trajectories)
    regression = plain.regression(num, log.is_possible.shape[-1])
    ends = np.linspace(num * (1.0 - LATEST), num, NUM_BLOCKS + 1).astype(int).tolist()
    later, blocks = slice(ends[0], None), regression.block_of_action
    seen = _seen(log.weight, log.imputation)[later]

    def before(end: int, half_life: float | None = None) -> Float[np.ndarray, " n"]:
        """Weights for learning from the trajectories before `end`."""
        counts = np.zeros(num)
        counts[:end] = 1.0 if half_life is None else recency_weights(end, half_life)
        return counts

    with one_thread():
        of_all = judged(fit_q(log.counted(before(ends[0])), regression), log, blocks, plain.stages, log.reward)
        to_be = log._replace(reward=targets(log, of_all.value))

        def errors(half_life: float | None) -> Float[np.ndarray, " k"]:
            fits = [fit_each_stage(to_be.counted(before(end, half_life)), regression) for end in ends[:-1]]
            each = [judged(fit, log, blocks, "separate", log.reward).taken for fit in fits]
            taken = np.concatenate([of[begin:end] for of, (begin, end) in zip(each, pairwise(ends), strict=True)])
            return np.where(seen > 0, seen * (taken - of_all.target[later]) ** 2, 0.0).sum(axis=1)

        none = errors(None)
        return np.stack([none - errors(share * num) for share in SHARES])


def _seen(weight: Float[np.ndarray, "n T"], imputed: Imputation | None) -> Float[np.ndarray, "n T"]:
    """Weights of completed stages."""
    return weight if imputed is None else weight * imputed.outcome_weight


def _mean_and_error(values: Float[np.ndarray, " k"]) -> tuple[float, float]:
    return float(values.mean()), float(values.std(ddof=1) / np.sqrt(len(values)))
