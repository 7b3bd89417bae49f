"""Q of one backward step by the sums of all parts (`sums`)."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from halfseen.learning.ridge import Factor, factorise, solve, with_prior
from halfseen.learning.spread import Spread
from halfseen.learning.sums import Bound, Crosses, Grams, SeenCrosses, SeenGrams
from halfseen.learning.transitions import QFunctions


class StepFit(NamedTuple):
    """Q of one step."""

    q: QFunctions
    coefficients: Float[np.ndarray, "K F"]
    """Those of control variates, which Q leaves out, come last."""
    bound: Bound | None = None
    """With pessimism, how far Q is lowered by one standard error."""


class Equations(NamedTuple):
    """The normal equations of a step, factorised once for all targets."""

    grams: Grams
    main: Factor
    outcome: Factor | None
    seen: Spread | None
    num_features: int
    """Of Q, the offset among them; what comes after it are control variates."""

    @classmethod
    def of(cls, grams: Grams, is_scaled: bool, num_features: int) -> "Equations":
        """Factorise the sums of all parts."""
        outcome, seen = None, None
        if grams.outcome is not None:
            gram = with_prior(grams.outcome.gram, grams.outcome.of_time.shape[-1])
            outcome = factorise(gram, is_scaled)
        if grams.seen is not None:
            gram = grams.seen.gram[None, :, :num_features, :num_features]
            seen = Spread(factorise(gram, is_scaled), grams.seen.weights)
        return cls(grams, factorise(grams.main, is_scaled), outcome, seen, num_features)


def fit_step(
    equations: Equations,
    crosses: Crosses,
    centre: Float[np.ndarray, "K F"] | None,
    regs: Float[np.ndarray, " L"],
    num_paths: int,
) -> StepFit:
    """Fit Q of one step.

    Parameters
    ----------
    equations
        Of all parts.
    crosses
        Of all parts.
    centre
        What coefficients are shrunk towards; None for 0.
    regs
        The λ to choose from.
    num_paths
        n, of all parts together.
    """
    cross, outcome, grams = crosses.main, None, equations.grams
    if grams.outcome is not None and equations.outcome is not None and crosses.outcome is not None:
        num_terms = grams.outcome.of_time.shape[-1]
        outcome = solve(equations.outcome, crosses.outcome, regs, num_paths).coefficients
        cross = cross + np.einsum("vkfm,km->vkf", grams.outcome.of_state, outcome[:, :-num_terms])
        cross = cross + np.einsum("vkfg,kg->vkf", grams.outcome.of_time, outcome[:, -num_terms:])
    fit = solve(equations.main, cross, regs, num_paths)
    coefficients = fit.coefficients if centre is None else fit.coefficients + centre
    found = QFunctions(coefficients[:, : equations.num_features], fit.reg, outcome)
    if equations.seen is None or grams.seen is None or crosses.seen is None:
        return StepFit(found, coefficients)
    penalty = fit.reg * num_paths
    unit_root = equations.seen.unit_roots(penalty)
    deviation = equations.seen.deviations(penalty, _squared_residuals(grams.seen, crosses.seen, coefficients))
    root = unit_root * deviation[:, None, None]
    return StepFit(found._replace(root=root), coefficients, Bound(unit_root, deviation))


def _squared_residuals(
    grams: SeenGrams, crosses: SeenCrosses, coefficients: Float[np.ndarray, "K F"]
) -> Float[np.ndarray, " K"]:
    """Σ w (X − βᵀx)² of the completed stages."""
    explained = 2.0 * np.sum(coefficients * crosses.cross, axis=-1)
    quadratic = np.einsum("kf,kfg,kg->k", coefficients, grams.gram, coefficients)
    return np.maximum(crosses.square - explained + quadratic, 0.0)
