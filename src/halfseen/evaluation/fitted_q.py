"""Fitted Q evaluation under censoring [Le2019]_: eq. 3 with the policy's own action in place of the best one.

One compiled function fits Q to many weightings of the same log: to all paths, and to all but each fold in turn. So no
path is judged by a Q that it shaped (*cross-fitting*), and how much the value changes from fold to fold tells its
standard error (the delete-a-group jackknife [Kott2001]_). Ĝ, and the distribution of durations behind imputed targets,
are those of the whole log: they have few parameters.
"""

import numpy as np
from jaxtyping import Float, Int

from halfseen.learners.q_learning.fitting import fit_and_judge
from halfseen.learners.q_learning.judging import Judged
from halfseen.learners.q_learning.q_model import QModel
from halfseen.learners.q_learning.transitions import Transitions


def judged_by_folds(
    model: QModel, log: Transitions, reward: Float[np.ndarray, "n T"], fold: Int[np.ndarray, " n"]
) -> Judged:
    """What the Qs say that were fitted without each fold, and last that of all paths.

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
    """
    without = fold != np.arange(fold.max() + 2)[:, None]
    blocks = model.task.block_of_action(log.is_possible.shape[-1])
    return fit_and_judge(log, reward, without.astype(np.float64), blocks, model.regs, model.options(len(fold)))


def jackknifed(value: Float[np.ndarray, "B n"], fold: Int[np.ndarray, " n"]) -> tuple[float, float]:
    """Value of the policy by Q̂ alone, and its standard error.

    Parameters
    ----------
    value
        V̂_1(S_1) of every path: by the Qs that were fitted without each fold, and last by that of all paths.
    fold
        Of each path.
    """
    num_folds = len(value) - 1
    without = np.array([value[k, fold != k].mean() for k in range(num_folds)])
    error = np.sqrt((num_folds - 1.0) / num_folds * np.sum((without - without.mean()) ** 2))
    return float(value[-1].mean()), float(error)
