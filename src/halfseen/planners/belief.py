"""What can be known of a table, and how it changes: the belief over attributes and grips.

Given what is seen, objects are independent of one another, and an object's label history is independent of its grip.
So the belief factors, and is held exactly: log-odds of DIRTY, and for each grip offset a posterior in one dimension by
Gauss–Hermite quadrature. Particles are drawn from it where a future is sampled.
"""

from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from halfseen.errors import ArgumentError
from halfseen.world.action_space import ActionSpace, Verb
from halfseen.world.config import WorldConfig
from halfseen.world.grasping import KnownGrasping
from halfseen.world.grasping_by_robot import GraspingByRobot
from halfseen.world.seeing import KnownSeeing, label_evidence
from halfseen.world.state import TableState

NUM_NODES = 7
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(NUM_NODES)


class Grip(NamedTuple):
    """What is believed of grip offsets, each its mean plus a hidden u."""

    mean: Float[Array, "*S"]
    """As `TableState.grip` has it."""
    log_weights: Float[Array, "*S G"]
    """Log posterior weights of u on `offset_nodes`, not normalised."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Belief:
    """Belief over one table (`jax.vmap` adds batch axes)."""

    hides: Float[Array, "*B N N"]
    is_on_table: Bool[Array, "*B N"]
    log_odds: Float[Array, "*B N"]
    seen: Float[Array, "*B N"]
    """As `TableState.seen` has it."""
    grip: Grip
    """Of each object; axes (B, N)."""
    steps_to_go: Int[Array, "*B"]


def known_grasping(config: WorldConfig) -> KnownGrasping:
    """How attempts go, with its probabilities.

    Raises
    ------
    ArgumentError
        The world's law can only be drawn from, or so can that of a robot.
    """
    law = config.grasping
    for each in law.laws if isinstance(law, GraspingByRobot) else (law,):
        if not isinstance(each, KnownGrasping):
            raise _unknown("grasping", each, "AssumedGrasping")
    assert isinstance(law, KnownGrasping), "it is where each of its laws is"
    return law


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
    """Values of u, what is hidden of a grip offset, at which posteriors are held."""
    return known_grasping(config).offset_std * jnp.asarray(_NODES, dtype=jnp.float32)


def trait_at(config: WorldConfig, node: Int[Array, " N"]) -> Any:
    """Hidden trait of the law of grasping with u of each object at one of `offset_nodes`, by number."""
    law = known_grasping(config)
    at = jnp.asarray(_NODES, dtype=jnp.float32)[node]
    if isinstance(law, GraspingByRobot):
        return tuple(replace(law, robot=k).offset_std * at for k in range(len(law.laws)))
    return law.offset_std * at


def offset_prior() -> tuple[Float[np.ndarray, " G"], Float[np.ndarray, " G"]]:
    """Values of u on `offset_nodes`, for a standard deviation of 1, and the prior probability of each."""
    return _NODES.copy(), _WEIGHTS / _WEIGHTS.sum()


def prior_grip(mean: Float[Array, "*S"]) -> Grip:
    """Grips before any attempt: u ~ N(0, std²)."""
    log_weights = jnp.log(jnp.asarray(_WEIGHTS / _WEIGHTS.sum(), dtype=jnp.float32))
    return Grip(mean, jnp.broadcast_to(log_weights, (*mean.shape, NUM_NODES)))


def failure_log_probability(
    config: WorldConfig, occluded: Float[Array, "*#S"], mean: Float[Array, "*#S"]
) -> Float[Array, "*S G"]:
    """Log P(an attempt fails | occ, u) at each of `offset_nodes`."""
    return known_grasping(config).log_failure(occluded[..., None], mean[..., None] + offset_nodes(config))


def attempt_evidence(
    config: WorldConfig, occluded: Float[Array, "*#S"], mean: Float[Array, "*#S"], succeeded: Array
) -> Float[Array, "*S G"]:
    """Log-likelihood of an attempt's result at each of `offset_nodes`."""
    failed = failure_log_probability(config, occluded, mean)
    return jnp.where(succeeded[..., None], jnp.log(-jnp.expm1(failed)), failed)


def grip_posterior(config: WorldConfig, state: TableState) -> Grip:
    """Grip of each object, given all its attempts, each as likely as the law of who made it has it; one table."""
    mean = state.grip[jnp.maximum(state.attempt_object, 0)]
    tried = state.attempt_occlusion, mean, state.attempt_succeeded
    if state.attempt_robot is None or not isinstance(config.grasping, GraspingByRobot):
        evidence = attempt_evidence(config, *tried)
    else:
        of_robot = jax.vmap(lambda robot, *each: attempt_evidence(config.as_robot(robot), *each))
        evidence = of_robot(state.attempt_robot, *tried)
    is_mine = jax.nn.one_hot(state.attempt_object, state.num_objects, dtype=evidence.dtype)
    prior = prior_grip(state.grip)
    return prior._replace(log_weights=prior.log_weights + is_mine.T @ evidence)


def belief_of(config: WorldConfig, state: TableState) -> Belief:
    """What the state of one table says."""
    grip = grip_posterior(config, state)
    return Belief(state.hides, state.is_on_table, state.log_odds, state.seen, grip, state.steps_to_go)


def grasp_probability(config: WorldConfig, occluded: Float[Array, "*S"], grip: Grip) -> Float[Array, "*S"]:
    """P(an attempt succeeds), the grip offset integrated out."""
    failed = jnp.exp(failure_log_probability(config, occluded, grip.mean))
    return 1.0 - jnp.sum(jax.nn.softmax(grip.log_weights, axis=-1) * failed, axis=-1)


def expected_attempt_s(config: WorldConfig, occluded: Float[Array, "*S"], grip: Grip) -> Float[Array, "*S"]:
    """Expected duration of an attempt with its transport [s], the grip offset integrated out."""
    offset = grip.mean[..., None] + offset_nodes(config)
    attempt_s = known_grasping(config).expected_s(occluded[..., None], offset)
    return config.transport_s + jnp.sum(jax.nn.softmax(grip.log_weights, axis=-1) * attempt_s, axis=-1)


def occlusion_without(belief: Belief, is_taken: Bool[Array, " N"]) -> Float[Array, " N"]:
    """Occlusion if the objects in `is_taken` hid nothing."""
    is_hiding = belief.is_on_table & ~is_taken
    return 1.0 - jnp.prod(jnp.where(is_hiding, 1.0 - belief.hides, 1.0), axis=1)


def dirty_after_label(
    config: WorldConfig,
    is_dirty: Float[Array, "*S"],
    seen: Float[Array, "*#S"],
    occluded: Float[Array, "*#S"],
    is_held: bool = False,
) -> tuple[Float[Array, "*S"], Float[Array, "*S"], Float[Array, "*S"]]:
    """P(the next label says dirty), and P(DIRTY) after either label."""
    if_dirty, if_clean = known_seeing(config).positive(occluded, seen, is_held)
    says_dirty = is_dirty * if_dirty + (1.0 - is_dirty) * if_clean
    # Where nothing is new, no label says dirty.
    mass = jnp.maximum(says_dirty, jnp.finfo(says_dirty.dtype).tiny)
    return says_dirty, is_dirty * if_dirty / mass, is_dirty * (1.0 - if_dirty) / (1.0 - says_dirty)


def sample_successor(config: WorldConfig, belief: Belief, action: Int[Array, ""], key: Array) -> Belief:
    """Draw what would be believed after an attempt to WASH or LIFT: one particle's future."""
    grasp_key, label_key = jax.random.split(key)
    num_objects = belief.is_on_table.shape[0]
    actions = ActionSpace(num_objects)
    verb, target = actions.verb(action), actions.target(action)
    is_target = jnp.arange(num_objects) == target
    occluded = occlusion_without(belief, jnp.zeros_like(is_target))[target]
    grip = Grip(*(leaf[target] for leaf in belief.grip))
    is_grasped = jax.random.uniform(grasp_key) < grasp_probability(config, occluded, grip)
    evidence = attempt_evidence(config, occluded, grip.mean, is_grasped)
    after = replace(
        belief,
        is_on_table=belief.is_on_table & ~(is_target & is_grasped & (verb == Verb.WASH)),
        grip=belief.grip._replace(log_weights=belief.grip.log_weights + jnp.where(is_target[:, None], evidence, 0.0)),
        steps_to_go=belief.steps_to_go - 1,
    )
    return _looked(config, after, is_target & is_grasped & (verb == Verb.LIFT), label_key)


def _looked(config: WorldConfig, belief: Belief, is_held: Bool[Array, " N"], key: Array) -> Belief:
    """Draw what a look tells, and believe it."""
    law, is_there = known_seeing(config), belief.is_on_table
    occluded = jnp.where(is_held, 0.0, occlusion_without(belief, is_held))
    if_dirty, if_clean = law.positive(occluded, belief.seen, is_held)
    is_dirty = jax.nn.sigmoid(belief.log_odds)
    chance = is_dirty * if_dirty + (1.0 - is_dirty) * if_clean
    says_dirty = jax.random.uniform(key, chance.shape) < chance
    update = label_evidence(if_dirty, if_clean, says_dirty)
    seen = law.after(occluded, belief.seen, says_dirty, is_held)
    return replace(
        belief,
        log_odds=belief.log_odds + jnp.where(is_there, update, 0.0),
        seen=jnp.where(is_there, seen, belief.seen),
    )
