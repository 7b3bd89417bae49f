"""The interface of policies (heuristics, planners, learned ones), and that of grasp models, learned or known."""

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from halfseen.arrays import Array, Number, library_of, record
from halfseen.errors import PolicyError
from halfseen.shapes import Bool, Float, Int
from halfseen.world import random
from halfseen.world.actions import possible_actions
from halfseen.world.config import WorldConfig, check_number
from halfseen.world.random import Key
from halfseen.world.state import TableState


class PolicyDraw(NamedTuple):
    """An action and its propensity, the probability that the policy takes it (NaN if unknown)."""

    action: Int[Array, "*B"]
    probability: Float[Array, "*B"]


@runtime_checkable
class Policy(Protocol):
    """Decides for each table of a batch from its observed state; in a team, for the robot that is free."""

    def decide(self, state: TableState, key: Key) -> PolicyDraw:
        """Choose a possible action for each table; `key` is the only source of randomness."""
        ...


def surely(action: Int[Array, "*B"]) -> PolicyDraw:
    """Return a deterministic decision."""
    action = action.astype(np.int32)
    return PolicyDraw(action, library_of(action).ones(action.shape, dtype=np.float32))


def uniformly(is_possible: Bool[Array, "*B A"], key: Key) -> PolicyDraw:
    """Draw each possible action with the same probability."""
    num_possible = library_of(is_possible).sum(is_possible, axis=-1).astype(np.float32)
    return PolicyDraw(random.one_of(key, is_possible), 1.0 / num_possible)


class ByValue:
    """Takes the action with the largest of its `q_values`; deterministic."""

    q_values: Callable[..., Any]

    def decide(self, state: TableState, key: Key) -> PolicyDraw:
        """Choose an action; deterministic."""
        return surely(library_of(state.log_odds).argmax(self.q_values(state), axis=-1))


@record
class UniformPolicy:
    """Takes each possible action with the same probability."""

    def decide(self, state: TableState, key: Key) -> PolicyDraw:
        """Choose uniformly at random."""
        return uniformly(possible_actions(state), key)


@record
class ExploringPolicy:
    """Behaviour policy for logs: follows a base policy, but takes a uniformly random action in a share of the steps.

    Parameters
    ----------
    base
        The policy to follow.
    random_share
        Probability of a uniformly random possible action at each step.

    Raises
    ------
    ArgumentError
        `random_share` is outside [0, 1].
    """

    base: Policy
    random_share: Number = 0.5

    def __post_init__(self) -> None:
        check_number("random_share", self.random_share)

    def decide(self, state: TableState, key: Key) -> PolicyDraw:
        """Draw a decision from the mixture, with its probability under the mixture."""
        base_key, coin_key, uniform_key = random.split(key, 3)
        base, uniform = self.base.decide(state, base_key), UniformPolicy().decide(state, uniform_key)
        xp, share = library_of(base.action), self.random_share
        action = xp.where(random.uniform(coin_key) < share, uniform.action, base.action)
        by_base = xp.where(action == base.action, base.probability, np.float32(0.0))
        return PolicyDraw(action, share * uniform.probability + (1.0 - share) * by_base)


def check_fits(policy: Any, config: WorldConfig) -> None:
    """Check that a policy, and the policy it builds on, fit a team.

    A policy states its number of robots as `num_robots`, unless it takes any number, and the number of decisions for
    which it was learned, if any, as `num_stages`.

    Raises
    ------
    PolicyError
        It is for another number of robots or of decisions, or for a single robot.
    """
    check_decides_for(policy, config.num_robots)
    base = getattr(policy, "base", None)
    if base is not None:
        check_fits(base, config)
    known = getattr(policy, "num_stages", None)
    if known is not None and known != config.num_stages:
        raise PolicyError(
            f"the policy was learned for {known} decisions of all robots together, but this team makes up to "
            f"{config.num_stages} ({config.num_robots} robots, {config.horizon} each); learn it from logs of "
            "such a team"
        )


def check_decides_for(policy: Any, num_robots: int) -> None:
    """Check that a policy is for a team of `num_robots`.

    Raises
    ------
    PolicyError
        It is for another number of robots, or for a single robot.
    """
    # A class attribute marks policies for one robot; policies for teams set it per instance.
    if getattr(type(policy), "num_robots", None) == 1:
        raise PolicyError(
            f"{type(policy).__name__} decides for one robot, but a team's policy must know what the others do; "
            "give IndependentPolicies with such a policy for each robot, or ReservingPolicy with a rule of "
            "thumb"
        )
    known = getattr(policy, "num_robots", None)
    if known is not None and known != num_robots:
        raise PolicyError(
            f"the policy is for {known} robots, but the team has {num_robots}; give a policy or a team of the "
            "same number"
        )


@runtime_checkable
class GraspModel(Protocol):
    """Estimates the success probability of an attempt on each object."""

    def probability(self, state: TableState) -> Float[Array, "*B N"]:
        """P(an attempt succeeds) for each object, given its occlusion and its past attempts."""
        ...
