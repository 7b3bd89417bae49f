"""Multi-agent rollout [Bertsekas2021]_: futures in which all robots follow a rule, improved one robot at a time.

The robot that decides tries each of its actions in futures in which it and all others follow the base rule afterwards.
Where several robots are free at once they decide in order, each knowing what those before it chose, as the state tells
it. So a decision costs as many futures as one robot has actions, not as many as all robots have together.

A future is played by the dynamics of the world from what nobody knows (`unknown`), drawn from what is seen; every
action meets the same draws. An action replaces the rule's own only where it is better by more than its noise:
an improvement that is not there is what errors look like.
"""

from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from halfseen.errors import ArgumentError
from halfseen.planners.futures import as_expected, future
from halfseen.team.actions import possible_actions
from halfseen.team.config import TeamConfig
from halfseen.team.dynamics import TEAM
from halfseen.team.planners.unknown import sampled_hidden
from halfseen.team.policy import TeamPolicy
from halfseen.team.state import TeamState
from halfseen.world.number import Number
from halfseen.world.policy import Decision

NUM_ROLLOUTS = 32
NUM_KEPT = 4
"""Actions of which, after the first look, more futures are drawn."""
CAUTION = 1.0
"""Standard errors by which an action must be better than the rule's own."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class TeamRollout:
    """The best action for the robot that decides if all follow a rule ever after.

    Parameters
    ----------
    config
        The team, and the world that is believed in.
    base
        The rule; its name is that of the policies that `ExploringTeam` follows.
    num_rollouts
        Futures of each action, ≥ 2. Of the `num_kept` best, three times as many are drawn in addition.
    num_kept
        Actions of which more futures are drawn, ≥ 1; the rule's own comes on top.
    caution
        Standard errors by which an action must be better than the rule's own; 0 or above.

    Raises
    ------
    ArgumentError
        A number is out of range.
    """

    config: TeamConfig
    base: TeamPolicy
    num_rollouts: int = field(default=NUM_ROLLOUTS, metadata={"static": True})
    num_kept: int = field(default=NUM_KEPT, metadata={"static": True})
    caution: Number = CAUTION

    def __post_init__(self) -> None:
        for name, least in (("num_rollouts", 2), ("num_kept", 1)):
            if getattr(self, name) < least:
                raise ArgumentError(f"{name} is {getattr(self, name)}; it is at least {least}")

    @property
    def num_robots(self) -> int:
        """K."""
        return self.config.num_robots

    def decide(self, state: TeamState, key: Array) -> Decision:
        """Choose for one table; the futures draw from `key` (the probability of a choice is not known)."""
        base_key, first_key, second_key = jax.random.split(key, 3)
        own = self.base.decide(state, base_key).action.astype(jnp.int32)
        is_possible = possible_actions(state)
        every = jnp.arange(len(is_possible), dtype=jnp.int32)
        first = self.worths(state, every, is_possible, first_key, self.num_rollouts)
        promising = jnp.argsort(-jnp.where(every == own, jnp.inf, first.mean(axis=0)))
        kept = promising[: self.num_kept + 1].astype(jnp.int32)
        more = self.worths(state, kept, is_possible[kept], second_key, 3 * self.num_rollouts)
        worths = jnp.concatenate([first[:, kept], more])
        # The rule's own action comes first.
        gain = worths - worths[:, :1]
        error = jnp.std(gain, axis=0) / jnp.sqrt(len(gain) - 1.0)
        sure = jnp.where(is_possible[kept], gain.mean(axis=0) - self.caution * error, -jnp.inf)
        action = kept[jnp.argmax(sure)]
        return Decision(action, jnp.full((), jnp.nan, dtype=jnp.float32))

    def worths(
        self, state: TeamState, actions: Int[Array, " a"], is_possible: Bool[Array, " a"], key: Array, num_rollouts: int
    ) -> Float[Array, "S a"]:
        """Worth of each of S futures of some actions of one table; −∞ where one is impossible."""
        return future_worths(self.config, self.base, state, actions, is_possible, key, num_rollouts)


def future_worths(
    config: TeamConfig,
    base: Any,
    state: TeamState,
    actions: Int[Array, " a"],
    is_possible: Bool[Array, " a"],
    key: Array,
    num_rollouts: int,
) -> Float[Array, "S a"]:
    """Worth of each of S futures that begin with each of some actions and follow a rule; −∞ where one is impossible."""

    def one(key: Array) -> Float[Array, " a"]:
        hidden_key, world_key = jax.random.split(key)
        now = state, sampled_hidden(config, state, hidden_key)

        def begun(action: Int[Array, ""]) -> Float[Array, ""]:
            told = future(TEAM, config, now, action, base, world_key)
            is_there = state.table.is_on_table
            return as_expected(config.world, told.reward, is_there, told.state.table, told.hidden.table)

        # FINISH stands in for what is impossible, which no dynamics can begin.
        return jnp.where(is_possible, jax.vmap(begun)(jnp.where(is_possible, actions, 0)), -jnp.inf)

    return jax.vmap(one)(jax.random.split(key, num_rollouts))
