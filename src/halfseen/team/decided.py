"""What a policy of a team would have done in the states of a log."""

import jax
import numpy as np
from jaxtyping import Array, Int

from halfseen.logs import Logs
from halfseen.team.policy import TeamPolicy
from halfseen.team.recording import states_of
from halfseen.team.state import TeamState


def decided(policy: TeamPolicy, logs: Logs, horizon: int) -> Int[np.ndarray, "n T"]:
    """Action of a policy that draws nothing in every stage of a log; of no meaning where a path has no stage.

    Parameters
    ----------
    policy
        What was learned.
    logs
        Of as many robots.
    horizon
        T, the decisions of all robots together.
    """
    return np.asarray(decisions(policy, states_of(logs, horizon)))


@jax.jit
def decisions(policy: TeamPolicy, states: TeamState) -> Int[Array, "n T"]:
    """Action of a policy that draws nothing in each of some states."""
    return jax.vmap(jax.vmap(lambda state: policy.decide(state, jax.random.key(0)).action))(states)
