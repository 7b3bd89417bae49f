"""What fitted Qs say of every stage of a log, and by that whether stages are to be pooled.

One Q for all stages is fitted to more rows, and is wrong where what an action brings depends on the stage. Both ways
are asked to predict the same targets of held-out trajectories: those of pooled stages, fitted without the trajectory's
own fold. Stages are separated only where this predicts better beyond noise, for a mistake costs more one way than the
other: where rows are few, separate stages lose more by noise than pooled ones by bias.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from halfseen.learning.q_model import QModel
from halfseen.learning.q_space import StageMode
from halfseen.learning.recursion import Regression, fit_each_stage, fit_q
from halfseen.learning.rows import (
    PathArrays,
    QFunctions,
    Transitions,
    imputed_target,
    of_successor,
    q_values,
    target_of,
    values_of,
)
from halfseen.workers.threads import one_thread


class Judged(NamedTuple):
    """What a Q says of every stage of a log, for one weighting or for each of B."""

    value: Float[np.ndarray, "*B n T"]
    """V̂_t(S_t)."""
    taken: Float[np.ndarray, "*B n T"]
    """Q̂_t(S_t, A_t)."""
    target: Float[np.ndarray, "*B n T"]
    """X_t = R_t + V̂_{t+1}(S_{t+1}), or Y_t where targets are imputed; 0 where there is none."""


def judged(
    fits: QFunctions,
    log: Transitions,
    block_of_action: Int[np.ndarray, " A"],
    stages: StageMode,
    reward: Float[np.ndarray, "n T"],
) -> Judged:
    """Let each stage's own Q judge it.

    Parameters
    ----------
    fits
        What was fitted to the log, or to another weighting of it.
    log
        The log.
    block_of_action, stages
        As for the fit.
    reward
        As logged; those of `log` may have had noise taken out of them.
    """
    in_order = slice(None, None, -1 if stages == "pooled" else 1)
    each = zip(fits.coefficients[in_order], np.moveaxis(log.features, 1, 0), strict=True)
    q = np.stack([q_values(of_stage, features, block_of_action) for of_stage, features in each], axis=1)
    value = values_of(q, log)
    taken = np.take_along_axis(q, log.action[..., None], axis=2)[..., 0]
    target = target_of(log._replace(reward=reward), of_successor(value))
    if fits.outcome is not None:
        target = imputed_target(log, fits.outcome[in_order], target, block_of_action)
    return Judged(value, taken, target)


NUM_FOLDS = 2

FEWEST_PATHS = 20

CLEARLY = 2.0
"""Standard errors by which separate stages must predict better."""


class StageChoice(NamedTuple):
    """How stages are treated, and why.

    Parameters
    ----------
    stages
        ``"pooled"`` or ``"separate"``.
    gain
        Mean squared error of pooled stages less that of separate ones, a trajectory.
    standard_error
        Of `gain`.
    """

    stages: StageMode
    gain: float
    standard_error: float

    @property
    def sentence(self) -> str:
        """What was chosen and why."""
        found = f"by {self.gain:.3g} ± {self.standard_error:.2g} squared error a trajectory"
        if self.stages == "separate":
            return f"stages are separate: held out, they predict better than pooled ones {found}"
        return f"stages are pooled: held out, separate ones do not clearly predict better ({found})"


def can_choose(model: QModel, paths: PathArrays) -> bool:
    """Tell whether there is a choice: several stages, none of them ended by an action, and paths to hold out."""
    return model.horizon > 1 and model.task.end_action is None and paths.num_paths >= FEWEST_PATHS


def with_stages(model: QModel, paths: PathArrays) -> tuple[QModel, tuple[str, ...]]:
    """Choose between pooled and separate stages, where that makes a difference; and all that was chosen by itself.

    Parameters
    ----------
    model
        How Q is fitted, with what comes before Q fitted to the log.
    paths
        The log, or the sample of it that decides.
    """
    if not can_choose(model, paths):
        return model, model.chosen
    choice = choose_stages(model, paths)
    return replace(model, stages=choice.stages), (*model.chosen, choice.sentence)


def choose_stages(model: QModel, paths: PathArrays) -> StageChoice:
    """Choose between pooled and separate stages.

    Parameters
    ----------
    model
        How Q is fitted, with what comes before Q fitted to the log.
    paths
        The log.
    """
    pooled = replace(model, stages="pooled", pessimism=0.0)
    log = pooled.transitions(paths)
    regression = pooled.regression(paths.num_paths, log.is_possible.shape[-1])
    fold = np.random.default_rng([model.random_state, 2]).permutation(paths.num_paths) % NUM_FOLDS
    gains = np.zeros(paths.num_paths)
    with one_thread():
        for k in range(NUM_FOLDS):
            each = _gains(log, regression, (fold != k).astype(np.float64))
            gains = np.where(fold == k, each, gains)
    gain, error = float(gains.mean()), float(gains.std(ddof=1) / np.sqrt(len(gains)))
    return StageChoice("separate" if gain > CLEARLY * error else "pooled", gain, error)


def _gains(log: Transitions, regression: Regression, counts: Float[np.ndarray, " n"]) -> Float[np.ndarray, " n"]:
    """Squared error of pooled less that of separate stages, of each trajectory, fitted to those that count."""
    some, blocks = log.counted(counts), regression.block_of_action
    pooled = judged(fit_q(some, regression), log, blocks, "pooled", log.reward)
    # Separate stages are fitted to the targets of pooled ones.
    reward = target_of(some, of_successor(pooled.value))
    separate = judged(fit_each_stage(some._replace(reward=reward), regression), log, blocks, "separate", log.reward)
    errors = (pooled.taken - pooled.target) ** 2 - (separate.taken - pooled.target) ** 2
    seen = log.weight if log.imputation is None else log.weight * log.imputation.outcome_weight
    return np.sum(np.where(seen > 0, seen * errors, 0.0), axis=1)
