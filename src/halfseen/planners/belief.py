"""What can be known of a table, and how it changes: the belief over attributes and grips.

Given what is seen, objects are independent of one another, and an object's label history is independent of its grip.
So the belief factors, and is held exactly: log-odds of DIRTY, and for each grip offset a posterior in one dimension by
Gauss–Hermite quadrature. Particles are drawn from it where a future is sampled.
"""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from halfseen.errors import ArgumentError
from halfseen.world.action_space import ActionSpace, Verb
from halfseen.world.config import WorldConfig
from halfseen.world.grasping import KnownGrasping
from halfseen.world.seeing import KnownSeeing
from halfseen.world.state import TableState

NUM_NODES = 7
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(NUM_NODES)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Belief:
    """Belief over one table (`jax.vmap` adds batch axes)."""

    hides: Float[Array, "*B N N"]
    is_on_table: Bool[Array, "*B N"]
    log_odds: Float[Array, "*B N"]
    grip: Float[Array, "*B N G"]
    """Log posterior weights of each grip offset on `offset_nodes`, not normalised."""
    steps_to_go: Int[Array, "*B"]


def known_grasping(config: WorldConfig) -> KnownGrasping:
    """How attempts go, with its probabilities.

    Raises
    ------
    ArgumentError
        The world's law can only be drawn from.
    """
    if not isinstance(config.grasping, KnownGrasping):
        raise _unknown("grasping", config.grasping, "AssumedGrasping")
    return config.grasping


def known_seeing(config: WorldConfig) -> KnownSeeing:
    """What looks tell, with its probabilities.

    Raises
    ------
    ArgumentError
        The world's law can only be drawn from.
    """
    if not isinstance(config.seeing, KnownSeeing):
        raise _unknown("seeing", config.seeing, "AssumedSeeing")
    return config.seeing


def _unknown(name: str, law: object, known: str) -> ArgumentError:
    return ArgumentError(
        f"{name} of the config is {type(law).__name__}, a law that can be drawn from but whose probabilities are not "
        f"known, and planners need them; plan with a config whose {name} models it, such as {known}"
    )


def offset_nodes(config: WorldConfig) -> Float[Array, " G"]:
    """Grip offsets at which posteriors are held."""
    return known_grasping(config).offset_std * jnp.asarray(_NODES, dtype=jnp.float32)


def prior_grip() -> Float[Array, " G"]:
    """Log weights of the prior N(0, std²) on `offset_nodes`."""
    return jnp.log(jnp.asarray(_WEIGHTS / _WEIGHTS.sum(), dtype=jnp.float32))


def failure_log_probability(config: WorldConfig, occluded: Float[Array, "*S"]) -> Float[Array, "*S G"]:
    """Log P(an attempt fails | occ, u) at each grip offset."""
    return known_grasping(config).log_failure(occluded[..., None], offset_nodes(config))


def attempt_evidence(config: WorldConfig, occluded: Float[Array, "*S"], succeeded: Array) -> Float[Array, "*S G"]:
    """Log-likelihood of an attempt's result at each grip offset."""
    failed = failure_log_probability(config, occluded)
    return jnp.where(succeeded[..., None], jnp.log(-jnp.expm1(failed)), failed)


def grip_posterior(config: WorldConfig, state: TableState) -> Float[Array, "N G"]:
    """Log posterior weights of each object's grip offset, given all its attempts; one table."""
    evidence = attempt_evidence(config, state.attempt_occlusion, state.attempt_succeeded)
    is_mine = jax.nn.one_hot(state.attempt_object, state.num_objects, dtype=evidence.dtype)
    return prior_grip() + is_mine.T @ evidence


def belief_of(config: WorldConfig, state: TableState) -> Belief:
    """What the state of one table says."""
    grip = grip_posterior(config, state)
    return Belief(state.hides, state.is_on_table, state.log_odds, grip, state.steps_to_go)


def grasp_probability(
    config: WorldConfig, occluded: Float[Array, "*S"], grip: Float[Array, "*#S G"]
) -> Float[Array, "*S"]:
    """P(an attempt succeeds), the grip offset integrated out."""
    return 1.0 - jnp.sum(jax.nn.softmax(grip, axis=-1) * jnp.exp(failure_log_probability(config, occluded)), axis=-1)


def expected_attempt_s(
    config: WorldConfig, occluded: Float[Array, "*S"], grip: Float[Array, "*S G"]
) -> Float[Array, "*S"]:
    """Expected duration of an attempt with its transport [s], the grip offset integrated out."""
    attempt_s = known_grasping(config).expected_s(occluded[..., None], offset_nodes(config))
    return config.transport_s + jnp.sum(jax.nn.softmax(grip, axis=-1) * attempt_s, axis=-1)


def occlusion_without(belief: Belief, is_taken: Bool[Array, " N"]) -> Float[Array, " N"]:
    """Occlusion if the objects in `is_taken` hid nothing."""
    is_hiding = belief.is_on_table & ~is_taken
    return 1.0 - jnp.prod(jnp.where(is_hiding, 1.0 - belief.hides, 1.0), axis=1)


def dirty_after_label(
    config: WorldConfig, is_dirty: Float[Array, "*S"], occluded: Float[Array, "*S"]
) -> tuple[Float[Array, "*S"], Float[Array, "*S"], Float[Array, "*S"]]:
    """P(the next label says dirty), and P(DIRTY) after either label."""
    right = known_seeing(config).accuracy(occluded)
    says_dirty = is_dirty * right + (1.0 - is_dirty) * (1.0 - right)
    return says_dirty, is_dirty * right / says_dirty, is_dirty * (1.0 - right) / (1.0 - says_dirty)


def sample_successor(config: WorldConfig, belief: Belief, action: Int[Array, ""], key: Array) -> Belief:
    """Draw what would be believed after an attempt to WASH or LIFT: one particle's future."""
    grasp_key, label_key = jax.random.split(key)
    num_objects = belief.is_on_table.shape[0]
    actions = ActionSpace(num_objects)
    verb, target = actions.verb(action), actions.target(action)
    is_target = jnp.arange(num_objects) == target
    occluded = occlusion_without(belief, jnp.zeros_like(is_target))[target]
    is_grasped = jax.random.uniform(grasp_key) < grasp_probability(config, occluded, belief.grip[target])
    evidence = attempt_evidence(config, occluded, is_grasped)
    after = replace(
        belief,
        is_on_table=belief.is_on_table & ~(is_target & is_grasped & (verb == Verb.WASH)),
        grip=belief.grip + jnp.where(is_target[:, None], evidence, 0.0),
        steps_to_go=belief.steps_to_go - 1,
    )
    is_held = is_target & is_grasped & (verb == Verb.LIFT)
    seen_at = jnp.where(is_held, 0.0, occlusion_without(after, is_held))
    right = known_seeing(config).accuracy(seen_at)
    says_dirty, _, _ = dirty_after_label(config, jax.nn.sigmoid(belief.log_odds), seen_at)
    sign = jnp.where(jax.random.uniform(label_key, right.shape) < says_dirty, 1.0, -1.0)
    update = sign * (jnp.log(right) - jnp.log1p(-right))
    return replace(after, log_odds=belief.log_odds + jnp.where(after.is_on_table, update, 0.0))
