"""What a policy of a team that draws nothing would have done in the states of a log."""

import jax
import numpy as np
from jaxtyping import Int

from halfseen.errors import ArgumentError
from halfseen.logs import Logs
from halfseen.team.policy import TeamPolicy
from halfseen.team.recording import states_of
from halfseen.team.state import TeamState
from halfseen.world.policy import Decision


def decided(policy: TeamPolicy, logs: Logs, horizon: int) -> Int[np.ndarray, "n T"]:
    """Action in every stage of a log; of no meaning where a path has no stage.

    Parameters
    ----------
    policy
        What was learned.
    logs
        Of as many robots.
    horizon
        T, the decisions of all robots together.

    Raises
    ------
    ArgumentError
        The policy draws its actions.
    """
    return decisions(policy, states_of(logs, horizon))


def decisions(policy: TeamPolicy, states: TeamState) -> Int[np.ndarray, "n T"]:
    """Action in each of some states.

    Raises
    ------
    ArgumentError
        The policy draws its actions.
    """
    decision = _decisions(policy, states)
    # What chose for certain says so; the probability of a planner's choice is not known, so that it is NaN.
    if not (np.asarray(decision.probability) == 1.0).all():
        raise ArgumentError(
            f"{type(policy).__name__} draws its actions, so that a state does not tell what it does; give a policy "
            "that draws nothing"
        )
    return np.asarray(decision.action)


@jax.jit
def _decisions(policy: TeamPolicy, states: TeamState) -> Decision:
    return jax.vmap(jax.vmap(lambda state: policy.decide(state, jax.random.key(0))))(states)
