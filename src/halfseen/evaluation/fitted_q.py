"""Fitted Q evaluation under censoring [Le2019]_: eq. 3 with the policy's own action in place of the best one.

Q is fitted to all trajectories, and to all but each fold in turn. So no trajectory is judged by a Q that it shaped
(*cross-fitting*), and how much the value changes from fold to fold tells its standard error (the delete-a-group
jackknife [Kott2001]_).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from halfseen.evaluation.cross_fitting import Nuisances
from halfseen.evaluation.estimate import jackknife_error
from halfseen.learning.judging import Judged, judged
from halfseen.learning.q_model import QModel
from halfseen.learning.recursion import fit_q
from halfseen.learning.rows import Transitions
from halfseen.shapes import Float, Int
from halfseen.workers import Pool
from halfseen.workers.threads import one_thread


def judged_by_folds(
    model: QModel,
    log: Transitions,
    reward: Float[np.ndarray, "n T"],
    fold: Int[np.ndarray, " n"],
    nuisances: Sequence[Nuisances],
    pool: Pool,
) -> Judged:
    """What the Qs say that were fitted without each fold; and last that of all, if there are nuisances for it.

    Parameters
    ----------
    model
        How Q is fitted.
    log
        The log, with the policy.
    reward
        As logged.
    fold
        Of each trajectory.
    nuisances
        Fitted without each fold, and perhaps to all trajectories.
    pool
        Who fits.
    """
    each = pool.in_order(_Judging(model, log, reward, fold), enumerate(nuisances))
    return Judged(*(np.stack(leaves) for leaves in zip(*each, strict=True)))


@dataclass(frozen=True, eq=False)
class _Judging:
    """Fits Q without a fold, and lets it judge every trajectory."""

    model: QModel
    log: Transitions
    reward: Float[np.ndarray, "n T"]
    fold: Int[np.ndarray, " n"]

    def __call__(self, numbered: tuple[int, Nuisances]) -> Judged:
        k, given = numbered
        log = self.log._replace(weight=given.weight, imputation=given.imputation)
        regression = replace(self.model, pessimism=0.0).regression(*log.is_possible.shape[::2])
        with one_thread():
            q = fit_q(log.counted((self.fold != k).astype(np.float64)), regression)
            return judged(q, log, regression.block_of_action, regression.stages, self.reward)


def jackknifed(value: Float[np.ndarray, "B n"], fold: Int[np.ndarray, " n"]) -> tuple[float, float]:
    """Value of the policy by Q̂ alone, and its standard error.

    Parameters
    ----------
    value
        V̂_1(S_1) of every trajectory: by the Qs that were fitted without each fold, and last by that of all
        trajectories.
    fold
        Of each trajectory.
    """
    without = np.array([each[fold != k].mean() for k, each in enumerate(value[:-1])])
    return float(value[-1].mean()), jackknife_error(without)
