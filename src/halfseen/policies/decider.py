"""From a policy in a folder, or one in memory, to what decides by it."""

from collections.abc import Sequence
from typing import Any

from halfseen.errors import ArgumentError
from halfseen.learners.q_learning.flat_policy import FlatPolicy
from halfseen.policies.decision import Decider
from halfseen.policies.folder import StoredPolicy
from halfseen.policies.named_decider import NamedDecider
from halfseen.policies.ranges import RangesOfStage, everything
from halfseen.policies.table_decider import TableDecider
from halfseen.world.policy import Policy


def decider_of(
    policy: Any,
    ranges: RangesOfStage = everything,
    *,
    extrapolates: bool = False,
    pessimism: float | None = None,
    stages_left: Sequence[float] = (),
    least_rewards: dict[str, float] | None = None,
) -> Decider:
    """Put a policy behind the port.

    Parameters
    ----------
    policy
        A `StoredPolicy`, which knows all that follows but `extrapolates`; a `FlatPolicy`; or any
        `halfseen.world.Policy`: learned, a planner or a heuristic.
    ranges
        What the logs showed where it was learned.
    extrapolates
        True to decide, with a warning, even where something lies far outside these ranges; else that is refused.
    pessimism
        Standard errors of Q that its margin is; None if nobody knows, and then nobody knows how sure a decision is.
    stages_left
        By stage, how many there are from it to the end of a path, on average; empty if nobody knows, and then all that
        the horizon leaves.
    least_rewards
        Of each verb of a table, the least that it paid in the logs [reward]; None if nobody knows.

    Raises
    ------
    ArgumentError
        It is none of these.
    """
    if isinstance(policy, StoredPolicy):
        return decider_of(
            policy.policy,
            policy.ranges,
            extrapolates=extrapolates,
            pessimism=policy.pessimism,
            stages_left=policy.stages_left,
            least_rewards=policy.least_rewards,
        )
    if isinstance(policy, FlatPolicy):
        return NamedDecider(policy, ranges, extrapolates, pessimism, stages_left)
    if isinstance(policy, Policy):
        return TableDecider(
            policy,
            ranges,
            extrapolates=extrapolates,
            pessimism=pessimism,
            stages_left=stages_left,
            least_rewards=least_rewards or {},
        )
    raise ArgumentError(f"{type(policy).__name__} is no policy; give one of named actions or of tables")
