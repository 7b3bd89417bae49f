"""From a policy in a folder, or one in memory, to what decides by it."""

from typing import Any

from halfseen.errors import ArgumentError
from halfseen.learners.q_learning.flat_policy import FlatPolicy
from halfseen.policies.decision import Decider
from halfseen.policies.folder import StoredPolicy
from halfseen.policies.named_decider import NamedDecider
from halfseen.policies.ranges import RangesOfStage, everything
from halfseen.policies.table_decider import TableDecider
from halfseen.world.policy import Policy


def decider_of(policy: Any, ranges: RangesOfStage = everything) -> Decider:
    """Put a policy behind the port.

    Parameters
    ----------
    policy
        A `StoredPolicy`, which knows its ranges; a `FlatPolicy`; or any `halfseen.world.Policy`: learned, a planner or
        a heuristic.
    ranges
        What the logs showed where it was learned.

    Raises
    ------
    ArgumentError
        It is none of these.
    """
    if isinstance(policy, StoredPolicy):
        return decider_of(policy.policy, policy.ranges)
    if isinstance(policy, FlatPolicy):
        return NamedDecider(policy, ranges)
    if isinstance(policy, Policy):
        return TableDecider(policy, ranges)
    raise ArgumentError(f"{type(policy).__name__} is no policy; give one of named actions or of tables")
