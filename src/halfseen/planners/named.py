"""The policies that go by a name: all who let a user name one look here."""

from types import MappingProxyType
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from halfseen.world import Policy, WorldConfig

HEURISTICS = MappingProxyType(
    {
        "greedy": (False, False),
        "history": (True, False),
        "greedy-penalty": (False, True),
        "history-penalty": (True, True),
    }
)
"""Of each `GreedyPolicy`: whether it uses history, and whether it counts the penalty; of several robots, reserving."""
UNIFORM, PLANNER = "uniform", "planner"
"""`UniformPolicy`; and a `POMDPPolicy` to the end, of several robots a `RolloutPolicy` over a `MyopicPolicy`."""


def named_policy(
    name: str, config: "WorldConfig", random_share: float = 0.0, *, is_team: bool | None = None
) -> "Policy":
    """Make the policy of a name.

    Parameters
    ----------
    name
        One of `HEURISTICS`, `UNIFORM`, `PLANNER`.
    config
        The world that it believes in.
    random_share
        Probability that a step takes an action uniformly at random instead.
    is_team
        Whether robots with a reach of their own work there; None where several do.
    """
    # Names are asked for where no world is loaded yet, and each planner is loaded once it is named.
    from halfseen import planners
    from halfseen.world import UniformPolicy

    is_team = config.num_robots > 1 if is_team is None else is_team
    policy: Policy
    if name == UNIFORM:
        return UniformPolicy()
    if name != PLANNER:
        rule = planners.GreedyPolicy(config, *HEURISTICS[name])
        policy = planners.ReservingPolicy(config, rule) if is_team else rule
    elif is_team:
        policy = planners.RolloutPolicy(config, planners.MyopicPolicy(config))
    else:
        policy = planners.POMDPPolicy(config, planning_horizon=config.horizon)
    return exploring(policy, random_share)


def exploring(policy: "Policy", random_share: float) -> "Policy":
    """Let a policy take some actions uniformly at random.

    A step does so with probability `random_share`; at 0 the policy is given back.
    """
    from halfseen.world import ExploringPolicy

    return ExploringPolicy(policy, random_share) if random_share else policy
