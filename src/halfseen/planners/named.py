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
"""Of each `GreedyPolicy`: whether it uses history, and whether it counts the penalty."""
UNIFORM, PLANNER = "uniform", "planner"
"""`UniformPolicy`, and a `POMDPPolicy` that looks to the end."""


def named_policy(name: str, config: "WorldConfig", random_share: float = 0.0) -> "Policy":
    """Make the policy of a name.

    Parameters
    ----------
    name
        One of `HEURISTICS`, `UNIFORM`, `PLANNER`.
    config
        The world that it believes in.
    random_share
        Probability that a step takes an action uniformly at random instead.
    """
    # Names are asked for where JAX is not loaded yet.
    from halfseen.planners.heuristics import GreedyPolicy
    from halfseen.planners.pomdp import POMDPPolicy
    from halfseen.world import UniformPolicy

    if name == UNIFORM:
        return UniformPolicy()
    if name == PLANNER:
        policy: Policy = POMDPPolicy(config, planning_horizon=config.horizon)
    else:
        policy = GreedyPolicy(config, *HEURISTICS[name])
    return exploring(policy, random_share)


def exploring(policy: "Policy", random_share: float) -> "Policy":
    """Let a policy take some actions uniformly at random.

    Parameters
    ----------
    policy
        Who decides else.
    random_share
        Probability that a step does so; at 0 the policy is given back.
    """
    from halfseen.world import ExploringPolicy

    return ExploringPolicy(policy, random_share) if random_share else policy
