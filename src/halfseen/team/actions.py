"""What one robot of a team may do: the actions of a table, and WAIT, which comes last.

WAIT is the verb after those of the table and has no object: with N objects and the verbs of one robot its number is
``1 + 2 N``, for which `ActionSpace.verb` and `ActionSpace.target` hold as they are.
"""

import jax.numpy as jnp
from jaxtyping import Array, Bool

from halfseen.team.state import TeamState
from halfseen.world.action_space import TARGETED, ActionSpace, Verb

WAIT = 1 + len(TARGETED)
"""Verb of doing nothing until the next event."""


def wait_of(num_objects: int) -> int:
    """Number of the action WAIT on a table with N objects."""
    return ActionSpace(num_objects).num_actions


def possible_actions(state: TeamState) -> Bool[Array, " A"]:
    """Which actions the robot that decides has, on one table.

    FINISH always; WASH and LIFT of what stands on the table in its reach, in nobody's hand and not near what another
    robot is at; WAIT where another robot is busy with something that ends by itself.
    """
    robots, num_objects = state.robots, state.table.num_objects
    is_other = jnp.arange(robots.num_robots) != state.decider
    is_at_work = robots.is_busy & is_other & (robots.verb != WAIT)
    is_at_object = is_at_work & (robots.verb > 0)
    is_taken = jnp.any(is_at_object[:, None] & state.workspace.is_near[robots.target], axis=0)
    is_free = state.table.is_on_table & state.workspace.is_in_reach[state.decider] & ~is_taken
    assert is_free.shape == (num_objects,)
    return jnp.concatenate([jnp.ones(1, dtype=bool), *[is_free] * len(TARGETED), jnp.any(is_at_work)[None]])


def worthwhile_actions(state: TeamState) -> Bool[Array, " A"]:
    """Which of the possible actions a policy that is learned chooses from: it waits for something, or not at all.

    WAIT only where something that the robot reaches, and that is rather dirty than clean, is in another robot's hands
    or way. Elsewhere the robot could as well do or leave now what it may do then; and as every decision more is one
    more maximum over errors of Q, waiting for nothing looked better than it is.
    """
    is_possible, table = possible_actions(state), state.table
    is_free = is_possible[ActionSpace(table.num_objects).of(Verb.WASH)]
    is_wanted = table.is_on_table & state.workspace.is_in_reach[state.decider] & (table.log_odds > 0.0)
    return is_possible.at[-1].set(is_possible[-1] & jnp.any(is_wanted & ~is_free))
