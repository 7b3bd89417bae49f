"""What decides: one interface for heuristics, planners and what was learned."""

from dataclasses import dataclass
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from halfseen.errors import ArgumentError
from halfseen.world.action_space import possible_actions
from halfseen.world.number import Number, is_wrong
from halfseen.world.state import TableState


class Decision(NamedTuple):
    """An action and how likely the policy was to take it (NaN where it cannot say)."""

    action: Int[Array, "*B"]
    probability: Float[Array, "*B"]


@runtime_checkable
class Policy(Protocol):
    """Decides for one table from what is seen of it.

    A policy is a pytree (its parameters are leaves), so that one compiled simulation serves all policies of a kind and
    `jax.vmap` runs many at once.
    """

    def decide(self, state: TableState, key: Array) -> Decision:
        """Choose a possible action for one table; `key` is the only source of randomness."""
        ...


def surely(action: Int[Array, ""]) -> Decision:
    """A deterministic decision."""
    return Decision(action, jnp.ones((), dtype=jnp.float32))


def uniformly(is_possible: Bool[Array, " A"], key: Array) -> Decision:
    """Each possible action with the same probability."""
    action = jax.random.categorical(key, jnp.where(is_possible, 0.0, -jnp.inf))
    return Decision(action.astype(jnp.int32), 1.0 / jnp.sum(is_possible))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class UniformPolicy:
    """Takes each possible action with the same probability."""

    def decide(self, state: TableState, key: Array) -> Decision:
        """Choose uniformly at random."""
        return uniformly(possible_actions(state), key)


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class ExploringPolicy:
    """Follows a policy, but in a proportion of the steps takes an action uniformly at random: what fills the logs.

    Parameters
    ----------
    base
        The policy that is followed.
    random_share
        Probability that a step takes one of the possible actions uniformly at random instead.

    Raises
    ------
    ArgumentError
        `random_share` is outside [0, 1].
    """

    base: Policy
    random_share: Number = 0.5

    def __post_init__(self) -> None:
        check_random_share(self.random_share)

    def decide(self, state: TableState, key: Array) -> Decision:
        """Choose, and report the probability of that choice under the mixture."""
        base_key, coin_key, uniform_key = jax.random.split(key, 3)
        base, uniform = self.base.decide(state, base_key), UniformPolicy().decide(state, uniform_key)
        return mixed(base, uniform, self.random_share, coin_key)


def check_random_share(random_share: Number) -> None:
    """Refuse a share of random decisions outside [0, 1]."""
    if is_wrong(random_share, lambda value: 0 <= value <= 1):
        raise ArgumentError(f"random_share is {random_share!r}; give the share of decisions made at random, in [0, 1]")


def mixed(base: Decision, uniform: Decision, random_share: Number, key: Array) -> Decision:
    """Toss for one of two decisions, with the probability that the mixture of both gives to what comes out."""
    is_random = jax.random.uniform(key) < random_share
    action = jnp.where(is_random, uniform.action, base.action)
    by_base = jnp.where(action == base.action, base.probability, 0.0)
    return Decision(action, random_share * uniform.probability + (1.0 - random_share) * by_base)
