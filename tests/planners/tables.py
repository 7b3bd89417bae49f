"""Tables in the middle of a path, made by hand."""

import jax.numpy as jnp
import numpy as np
from naive_planner import CONFIG

from halfseen.world.state import NO_ATTEMPT, TableState


def state_of(cups, hides, steps_to_go=10, num_padding=0):
    """Make the state that says of each cup what is believed; its padding is NaN, as far as that goes."""
    num_objects, size, horizon = len(cups), len(cups) + num_padding, CONFIG.horizon
    padded_hides = np.full((size, size), np.nan if num_padding else 0.0, dtype=np.float32)
    padded_hides[:num_objects, :num_objects] = hides
    padding = [np.nan] * num_padding
    tried = [(i, *attempt) for i, cup in enumerate(cups) for attempt in cup.attempts]
    rest = horizon - len(tried)
    return TableState(
        hides=jnp.asarray(padded_hides),
        is_object=jnp.arange(size) < num_objects,
        is_on_table=jnp.asarray([cup.is_on_table for cup in cups] + [False] * num_padding),
        grip=jnp.asarray([cup.grip for cup in cups] + padding, dtype=jnp.float32),
        log_odds=jnp.asarray([cup.log_odds for cup in cups] + padding, dtype=jnp.float32),
        seen=jnp.asarray([cup.seen for cup in cups] + padding, dtype=jnp.float32),
        lifts=jnp.zeros(size, dtype=jnp.int32),
        attempt_object=jnp.asarray([i for i, _, _ in tried] + [NO_ATTEMPT] * rest, dtype=jnp.int32),
        attempt_occlusion=jnp.asarray([occluded for _, occluded, _ in tried] + [0.0] * rest, dtype=jnp.float32),
        attempt_succeeded=jnp.asarray([is_grasped for _, _, is_grasped in tried] + [False] * rest, dtype=bool),
        steps_to_go=jnp.asarray(steps_to_go, dtype=jnp.int32),
    )
