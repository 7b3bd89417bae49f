"""The policies of a team that go by a name: those of one robot (`planners.named`), reserving."""

from halfseen.planners.heuristics import GreedyPolicy
from halfseen.planners.named import HEURISTICS, UNIFORM
from halfseen.team.config import TeamConfig
from halfseen.team.policy import ExploringTeam, TeamPolicy, UniformTeam
from halfseen.team.rules import ReservingTeam


def named_team(name: str, config: TeamConfig, random_share: float = 0.0) -> TeamPolicy:
    """Make the policy of a name.

    Parameters
    ----------
    name
        One of `planners.named.HEURISTICS`, of a `ReservingTeam`, or ``"uniform"``.
    config
        The team that it believes in.
    random_share
        Probability that a decision is made uniformly at random instead.
    """
    if name == UNIFORM:
        return UniformTeam()
    team = ReservingTeam(config, GreedyPolicy(config.world, *HEURISTICS[name]))
    return ExploringTeam(team, random_share) if random_share else team
