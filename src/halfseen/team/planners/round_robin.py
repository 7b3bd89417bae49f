"""Objects dealt out to the robots in turn, whatever they promise: the weakest coordination there is."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from halfseen.planners.heuristics import GreedyPolicy
from halfseen.team.actions import possible_actions, wait_of
from halfseen.team.planners.effort import effort, grip_of
from halfseen.team.state import TeamState
from halfseen.world.action_space import FINISH, ActionSpace, Verb
from halfseen.world.number import Number
from halfseen.world.policy import Decision, surely


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class RoundRobin:
    """Each robot follows a rule of thumb on the objects that were dealt to it, and leaves when none is worth it.

    Object i goes to one of the robots that reach it, the (i modulo their number)-th. A robot waits where another is in
    the way of what it wants.

    Parameters
    ----------
    rule
        The rule of thumb of one robot.
    reward_per_s
        Price of each second of the table's clock, as in `TeamConfig`; 0 or below [1/s].
    """

    rule: GreedyPolicy
    reward_per_s: Number = 0.0

    def decide(self, state: TeamState, key: Array) -> Decision:
        """Choose for one table; nothing is drawn."""
        actions, wait = ActionSpace(state.table.num_objects), wait_of(state.table.num_objects)
        is_possible = possible_actions(state)
        grip = grip_of(self.rule.config, state, self.rule.uses_history)
        worth = self.rule.worth(state.table) - effort(self.rule.config, state, self.reward_per_s, grip)
        worth = jnp.where(dealt(state), worth, -jnp.inf)
        now = jnp.where(is_possible[actions.of(Verb.WASH)], worth, -jnp.inf)
        best = jnp.argmax(now)
        otherwise = jnp.where(is_possible[wait] & jnp.any(worth > 0.0), wait, FINISH)
        action = jnp.where(now[best] > 0.0, actions.encode(Verb.WASH, best), otherwise)
        return surely(action.astype(jnp.int32))


def dealt(state: TeamState) -> Bool[Array, " N"]:
    """Which objects were dealt to the robot that decides."""
    reach = state.workspace.is_in_reach
    turn = jnp.arange(reach.shape[1]) % jnp.maximum(jnp.sum(reach, axis=0), 1)
    rank = jnp.cumsum(reach, axis=0)[state.decider] - 1
    return reach[state.decider] & (rank == turn)
