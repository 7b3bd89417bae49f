"""Which half-life of weights by recency predicts the latest trajectories best.

The latest fifth is predicted block by block, each by what came before it, in the class of Q and with the weights that
eq. 3 has. Predicted are the targets of completed stages, R_t + V̂(S_{t+1}), with one V̂ for all, learned before the fifth
from all alike: so that it matters, too, what an action leads to. Where a half-life predicts better than none, the
longest is taken that does not predict clearly worse than the best one, for it leaves most to learn from.
"""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from halfseen.learning.judging import judged, targets
from halfseen.learning.q_model import QModel
from halfseen.learning.recency import FEWEST_TRAJECTORIES, recency_weights
from halfseen.learning.recursion import fit_each_stage, fit_q
from halfseen.learning.rows import TrajectoryArrays
from halfseen.shapes import Float
from halfseen.workers.threads import one_thread

SHARES = (1 / 2, 1 / 4, 1 / 8, 1 / 16)
"""Of the log: half-lives that are tried."""
LATEST, NUM_BLOCKS = 1 / 5, 4
CLEARLY = 1.0
"""Standard errors."""


def with_half_life(
    model: QModel, trajectories: TrajectoryArrays, num_trajectories: int
) -> tuple[QModel, tuple[str, ...]]:
    """Choose a half-life, if that is asked for; and say why.

    Parameters
    ----------
    model
        How Q is fitted, with what comes before Q fitted to the log.
    trajectories
        The log, or the sample of it that decides.
    num_trajectories
        Of the log.
    """
    if model.half_life != "auto":
        return model, ()
    if trajectories.num_trajectories < FEWEST_TRAJECTORIES:
        why = f"{trajectories.num_trajectories} are too few to choose a half-life"
        return replace(model, half_life=None), (f"all trajectories count alike: {why}",)
    gains = _held_out_gains(replace(model, half_life=None, pessimism=0.0, has_many_actions=False), trajectories)
    chosen = _longest_good(gains)
    gain, error = _mean_and_error(gains[chosen])
    found = f"({gain:.3g} ± {error:.2g} squared error a trajectory)"
    if gains.mean(axis=1).max() <= 0.0:
        why = f"no half-life predicts the latest ones better {found}"
        return replace(model, half_life=None), (f"all trajectories count alike: {why}",)
    half_life = float(max(round(SHARES[chosen] * num_trajectories), 1))
    why = f"what a trajectory counts halves every {half_life:g}: that predicts the latest ones better {found}"
    return replace(model, half_life=half_life), (why,)


def _longest_good(gains: Float[np.ndarray, "H k"]) -> int:
    """The longest half-life that does not predict clearly worse than the best one: it leaves most to learn from."""
    best = gains[int(np.argmax(gains.mean(axis=1)))]
    lacks = [_mean_and_error(best - each) for each in gains]
    return next(number for number, (lack, error) in enumerate(lacks) if lack <= CLEARLY * error)


def _mean_and_error(values: Float[np.ndarray, " k"]) -> tuple[float, float]:
    return float(values.mean()), float(values.std(ddof=1) / np.sqrt(len(values)))


def _held_out_gains(plain: QModel, trajectories: TrajectoryArrays) -> Float[np.ndarray, "H k"]:
    """Squared error without a half-life, less that with each, of each of the latest trajectories."""
    num, log = trajectories.num_trajectories, plain.transitions(trajectories)
    regression = plain.regression(num, log.is_possible.shape[-1])
    ends = np.linspace(num * (1.0 - LATEST), num, NUM_BLOCKS + 1).astype(int).tolist()
    later, blocks = slice(ends[0], None), regression.block_of_action
    seen = (log.weight if log.imputation is None else log.weight * log.imputation.outcome_weight)[later]
    with one_thread():
        of_all = judged(fit_q(log.counted(_counts(num, ends[0])), regression), log, blocks, plain.stages, log.reward)
        to_be = log._replace(reward=targets(log, of_all.value))

        def errors(half_life: float | None) -> Float[np.ndarray, " k"]:
            fits = [fit_each_stage(to_be.counted(_counts(num, end, half_life)), regression) for end in ends[:-1]]
            each = [judged(fit, log, blocks, "separate", log.reward).taken for fit in fits]
            taken = np.concatenate([of[begin:end] for of, (begin, end) in zip(each, pairwise(ends), strict=True)])
            return np.where(seen > 0, seen * (taken - of_all.target[later]) ** 2, 0.0).sum(axis=1)

        none = errors(None)
        return np.stack([none - errors(share * num) for share in SHARES])


def _counts(num: int, num_before: int, half_life: float | None = None) -> Float[np.ndarray, " n"]:
    """What trajectories count where the first ones are learned from."""
    counts = np.zeros(num)
    counts[:num_before] = 1.0 if half_life is None else recency_weights(num_before, half_life)
    return counts
