"""Every robot for itself: each follows a policy of one robot on what it reaches, and knows nothing of the others."""

from dataclasses import replace
from typing import Any

from halfseen.arrays import library_of, mapped, record
from halfseen.errors import ArgumentError
from halfseen.world.actions import ActionSpace, Verb, possible_actions
from halfseen.world.others import is_decider
from halfseen.world.policy import Decision, Policy
from halfseen.world.random import Key
from halfseen.world.state import TableState


@record
class IndependentPolicies:
    """A team without coordination; what another robot is at, or near, is to each as if it were not there.

    Parameters
    ----------
    policies
        Policy of each robot, such as one that learned from its own view of a log (`halfseen.tables.agent_view`).

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

    def decide(self, state: TableState, key: Key) -> Decision:
        """Let the policy of the robot that decides choose."""
        table, xp = own_table(state), library_of(state.log_odds)
        found, *rest = [policy.decide(table, key) for policy in self.policies]
        for robot, other in enumerate(rest, start=1):
            is_its_turn = state.decider == robot
            found = mapped(lambda new, old, turn=is_its_turn: xp.where(turn, new, old), other, found)
        return found


def own_table(state: TableState) -> TableState:
    """The table as the robot that decides sees it as if alone: what it could begin with now, and its own decisions."""
    robots: Any = state.robots
    xp = library_of(state.log_odds)
    is_free = possible_actions(state)[..., ActionSpace(state.num_objects).of(Verb.WASH)]
    own_to_go = xp.sum(xp.where(is_decider(state), robots.decisions_to_go, 0), axis=-1)
    to_go = xp.maximum(own_to_go, 1).astype(state.steps_to_go.dtype)
    alone = {"robots": None, "workspace": None, "decider": None, "attempt_robot": None}
    return replace(state, is_on_table=is_free, steps_to_go=to_go, **alone)
