"""Multi-agent rollout [Bertsekas2021]_: futures in which all robots follow a rule, improved one robot at a time.

The robot that decides tries each of its actions in futures in which it and all others follow the base rule afterwards.
Where several robots are free at once they decide in order, each knowing what those before it chose, as the state tells
it. So a decision costs as many futures as one robot has actions, not as many as all robots have together.

A future is played by the dynamics of the world from what nobody knows (`unknown`), drawn from what is seen; every
action meets the same draws. An action replaces the rule's own only where it is better by more than its noise:
an improvement that is not there is what errors look like.
"""

from collections.abc import Callable
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
from halfseen.world.action_space import FINISH
from halfseen.world.number import Number
from halfseen.world.policy import Decision

NUM_ROLLOUTS = 32
NUM_KEPT = 4
"""Actions of which, after the first look, more futures are drawn."""
CAUTION = 2.0
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
        Futures of each action, ≥ 2; as many as these together are then drawn of those that promise most.
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
        base_key, future_key = jax.random.split(key)
        own = self.base.decide(state, base_key).action.astype(jnp.int32)
        is_possible = possible_actions(state)
        num_actions, num_left = len(is_possible), min(self.num_kept + 1, len(is_possible))
        lane = jnp.arange(self.num_rollouts * num_actions)
        every = jnp.arange(num_actions, dtype=jnp.int32)

        def one_round(among: Int[Array, " a"], of_round: tuple[Array, Array]) -> tuple[Array, Array]:
            size, key = of_round
            action = among[lane % size]
            keys = jax.vmap(lambda draw: jax.random.fold_in(key, draw))(lane // size)
            worth = jax.vmap(lambda action, key: future_worth(self.config, self.base, state, action, key))(
                jnp.where(is_possible[action], action, own), keys
            )
            mean = worth.reshape(-1, num_actions).mean(axis=0)
            # The rule's own action comes first.
            return jnp.argsort(-jnp.where(every == own, jnp.inf, jnp.where(is_possible, mean, -jnp.inf))), worth

        # One loop, so that what is compiled holds the futures once.
        sizes = jnp.array([num_actions, num_left]), jax.random.split(future_key, 2)
        promising, (first, second) = _two_rounds(one_round, every, sizes)
        kept = promising[:num_left]
        num_more = len(lane) // num_left
        more = second[: num_more * num_left].reshape(num_more, num_left)
        worths = jnp.concatenate([first.reshape(-1, num_actions)[:, kept], more])
        gain = worths - worths[:, :1]
        error = jnp.std(gain, axis=0) / jnp.sqrt(len(gain) - 1.0)
        sure = jnp.where(is_possible[kept], gain.mean(axis=0) - self.caution * error, -jnp.inf)
        return Decision(kept[jnp.argmax(sure)], jnp.full((), jnp.nan, dtype=jnp.float32))


def _two_rounds(
    one_round: Callable[..., tuple[Array, Array]], every: Int[Array, " a"], rounds: tuple[Array, Array]
) -> tuple[Int[Array, " a"], Float[Array, "2 L"]]:
    """What promises most after the first round, and the worths of both."""

    def followed(among: Array, of_round: tuple[Array, Array]) -> tuple[Array, tuple[Array, Array]]:
        after, worth = one_round(among, of_round)
        return after.astype(every.dtype), (after.astype(every.dtype), worth)

    _, (promising, worths) = jax.lax.scan(followed, every, rounds)
    return promising[0], worths


def future_worth(
    config: TeamConfig, base: Any, state: TeamState, action: Int[Array, ""], key: Array
) -> Float[Array, ""]:
    """Worth of one future that begins with a possible action and then follows a rule."""
    hidden_key, world_key = jax.random.split(key)
    told = future(TEAM, config, (state, sampled_hidden(config, state, hidden_key)), action, base, world_key)
    return as_expected(config.world, told.reward, state.table.is_on_table, told.state.table, told.hidden.table)


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
        # FINISH stands in for what is impossible, which no dynamics can begin.
        begun = jnp.where(is_possible, actions, FINISH)
        worth = jax.vmap(lambda action: future_worth(config, base, state, action, key))(begun)
        return jnp.where(is_possible, worth, -jnp.inf)

    return jax.vmap(one)(jax.random.split(key, num_rollouts))
