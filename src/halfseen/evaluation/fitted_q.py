"""Fitted Q evaluation under censoring [Le2019]_: eq. 3 with the policy's own action in place of the best one.

One compiled function fits Q to many weightings of the same log: to all paths, and to all but each fold in turn. So no
path is judged by a Q that it shaped (*cross-fitting*), and how much the value changes from fold to fold tells its
standard error (the delete-a-group jackknife [Kott2001]_).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from halfseen.evaluation.cross_fitting import Nuisances
from halfseen.evaluation.estimate import jackknife_error
from halfseen.learners.q_learning.fitting import fit_and_judge
from halfseen.learners.q_learning.judging import Judged
from halfseen.learners.q_learning.q_model import QModel
from halfseen.learners.q_learning.transitions import Transitions
from halfseen.workers import Pool


def judged_by_folds(
    model: QModel,
    log: Transitions,
    reward: Float[np.ndarray, "n T"],
    fold: Int[np.ndarray, " n"],
    nuisances: Sequence[Nuisances],
    pool: Pool,
) -> Judged:
    """What the Qs say that were fitted without each fold; and last that of all paths, if there are nuisances for it.

    Parameters
    ----------
    model
        How Q is fitted.
    log
        The log, with the policy.
    reward
        As logged.
    fold
        Of each path.
    nuisances
        Fitted without each fold, and perhaps to all paths.
    pool
        Who fits.
    """
    each = pool.in_order(_Judging(model, log, reward, fold), enumerate(nuisances))
    return Judged(*(np.concatenate(leaves) for leaves in zip(*each, strict=True)))


@dataclass(frozen=True, eq=False)
class _Judging:
    """Fits Q without a fold, and lets it judge every path."""

    model: QModel
    log: Transitions
    reward: Float[np.ndarray, "n T"]
    fold: Int[np.ndarray, " n"]

    def __call__(self, numbered: tuple[int, Nuisances]) -> Judged:
        k, given = numbered
        without = (self.fold != k).astype(np.float64)[None]
        weighted = self.log._replace(weight=given.weight, imputation=given.imputation)
        blocks = self.model.blocks(self.log.is_possible.shape[-1])
        options = self.model.options(len(self.fold))
        return fit_and_judge(weighted, self.reward, without, blocks, self.model.regs, options)


def jackknifed(value: Float[np.ndarray, "B n"], fold: Int[np.ndarray, " n"]) -> tuple[float, float]:
    """Value of the policy by Q̂ alone, and its standard error.

    Parameters
    ----------
    value
        V̂_1(S_1) of every path: by the Qs that were fitted without each fold, and last by that of all paths.
    fold
        Of each path.
    """
    without = np.array([each[fold != k].mean() for k, each in enumerate(value[:-1])])
    return float(value[-1].mean()), jackknife_error(without)
