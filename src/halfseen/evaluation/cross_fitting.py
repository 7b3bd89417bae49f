"""What is fitted without one fold of the trajectories: Ĝ, durations and Q; and how much the whole answer changes by it.

*Cross-fitting*: no trajectory is judged by what it shaped [Chernozhukov2018]_.

*Delete-a-group jackknife* [Kott2001]_: all is fitted without each fold, and the value worked out on the other
trajectories. The scatter of these values tells the standard error of the whole procedure. That of the influence values,
which takes Ĝ, m and Q for given, is too small wherever the answer rests on them: stages that are hardly ever seen to
end are imputed, and the error of the regression that does so is common to all trajectories.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from halfseen.censoring import CensoringSpec
from halfseen.errors import HalfseenError
from halfseen.learning.q_model import QModel
from halfseen.learning.rows import Imputation, TrajectoryArrays
from halfseen.shapes import Bool, Float, Int


class Nuisances(NamedTuple):
    """What stands for cuts, fitted to some of the trajectories, for all of them."""

    uncut: Float[np.ndarray, "n T"]
    """δ_t / Ĝ(U_t⁻)."""
    weight: Float[np.ndarray, "n T"]
    """Of each stage in eq. 3."""
    imputation: Imputation | None


def nuisances_of(
    model: QModel, trajectories: TrajectoryArrays, is_fitted: Bool[np.ndarray, " n"] | None = None
) -> Nuisances:
    """Work out what stands for cuts by a model that is fitted; durations are fitted to some trajectories, or to all."""
    cuts = model.cut_model
    uncut = trajectories.is_completed.astype(float) if cuts is None else cuts.weights(trajectories.clocks)
    return Nuisances(uncut, *model.weights_and_imputation(trajectories, is_fitted))


def nuisances_by_folds(
    model: QModel, trajectories: TrajectoryArrays, whole: Nuisances, fold: Int[np.ndarray, " n"]
) -> Iterator[Nuisances]:
    """Fit what stands for cuts without each fold in turn.

    No weight is larger than the largest of the whole log: where a fold held the last that was watched, Ĝ of the others
    may end before it. Where too little is left to fit anything, that of the whole log serves.
    """
    if not isinstance(model.targets, CensoringSpec) or trajectories.clocks.is_finished.all():
        yield from [whole] * (int(fold.max()) + 1)
        return
    largest = max(float(whole.uncut.max()), 1.0)
    for k in range(int(fold.max()) + 1):
        kept = fold != k
        try:
            cuts = model.targets.fit_cuts(trajectories.clocks.take(np.flatnonzero(kept)))
            bounded = replace(cuts, truncate_at=cuts.truncate_at or largest)
            yield nuisances_of(replace(model, cut_model=bounded), trajectories, kept)
        except HalfseenError:
            yield whole
