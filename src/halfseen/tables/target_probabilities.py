"""π(a | S_t) of policies of tables in the states of a log, for off-policy evaluation; any number of robots."""

from typing import Any

import numpy as np
from jaxtyping import Float, Int

from halfseen.errors import ArgumentError
from halfseen.world import random
from halfseen.world.actions import possible_actions
from halfseen.world.policy import Decision, ExploringPolicy, Policy, UniformPolicy, check_decides_for
from halfseen.world.state import TableState


def table_probabilities(policy: Any, states: TableState) -> Float[np.ndarray, "n T A"]:
    """π(a | S_t) of any deterministic `halfseen.world.Policy`, or one mixed with `UniformPolicy`.

    Parameters
    ----------
    policy
        What decides.
    states
        Of a log, axes (n, T).

    Raises
    ------
    ArgumentError
        It is none, is for another horizon, or draws its actions and cannot say how.
    PolicyError
        It is for another number of robots.
    """
    if not isinstance(policy, Policy):
        raise ArgumentError(f"{type(policy).__name__} decides nothing about tables, which the task is of")
    _check_number(policy, states)
    return action_probabilities(policy, states)


def action_probabilities(policy: Any, states: TableState) -> Float[np.ndarray, "*B A"]:
    """π(a | S); NaN where the policy draws its actions and does not say how."""
    is_possible = possible_actions(states)
    uniform = is_possible / np.sum(is_possible, axis=-1, keepdims=True)
    if isinstance(policy, UniformPolicy):
        return uniform
    if isinstance(policy, ExploringPolicy):
        return policy.random_share * uniform + (1.0 - policy.random_share) * action_probabilities(policy.base, states)
    decision = _decision(policy, states)
    is_taken = np.arange(is_possible.shape[-1]) == decision.action[..., None]
    return np.where(decision.probability[..., None] == 1.0, is_taken.astype(np.float64), np.nan)


def decisions(policy: Any, states: TableState) -> Int[np.ndarray, "*B"]:
    """Action of a policy that draws nothing in each of some states.

    Raises
    ------
    ArgumentError
        The policy draws its actions.
    PolicyError
        It is for another number of robots.
    """
    _check_number(policy, states)
    decision = _decision(policy, states)
    # What chose for certain says so; the probability of a planner's choice is not known, so that it is NaN.
    if not (decision.probability == 1.0).all():
        raise ArgumentError(
            f"{type(policy).__name__} draws its actions, so that a state does not tell what it does; give a policy "
            "that draws nothing"
        )
    return decision.action


def _check_number(policy: Any, states: TableState) -> None:
    if states.robots is not None or getattr(policy, "num_robots", None) not in (None, 1):
        check_decides_for(policy, states.num_robots)


def _decision(policy: Any, states: TableState) -> Decision:
    keys = np.broadcast_to(random.key_of(0), (*states.is_object.shape[:-1], 2))
    return policy.decide(states, keys)
