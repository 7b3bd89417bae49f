"""What decides for a team, one robot at a time, knowing what the others are at."""

from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import jax
from jaxtyping import Array

from halfseen.team.actions import possible_actions
from halfseen.team.state import TeamState
from halfseen.world.number import Number
from halfseen.world.policy import Decision, check_random_share, mixed, uniformly


@runtime_checkable
class TeamPolicy(Protocol):
    """Decides for the robot that is free, on one table; a pytree, as a `Policy` is."""

    def decide(self, state: TeamState, key: Array) -> Decision:
        """Choose an action that is possible for the decider; `key` is the only source of randomness."""
        ...


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class UniformTeam:
    """Takes each possible action with the same probability."""

    def decide(self, state: TeamState, key: Array) -> Decision:
        """Choose uniformly at random."""
        return uniformly(possible_actions(state), key)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ExploringTeam:
    """Follows a policy, but in a proportion of the decisions takes a possible action uniformly at random.

    Parameters
    ----------
    base
        The policy that is followed.
    random_share
        Probability that a decision is made uniformly at random instead.

    Raises
    ------
    ArgumentError
        `random_share` is outside [0, 1].
    """

    base: TeamPolicy
    random_share: Number = 0.5

    def __post_init__(self) -> None:
        check_random_share(self.random_share)

    def decide(self, state: TeamState, key: Array) -> Decision:
        """Choose, and report the probability of that choice under the mixture."""
        base_key, coin_key, uniform_key = jax.random.split(key, 3)
        base, uniform = self.base.decide(state, base_key), UniformTeam().decide(state, uniform_key)
        return mixed(base, uniform, self.random_share, coin_key)
