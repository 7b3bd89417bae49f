"""Effects that change linearly from stage to stage, in a Q that is pooled over the stages.

A pooled Q is biased if the effect of an action depends on the stage t, and a separate Q is fitted to few rows. Between
them is, for each number h of steps to go,

    Q_h(S, a, t) = Q_h(S, a) + t̃ · (τ_a + ξ_aᵀ z(S)),    t̃ = (t − (T + 1)/2) / √((T² − 1)/12),

with z the features of Q that are linear in the covariates. So t̃ acts as one more covariate of mean 0 and variance 1,
with its main effect and its products, shrunk as those of the others are. In stage t there are T + 1 − t steps to go: of
each Q_h one t is needed, and there it is a function of S alone (`at_stages`).
"""

from typing import NamedTuple

import numpy as np

from halfseen.learning.q_space import KernelMap
from halfseen.learning.recursion import QFunctions
from halfseen.learning.rows import Imputation
from halfseen.shapes import Float


class StageTrend(NamedTuple):
    """Features of a trend: t̃ · (main, product · φ_1, …, product · φ_p)."""

    num_linear: int
    """p: the first features φ that are linear in the covariates."""
    main: float
    product: float

    def of(self, features: Float[np.ndarray, "n T E F"]) -> Float[np.ndarray, "n T E F1"]:
        """Features of the trend, given those of Q."""
        linear = self.product * features[..., : self.num_linear]
        main = np.full((*features.shape[:-1], 1), self.main)
        return centred_stages(features.shape[1])[:, None, None] * np.concatenate([main, linear], axis=-1)

    def used_by(self, imputed: Imputation) -> Imputation:
        """The imputation, with an outcome regression on these features, too, as far as it uses theirs."""
        is_used = imputed.is_used
        return imputed._replace(is_used=np.concatenate([is_used, [1.0], is_used[: self.num_linear]]))

    def at_stages(self, q: QFunctions) -> QFunctions:
        """Q of each number of steps to go, as a function of the features without those of the trend."""
        stage = centred_stages(q.coefficients.shape[-3])[::-1]
        coefficients = self._at(stage[:, None], q.coefficients)
        if q.root is None:
            return q._replace(coefficients=coefficients)
        transposed = self._at(stage[:, None, None], np.swapaxes(q.root, -1, -2))
        # ‖Rᵀ x‖ is that of its triangular factor.
        return q._replace(coefficients=coefficients, root=np.swapaxes(np.linalg.qr(transposed, mode="r"), -1, -2))

    def _at(self, stage: Float[np.ndarray, "*S"], rows: Float[np.ndarray, "*B F"]) -> Float[np.ndarray, "*B F1"]:
        """Rows of coefficients, the intercept first and those of the trend last, with the latter added to the rest."""
        own, main, products = np.split(rows, [-1 - self.num_linear, rows.shape[-1] - self.num_linear], axis=-1)
        own = own.copy()
        own[..., 0] += stage * self.main * main[..., 0]
        own[..., 1 : 1 + self.num_linear] += stage[..., None] * self.product * products
        return own


def stage_trend_of(kernel_map: KernelMap | None, num_inputs: int) -> StageTrend:
    """Trend of a Q with this map of its inputs; of a purely Gaussian kernel, only the main effect has one."""
    if kernel_map is None:
        return StageTrend(num_inputs, 1.0, 1.0)
    if kernel_map.trend is None or not len(kernel_map.trend) or not kernel_map.trend[0] > 0:
        return StageTrend(0, 1.0, 1.0)
    linear, product = float(kernel_map.trend[0]), float(kernel_map.trend[-1])
    return StageTrend(len(kernel_map.centre), linear, product / linear)


def centred_stages(horizon: int) -> Float[np.ndarray, " T"]:
    """t̃ of the stages 1 … T; 0 if there is only one."""
    stage = np.arange(horizon) - (horizon - 1) / 2.0
    return stage / np.sqrt(max(horizon**2 - 1, 1) / 12.0)
