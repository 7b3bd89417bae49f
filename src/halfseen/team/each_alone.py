"""Every robot for itself: each follows a policy of one robot on what it reaches, and knows nothing of the others."""

from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
from jaxtyping import Array

from halfseen.errors import ArgumentError
from halfseen.learning.q_learner import CensoredQLearner
from halfseen.logs import Logs
from halfseen.team.actions import possible_actions
from halfseen.team.own_part import alone
from halfseen.team.state import TeamState
from halfseen.world.action_space import ActionSpace, Verb
from halfseen.world.policy import Decision, Policy
from halfseen.world.state import TableState


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class EachAlone:
    """A team without coordination; what another robot is at, or near, is to each as if it were not there.

    Parameters
    ----------
    policies
        Policy of each robot, such as one that learned from its own part of a log (`halfseen.team.own_part.alone`).

    Raises
    ------
    ArgumentError
        There is none.
    """

    policies: tuple[Policy, ...]

    def __post_init__(self) -> None:
        if not self.policies:
            raise ArgumentError("policies is (): give the policy of each robot, at least one")

    @property
    def num_robots(self) -> int:
        """K."""
        return len(self.policies)

    def decide(self, state: TeamState, key: Array) -> Decision:
        """Let the policy of the robot that decides choose."""
        table = own_table(state)
        decisions = [policy.decide(table, key) for policy in self.policies]
        each = jax.tree.map(lambda *leaves: jnp.stack([jnp.asarray(leaf) for leaf in leaves]), *decisions)
        return jax.tree.map(lambda leaf: leaf[state.decider], each)


def learned_alone(logs: Logs, num_robots: int, horizon: int) -> EachAlone:
    """Learn the policy of each robot from its own part of a log, by all defaults.

    Parameters
    ----------
    logs
        Of a team.
    num_robots
        K.
    horizon
        Decisions of each robot.

    Raises
    ------
    ArgumentError, LogError, PositivityError
        There is not enough to learn from in the part of a robot.
    """
    parts = (alone(logs, robot) for robot in range(num_robots))
    return EachAlone(tuple(CensoredQLearner.for_table(horizon).fit(part).policy_ for part in parts))


def own_table(state: TeamState) -> TableState:
    """The table as the robot that decides sees it as if alone: what it could begin with now, and its own decisions."""
    table = state.table
    is_free = possible_actions(state)[ActionSpace(table.num_objects).of(Verb.WASH)]
    to_go = jnp.maximum(state.robots.decisions_to_go[state.decider], 1).astype(table.steps_to_go.dtype)
    return replace(table, is_on_table=is_free, steps_to_go=to_go)
