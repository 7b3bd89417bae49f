"""What all fits of laws share: a weak normal prior, hidden offsets of objects integrated out, and the search.

What is maximised is a log-likelihood plus the log-density of the prior, which weighs as much as a few observations do.
Offsets u ~ N(0, σ²) of objects are integrated out by Gauss–Hermite quadrature, as frailties are [Hougaard2000]_.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from halfseen.arrays import Rows


class Prior(NamedTuple):
    """Independent normal densities of the parameters θ."""

    mode: Float[np.ndarray, "*S"]
    spread: Float[np.ndarray, "*S"] | float
    """Standard deviations."""

    def loss(self, theta: Any, log_likelihood: float, slope: Any) -> tuple[float, Any]:
        """Negative log-posterior, but for a constant, and its gradient; `slope` is that of the log-likelihood."""
        shift = (theta - self.mode) / self.spread
        return float((shift**2).sum() / 2.0 - log_likelihood), shift / self.spread - slope


def least(loss: Callable[[Rows], tuple[float, Rows]], start: Rows, bounds: Any, **options: float) -> Rows:
    """Search for the minimum of a loss that gives its gradient, by L-BFGS-B within pairs of bounds."""
    from scipy.optimize import minimize

    return minimize(loss, start, jac=True, method="L-BFGS-B", bounds=bounds, options=options).x


class Quadrature(NamedTuple):
    """∫ f(u) φ(u) du as a sum over nodes, which come first in all tables."""

    nodes: Float[np.ndarray, "nodes 1"]
    log_weights: Float[np.ndarray, "nodes 1"]

    @classmethod
    def of(cls, num_nodes: int) -> "Quadrature":
        """Take so many nodes."""
        nodes, weights = np.polynomial.hermite_e.hermegauss(num_nodes)
        return cls(nodes[:, None], np.log(weights / weights.sum())[:, None])

    def integrated(self, log_values: Float[np.ndarray, "nodes n"]) -> tuple[Rows, Float[np.ndarray, "nodes n"]]:
        """Log of each integral, and the posterior weights of the nodes."""
        terms = log_values + self.log_weights
        largest = terms.max(axis=0)
        mass = np.exp(terms - largest)
        total = mass.sum(axis=0)
        return largest + np.log(total), mass / total
