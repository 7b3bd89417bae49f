"""Whether a policy is one for this team."""

from typing import Any

from halfseen.errors import PolicyError
from halfseen.team.config import TeamConfig
from halfseen.team.learned_policy import LinearTeamPolicy
from halfseen.world.state import TableState


def check_fits(policy: Any, config: TeamConfig) -> None:
    """Refuse a policy that is not for a team, in itself or in what it builds upon.

    Parameters
    ----------
    policy
        What is to decide for the team.
    config
        The team.

    Raises
    ------
    PolicyError
        It is for another number of robots, for another number of their decisions, or for a robot alone.
    """
    check_decides_for(policy, config.num_robots)
    base = getattr(policy, "base", None)
    if base is not None:
        check_fits(base, config)
    if isinstance(policy, LinearTeamPolicy) and len(policy.coefficients) != config.num_stages:
        raise PolicyError(
            f"the policy was learned for {len(policy.coefficients)} decisions of all robots together, and this team "
            f"makes up to {config.num_stages} ({config.num_robots} robots, {config.world.horizon} each); learn it from "
            "logs of such a team"
        )


def check_decides_for(policy: Any, num_robots: int) -> None:
    """Refuse a policy for another number of robots, or for one that works alone.

    A policy tells by `num_robots` for how many it is, unless it is for any number. One that works alone says so by the
    type of the state that it decides in.

    Raises
    ------
    PolicyError
        It is for another number of robots, or for a robot alone.
    """
    if getattr(policy.decide, "__annotations__", {}).get("state") is TableState:
        raise PolicyError(
            f"{type(policy).__name__} decides for one robot, and a team's policy knows what the others are at; give "
            "EachAlone, with such a policy for each robot, or ReservingTeam, with a rule of thumb"
        )
    known = getattr(policy, "num_robots", None)
    if known is not None and known != num_robots:
        raise PolicyError(
            f"the policy is for {known} robots, and the team has {num_robots}; give one for as many, or another team"
        )
