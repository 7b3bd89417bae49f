"""What an attempt costs by the seconds that it takes."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from halfseen.planners.belief import Grip, expected_attempt_s, grip_posterior, prior_grip
from halfseen.team.state import TeamState
from halfseen.world.config import WorldConfig
from halfseen.world.number import Number
from halfseen.world.state import occlusion


def effort(config: WorldConfig, state: TeamState, reward_per_s: Number, grip: Grip | None = None) -> Float[Array, " N"]:
    """Price of the seconds of an attempt at each object of one table, 0 or above.

    While several robots go on, an attempt of one adds to the table's clock about its share of its seconds.

    Parameters
    ----------
    config
        The world that is believed in.
    state
        Of one table.
    reward_per_s
        Price of each second of the table's clock; 0 or below [1/s].
    grip
        What is believed of the grips; by default, all that the attempts so far tell.
    """
    known = grip_posterior(config, state.table) if grip is None else grip
    seconds = expected_attempt_s(config, occlusion(state.table), known)
    return -reward_per_s * seconds / num_going_on(state)


def grip_of(config: WorldConfig, state: TeamState, uses_history: bool) -> Grip:
    """Grips by all attempts so far, or as they were before any."""
    return grip_posterior(config, state.table) if uses_history else prior_grip(state.table.grip)


def num_going_on(state: TeamState) -> Float[Array, ""]:
    """Robots that do something yet, the one that decides included; at least 1."""
    return jnp.maximum(jnp.sum(~state.robots.is_done), 1).astype(jnp.float32)
