"""What each trajectory stands for, stage by stage, under the policy that is evaluated and had nothing been cut.

With ρ_t = Π_{s≤t} π(A_s | S_s) / b(A_s | S_s), a stage that was completed weighs ρ_t δ_t / Ĝ(U_t⁻), and one that was
begun ρ_t / Ĝ(U_{t−1}⁻). A trajectory that has come to its own end stays in the sums with its last weight, for a cut
would not have changed what comes after: nothing. So the weights of every stage have mean 1, and dividing by their mean
takes out much of their noise (self-normalised, or weighted, importance sampling).
"""

from dataclasses import dataclass

import numpy as np

from halfseen.learning.rows import TrajectoryArrays
from halfseen.shapes import Bool, Float


@dataclass(frozen=True)
class StageWeights:
    """Weights of the stages of a log.

    Parameters
    ----------
    weight
        Of each stage that counts, 0 elsewhere.
    standing
        The same, and of a trajectory that has ended, its last weight.
    """

    weight: Float[np.ndarray, "n T"]
    standing: Float[np.ndarray, "n T"]

    @property
    def normalised(self) -> Float[np.ndarray, "n T"]:
        """Weights by their mean over trajectories; 0 in a stage that no trajectory stands for."""
        mean = self.standing.mean(axis=0)
        return np.where(mean > 0, self.weight / np.where(mean > 0, mean, 1.0), 0.0)

    @property
    def effective_sample_size(self) -> float:
        """Effective sample size, in the stage where it is least [Kish1965]_."""
        squares = (self.standing**2).sum(axis=0)
        each = np.where(squares > 0, self.standing.sum(axis=0) ** 2 / np.where(squares > 0, squares, 1.0), 0.0)
        return float(each.min())

    def take(self, rows: Bool[np.ndarray, " n"]) -> "StageWeights":
        """Keep these trajectories."""
        return StageWeights(self.weight[rows], self.standing[rows])

    def influence(self, of_stage: Float[np.ndarray, "n T"]) -> Float[np.ndarray, " n"]:
        """What each trajectory adds to the sum over stages of the weighted means of `of_stage`; its mean is that sum.

        The noise of the weights' means is part of it, so that its standard deviation over √n is the standard error.
        """
        mean = self.standing.mean(axis=0)
        scale = np.where(mean > 0, mean, 1.0)
        average = (self.weight * of_stage).mean(axis=0) / scale
        centred = (self.weight * of_stage - self.standing * average) / scale
        return centred.sum(axis=1) + average.sum()


def likelihood_ratios(
    probabilities: Float[np.ndarray, "n T A"], propensity: Float[np.ndarray, "n T"], trajectories: TrajectoryArrays
) -> Float[np.ndarray, "n T"]:
    """ρ_t of each begun stage whose action is known; 0 elsewhere.

    Parameters
    ----------
    probabilities
        π(a | S_t).
    propensity
        b(A_t | S_t).
    trajectories
        The log.
    """
    known = trajectories.is_begun & trajectories.has_action
    return np.where(known, np.cumprod(single_ratios(probabilities, propensity, trajectories), axis=1), 0.0)


def mean_squared_ratio(
    probabilities: Float[np.ndarray, "n T A"], propensity: Float[np.ndarray, "n T"], trajectories: TrajectoryArrays
) -> float:
    """E[ρ²], by what is logged of each stage: so many uncut trajectories that were logged are worth one of the policy.

    Of ρ² itself a log knows little where few trajectories do as the policy would to their end. So it is put together
    from the stages, Π_t E[(π/b)²], as if they had nothing to do with one another, and averaged over the lengths of the
    trajectories.

    Parameters
    ----------
    probabilities, propensity, trajectories
        As for `likelihood_ratios`.
    """
    known, squares = (
        trajectories.is_begun & trajectories.has_action,
        single_ratios(probabilities, propensity, trajectories) ** 2,
    )
    mean = np.where(known, squares, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
    whole = (
        trajectories.clocks.is_finished
        if trajectories.clocks.is_finished.any()
        else np.ones(trajectories.num_trajectories, dtype=bool)
    )
    return float(np.prod(np.where(known[whole], mean, 1.0), axis=1).mean())


def single_ratios(
    probabilities: Float[np.ndarray, "n T A"], propensity: Float[np.ndarray, "n T"], trajectories: TrajectoryArrays
) -> Float[np.ndarray, "n T"]:
    """π/b of each begun stage whose action is known; 1 elsewhere."""
    taken = np.take_along_axis(probabilities, trajectories.action[..., None], axis=2)[..., 0]
    return np.where(trajectories.is_begun & trajectories.has_action, taken / propensity, 1.0)


def completed_weights(
    ratio: Float[np.ndarray, "n T"], uncut: Float[np.ndarray, "n T"], trajectories: TrajectoryArrays
) -> StageWeights:
    """ρ_t δ_t / Ĝ(U_t⁻), given the last factors in `uncut`."""
    weight = np.where(trajectories.is_completed, ratio * uncut, 0.0)
    return StageWeights(weight, _stand_on(weight, trajectories))


def begun_weights(
    ratio: Float[np.ndarray, "n T"], uncut: Float[np.ndarray, "n T"], trajectories: TrajectoryArrays
) -> StageWeights:
    """ρ_t / Ĝ(U_{t−1}⁻) of begun stages; once a trajectory has ended, ρ_L / Ĝ(U_L⁻) stands for it."""
    weight = np.where(trajectories.is_begun, ratio * uncut_before(uncut), 0.0)
    ended = _stand_on(np.where(trajectories.is_completed, ratio * uncut, 0.0), trajectories)
    return StageWeights(weight, np.where(trajectories.is_begun, weight, ended))


def uncut_before(uncut: Float[np.ndarray, "*B n T"]) -> Float[np.ndarray, "*B n T"]:
    """δ_{t−1} / Ĝ(U_{t−1}⁻), which is 1 in the first stage."""
    return np.concatenate([np.ones_like(uncut[..., :1]), uncut[..., :-1]], axis=-1)


def _stand_on(weight: Float[np.ndarray, "n T"], trajectories: TrajectoryArrays) -> Float[np.ndarray, "n T"]:
    last = trajectories.is_begun.sum(axis=1) - 1
    has_ended = trajectories.clocks.is_finished[:, None] & (np.arange(weight.shape[1]) > last[:, None])
    return np.where(has_ended, weight[np.arange(len(weight)), last][:, None], weight)
