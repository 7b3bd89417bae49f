"""The policies of a team that go by a name: those of one robot (`planners.named`), reserving, and a planner."""

from halfseen.planners.heuristics import GreedyPolicy
from halfseen.planners.named import HEURISTICS, PLANNER, UNIFORM
from halfseen.team.config import TeamConfig
from halfseen.team.myopic import MyopicTeam
from halfseen.team.policy import ExploringTeam, TeamPolicy, UniformTeam
from halfseen.team.rollout import RolloutTeam
from halfseen.team.rules import ReservingTeam


def named_team(name: str, config: TeamConfig, random_share: float = 0.0) -> TeamPolicy:
    """Make the policy of a name.

    Parameters
    ----------
    name
        One of `planners.named.HEURISTICS`, of a `ReservingTeam`; ``"planner"``, a `RolloutTeam` over a `MyopicTeam`; or
        ``"uniform"``.
    config
        The team that it believes in.
    random_share
        Probability that a decision is made uniformly at random instead.
    """
    if name == UNIFORM:
        return UniformTeam()
    if name == PLANNER:
        team: TeamPolicy = RolloutTeam(config, MyopicTeam(config))
    else:
        team = ReservingTeam(config, GreedyPolicy(config.world, *HEURISTICS[name]))
    return exploring_team(team, random_share)


def exploring_team(team: TeamPolicy, random_share: float) -> TeamPolicy:
    """Let a team make some decisions uniformly at random.

    Parameters
    ----------
    team
        Who decides else.
    random_share
        Probability that a decision does so; at 0 the policy is given back.
    """
    return ExploringTeam(team, random_share) if random_share else team
