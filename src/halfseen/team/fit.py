"""Whether a policy is one for this team."""

from typing import Any

from halfseen.errors import PolicyError
from halfseen.team.config import TeamConfig
from halfseen.team.learned_policy import LinearTeamPolicy


def check_fits(policy: Any, config: TeamConfig) -> None:
    """Refuse a policy for another number of robots.

    A policy tells by `num_robots` for how many it is, unless it is for any number; a learned one by its decisions.

    Parameters
    ----------
    policy
        What is to decide for the team.
    config
        The team.

    Raises
    ------
    PolicyError
        It is for another number of robots, or for another number of their decisions.
    """
    base = getattr(policy, "base", None)
    if base is not None:
        check_fits(base, config)
    known = getattr(policy, "num_robots", None)
    if known is not None and known != config.num_robots:
        raise PolicyError(
            f"the policy is for {known} robots, and the team has {config.num_robots}; give one for as many, or another "
            "team"
        )
    if isinstance(policy, LinearTeamPolicy) and len(policy.coefficients) != config.num_stages:
        raise PolicyError(
            f"the policy was learned for {len(policy.coefficients)} decisions of all robots together, and this team "
            f"makes up to {config.num_stages} ({config.num_robots} robots, {config.world.horizon} each); learn it from "
            "logs of such a team"
        )
