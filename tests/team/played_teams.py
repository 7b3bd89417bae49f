"""Logs of teams to test with: played, cut, and written down."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from halfseen.planners.heuristics import GreedyPolicy
from halfseen.team import episodes
from halfseen.team.config import TeamConfig
from halfseen.team.policy import ExploringTeam
from halfseen.team.recording import to_logs
from halfseen.team.rules import TeamOfRules
from halfseen.team.state import TeamLayout, Workspace
from halfseen.world import Scene, WorldConfig
from halfseen.world.cuts import cut, cut_rate
from halfseen.world.episodes import BATCH
from halfseen.world.grasping import Attempt
from halfseen.world.state import pad_scenes
from picked import picked

NUM_OBJECTS = 4
SCENE = Scene(np.triu(np.full((NUM_OBJECTS, NUM_OBJECTS), 0.3), 1))


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class SureGrasping:
    """Every attempt works, and takes two seconds for each number of its object, plus one."""

    limit_s: float = 10.0

    def draw_trait(self, num_objects, key):
        return None

    def attempt(self, arrangement, trait, verb, target, key):
        return Attempt(jnp.asarray(True), 1.0 + 2.0 * target, arrangement.hides, None)


def played(team, num_paths, seed=1, reach=None):
    """Uncut paths of an exploring team of rules: the first of as many as one program plays, whatever their number."""
    is_in_reach = (
        np.ones((team.num_robots, NUM_OBJECTS), dtype=bool) if reach is None else np.asarray(reach, dtype=bool)
    )
    space = Workspace(jnp.asarray(is_in_reach)[None], jnp.eye(NUM_OBJECTS, dtype=bool)[None])
    rule = GreedyPolicy(WorldConfig(), uses_history=True, counts_penalty=True)
    policy = ExploringTeam(TeamOfRules(rule))
    layouts = TeamLayout(pad_scenes([SCENE]), space)
    paths = episodes.play(team, layouts, policy, jax.random.key(seed), max(num_paths, BATCH))
    return picked(paths, np.s_[:num_paths])


def logged(paths, cut_share):
    rate = cut_rate(paths, cut_share, "independent")
    return to_logs(cut(paths, rate, "independent", np.random.default_rng(0)), "independent", [SCENE], 0.6)


def team_of(num_robots, horizon=5, **others):
    return TeamConfig(WorldConfig(horizon=horizon), speed=(1.0,) * num_robots, **others)
