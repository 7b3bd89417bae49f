"""Q of one backward step by the sums of all parts alone (`row_sums`)."""

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from halfseen.learners.q_learning.least_squares import factorise, solve, waiting_for, with_prior
from halfseen.learners.q_learning.row_sums import Crosses, Grams, SeenCrosses, SeenGrams
from halfseen.learners.q_learning.spread import Spread, deviations, unit_roots
from halfseen.learners.q_learning.transitions import QFunctions


class StepFit(NamedTuple):
    """Q of one step."""

    q: QFunctions
    coefficients: Float[Array, "K F"]
    """Those of control variates, which Q leaves out, come last."""
    unit_root: Float[Array, "K F F"] | None = None
    deviation: Float[Array, " K"] | None = None
    """With pessimism, the factors of `q.root`; the first is the same from step to step where λ is."""


@partial(jax.jit, static_argnames=("num_paths", "is_scaled", "num_features"))
def solved(
    grams: Grams,
    crosses: Crosses,
    centre: Float[Array, "K F"],
    regs: Float[Array, " L"],
    num_paths: int,
    is_scaled: bool,
    num_features: int,
) -> StepFit:
    """Fit Q to the sums of all parts.

    Parameters
    ----------
    grams, crosses
        Of all parts.
    centre
        That of the step.
    regs
        The λ to choose from.
    num_paths
        n, of all parts together.
    is_scaled
        Whether λ weighs features as if each had unit variance.
    num_features
        Of Q, the offset among them; what comes after it are control variates.
    """
    sums: Any = jax.tree.map(jnp.asarray, (grams, crosses))
    fixed, moved = sums
    factor, cross, outcome = factorise(fixed.main, is_scaled), moved.main, None
    last = factor.eigenvalues
    if fixed.outcome is not None and moved.outcome is not None:
        num_terms = fixed.outcome.of_time.shape[-1]
        of_outcome = factorise(waiting_for(last, with_prior(fixed.outcome.gram, num_terms)), is_scaled)
        outcome, last = solve(of_outcome, moved.outcome, regs, num_paths).coefficients, of_outcome.eigenvalues
        cross = cross + jnp.einsum("vkfm,km->vkf", fixed.outcome.of_state, outcome[:, :-num_terms])
        cross = cross + jnp.einsum("vkfg,kg->vkf", fixed.outcome.of_time, outcome[:, -num_terms:])
    fit = solve(factor, cross, regs, num_paths)
    coefficients = fit.coefficients + centre
    found = QFunctions(coefficients[:, :num_features], fit.reg, outcome)
    if fixed.seen is None or moved.seen is None:
        return StepFit(found, coefficients)
    gram = waiting_for(last, fixed.seen.gram[None, :, :num_features, :num_features])
    squares = _squared_residuals(fixed.seen, moved.seen, coefficients)
    spread = Spread(factorise(gram, is_scaled), fixed.seen.weights)
    unit_root = unit_roots(spread, fit.reg, num_paths)
    deviation = deviations(spread, fit.reg, num_paths, squares)
    return StepFit(found._replace(root=unit_root * deviation[:, None, None]), coefficients, unit_root, deviation)


def _squared_residuals(grams: SeenGrams, crosses: SeenCrosses, coefficients: Float[Array, "K F"]) -> Float[Array, " K"]:
    """Σ w (X − βᵀx)² of the completed stages."""
    explained = 2.0 * jnp.sum(coefficients * crosses.cross, axis=-1)
    quadratic = jnp.einsum("kf,kfg,kg->k", coefficients, grams.gram, coefficients)
    return jnp.maximum(crosses.square - explained + quadratic, 0.0)
