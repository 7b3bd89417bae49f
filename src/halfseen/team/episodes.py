"""Tables that a team played to their end: those of one robot, played by a team's dynamics."""

from typing import TypeAlias

import jax.numpy as jnp
from jaxtyping import Array

from halfseen.team.config import TeamConfig
from halfseen.team.dynamics import TEAM
from halfseen.team.policy import TeamPolicy
from halfseen.team.state import TeamHidden, TeamLayout, TeamState
from halfseen.world.episodes import Episodes, Totals, evaluate_some, play_by

TeamEpisodes: TypeAlias = Episodes[TeamState, TeamHidden]


def play(config: TeamConfig, layouts: TeamLayout, policy: TeamPolicy, key: Array, num_episodes: int) -> TeamEpisodes:
    """Play tables and record every stage; episode k uses layout k modulo their number."""
    return play_by(TEAM, config, layouts, policy, key, num_episodes)


def evaluate(config: TeamConfig, layouts: TeamLayout, policy: TeamPolicy, key: Array, num_episodes: int) -> Totals:
    """Play the tables that `play` would and keep only the totals; `robot_s` is the table's clock at the end."""
    return evaluate_some(config, layouts, policy, key, jnp.arange(num_episodes), num_episodes, TEAM)
