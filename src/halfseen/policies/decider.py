"""From a policy in a folder, or one in memory, to what decides by it."""

from typing import Any

from halfseen.errors import ArgumentError
from halfseen.learning.flat_policy import FlatPolicy
from halfseen.policies.certainty import QError
from halfseen.policies.decision import Decider
from halfseen.policies.folder import StoredPolicy
from halfseen.policies.named_decider import NamedDecider
from halfseen.policies.of_team import UNDECIDED, refuse_team
from halfseen.policies.ranges import RangesOfStage, everything


def decider_of(
    policy: Any,
    ranges: RangesOfStage = everything,
    *,
    extrapolates: bool = False,
    q_error: QError | None = None,
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
    q_error
        What is known of the errors of its Q; None if nothing, and then nobody knows how sure a decision is.
    least_rewards
        Of each verb of a table, the least that it paid in the logs [reward]; None if nobody knows.

    Raises
    ------
    ArgumentError
        It is none of these.
    PolicyError
        It decides for a team.
    """
    if isinstance(policy, StoredPolicy):
        refuse_team(policy, UNDECIDED)
        return decider_of(
            policy.policy,
            policy.ranges,
            extrapolates=extrapolates,
            q_error=policy.q_error,
            least_rewards=policy.least_rewards,
        )
    if isinstance(policy, FlatPolicy):
        return NamedDecider(policy, ranges, extrapolates, q_error)
    # Tables load the world, which takes longer than a decision on named actions.
    from halfseen.policies.table_decider import TableDecider
    from halfseen.world.policy import Policy

    if isinstance(policy, Policy):
        least = least_rewards or {}
        return TableDecider(policy, ranges, extrapolates=extrapolates, q_error=q_error, least_rewards=least)
    raise ArgumentError(f"{type(policy).__name__} is no policy; give one of named actions or of tables")
