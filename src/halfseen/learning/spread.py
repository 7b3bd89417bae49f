"""How well Q̂ is known, state by state: the standard error behind its lower confidence bound (*pessimism*).

A block's Q̂(x) = α + βᵀφ(x) rests on the completed stages of its actions. With C their centred Gram matrix, N their
weight, λ the ridge and σ² the variance of their targets about Q̂,

    s²(x) = σ² (1/N + zᵀ (C + nλ I)⁻¹ z),    z = (φ(x) − mean) / scale,

the variance of a ridge regression read as Bayes does (in an RKHS, of a Gaussian process), so that it grows where no
completed stage is near [AbbasiYadkori2011]_ [JinYangWang2021]_. Imputed targets of cut stages count as nothing seen.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from halfseen.learning.ridge import Factor


class WeightSums(NamedTuple):
    """Sums over the completed stages of each block; those of parts of a log add up."""

    mass: Float[np.ndarray, " K"]
    """Σw."""
    squares: Float[np.ndarray, " K"]
    """Σw²: heavy weights make of many stages few."""
    count: Float[np.ndarray, " K"]
    """Stages with a weight."""


class Spread(NamedTuple):
    """What of s no target changes, by block; of the completed stages alone."""

    factor: Factor
    """Without folds."""
    weights: WeightSums

    def unit_roots(self, penalty: Float[np.ndarray, " K"]) -> Float[np.ndarray, "K F F"]:
        """R of every block, s(x) = ‖Rᵀ (1, φ(x))‖, for targets of which one effective stage varies by 1 about Q̂.

        Parameters
        ----------
        penalty
            nλ of each block.
        """
        factor, gram, mass = self.factor, self.factor.gram[0], self._mass
        penalised = self._penalised(penalty)
        slopes = factor.eigenvectors[0] / factor.scale[..., None] / np.sqrt(penalised)[:, None, :]
        found = np.zeros_like(gram)
        found[:, 0, 0] = 1.0 / np.sqrt(mass)
        found[:, 0, 1:] = -np.einsum("kf,kfe->ke", gram[:, 0, 1:] / mass[:, None], slopes)
        found[:, 1:, 1:] = slopes
        return found

    def deviations(self, penalty: Float[np.ndarray, " K"], squares: Float[np.ndarray, " K"]) -> Float[np.ndarray, " K"]:
        """What R is times its `unit_roots`, for each block.

        As many stages as there are coefficients that λ leaves are used up by the fit.

        Parameters
        ----------
        penalty
            nλ of each block.
        squares
            Σ w (X − Q̂)² of the completed stages.
        """
        eigenvalues, (mass, of_squares, count) = self.factor.eigenvalues[0], self.weights
        fitted = 1.0 + np.sum(np.maximum(eigenvalues, 0.0) / self._penalised(penalty), axis=-1)
        left = count / np.maximum(count - fitted, 0.1 * count + 0.5)
        variance = left * squares / np.where(mass > 0, mass, 1.0)
        return np.sqrt(variance * of_squares / self._mass)

    def _penalised(self, penalty: Float[np.ndarray, " K"]) -> Float[np.ndarray, "K F1"]:
        eigenvalues = self.factor.eigenvalues[0]
        largest = eigenvalues.max(axis=-1, keepdims=True, initial=0.0)
        return np.maximum(eigenvalues + penalty[:, None], 1e-8 * largest + np.finfo(float).tiny)

    @property
    def _mass(self) -> Float[np.ndarray, " K"]:
        return np.maximum(self.factor.gram[0, :, 0, 0], np.finfo(float).tiny)
