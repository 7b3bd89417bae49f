"""A rule of thumb for each robot, with reservation: nobody plans what another is at, and all prefer what is theirs."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from halfseen.planners.belief import dirty_after_label
from halfseen.planners.heuristics import GreedyPolicy, TrueGrasp, wash_worth
from halfseen.team.actions import possible_actions, wait_of
from halfseen.team.others import others_of, reached_by_decider
from halfseen.team.planners.effort import effort, grip_of
from halfseen.team.state import TeamState
from halfseen.world.action_space import FINISH, ActionSpace, Verb
from halfseen.world.number import Number
from halfseen.world.policy import Decision, surely
from halfseen.world.state import occlusion

OWN_BONUS = 1.0
"""What an object that no other robot reaches is preferred by [reward]."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ReservingTeam:
    """WASH what promises most of what nobody else is at; WAIT where a label may yet make something worth it.

    A rule that waits only for what promises something already parks too early: while others work, the camera looks, and
    what seemed clean may turn out to be dirty.

    Parameters
    ----------
    rule
        The rule of thumb of one robot.
    reward_per_s
        Price of each second of the table's clock, as in `TeamConfig`; 0 or below [1/s].
    own_bonus
        What an object that no other robot reaches is preferred by.
    """

    rule: GreedyPolicy
    reward_per_s: Number = 0.0
    own_bonus: Number = OWN_BONUS

    def worth(self, state: TeamState) -> Float[Array, " N"]:
        """Worth of an attempt to WASH each object of one table, its seconds paid; −∞ where none is possible."""
        is_free = possible_actions(state)[ActionSpace(state.table.num_objects).of(Verb.WASH)]
        return jnp.where(is_free, self.rule.worth(state.table) - self._effort(state), -jnp.inf)

    def decide(self, state: TeamState, key: Array) -> Decision:
        """Choose for one table; nothing is drawn."""
        worth, wait = self.worth(state), wait_of(state.table.num_objects)
        score = jnp.where(worth > 0.0, worth + self.own_bonus * ~others_of(state).reached, -jnp.inf)
        best = jnp.argmax(score)
        can_hope = possible_actions(state)[wait] & jnp.any(self._may_be_worth_it(state))
        wash = ActionSpace(state.table.num_objects).encode(Verb.WASH, best)
        action = jnp.where(score[best] > -jnp.inf, wash, jnp.where(can_hope, wait, FINISH))
        return surely(action.astype(jnp.int32))

    def _effort(self, state: TeamState) -> Float[Array, " N"]:
        grip = grip_of(self.rule.config, state, self.rule.uses_history)
        return effort(self.rule.config, state, self.reward_per_s, grip)

    def _may_be_worth_it(self, state: TeamState) -> Bool[Array, " N"]:
        """What in reach would be worth an attempt now, or if the next label said DIRTY."""
        config, table = self.rule.config, state.table
        grasp = TrueGrasp(config, self.rule.uses_history) if self.rule.grasp is None else self.rule.grasp
        is_dirty, hidden = jax.nn.sigmoid(table.log_odds), occlusion(table)
        _, if_said, _ = dirty_after_label(config, is_dirty, table.seen, hidden)
        at_best = jnp.maximum(is_dirty, if_said)
        worth = wash_worth(config, at_best, grasp.probability(table), self.rule.counts_penalty)
        return reached_by_decider(state) & (worth > self._effort(state))
