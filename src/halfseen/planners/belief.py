"""What can be known of a grip: the posterior of each object's offset, given its past attempts.

Labels and grips are independent given what is seen, and so are objects, so the belief factors: log-odds of DIRTY stand
in the state, and each grip offset has a posterior in one dimension, held here by quadrature.
"""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from halfseen.world.config import WorldConfig
from halfseen.world.dynamics import grasp_probability, grasp_scale_s
from halfseen.world.state import TableState

_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(15)


def offset_grid(config: WorldConfig) -> tuple[Float[Array, " G"], Float[Array, " G"]]:
    """Nodes and log weights that integrate over the prior N(0, std²) of a grip offset (Gauss–Hermite)."""
    nodes = config.grip_offset_std * jnp.asarray(_NODES, dtype=jnp.float32)
    return nodes, jnp.log(jnp.asarray(_WEIGHTS / _WEIGHTS.sum(), dtype=jnp.float32))


def attempt_log_likelihood(
    config: WorldConfig, occluded: Float[Array, "*S"], succeeded: Array, nodes: Float[Array, " G"]
) -> Float[Array, "*S G"]:
    """Log-probability of each attempt's result at each grip offset."""
    log_failure = -config.attempt_limit_s / grasp_scale_s(config, occluded[..., None], nodes)
    return jnp.where(succeeded[..., None], jnp.log(-jnp.expm1(log_failure)), log_failure)


def grip_posterior(config: WorldConfig, state: TableState) -> Float[Array, "N G"]:
    """Log posterior weights (not normalised) of each object's grip offset on `offset_grid`; one table."""
    nodes, log_prior = offset_grid(config)
    attempts = attempt_log_likelihood(config, state.attempt_occlusion, state.attempt_succeeded, nodes)
    is_mine = jax.nn.one_hot(state.attempt_object, state.num_objects, dtype=attempts.dtype)
    return log_prior + is_mine.T @ attempts


def grasp_chance(
    config: WorldConfig, occluded: Float[Array, " N"], log_weights: Float[Array, "*N G"]
) -> Float[Array, " N"]:
    """P(an attempt succeeds now) of each object, the offset integrated out."""
    nodes, _ = offset_grid(config)
    return jnp.sum(jax.nn.softmax(log_weights, axis=-1) * grasp_probability(config, occluded[:, None], nodes), axis=-1)
