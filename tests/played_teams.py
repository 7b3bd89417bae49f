"""Logs of teams to test with: played, cut, and written down."""

from dataclasses import replace

import numpy as np

from halfseen.arrays import record
from halfseen.planners.heuristics import GreedyPolicy, TeamOfRules
from halfseen.world import ExploringPolicy, Scene, Workspace, WorldConfig, random
from halfseen.world.actions import FINISH, ActionSpace, Verb, possible_actions
from halfseen.world.cuts import cut, cut_rate
from halfseen.world.grasping import Attempt
from halfseen.world.logs import to_logs
from halfseen.world.policy import surely
from halfseen.world.rollout import play
from halfseen.world.state import pad_scenes

NUM_OBJECTS = 4
SCENE = Scene(np.triu(np.full((NUM_OBJECTS, NUM_OBJECTS), 0.3), 1))


@record
class SureGrasping:
    """Every attempt works, and takes two seconds for each number of its object, plus one."""

    limit_s: float = 10.0

    def draw_latent(self, num_objects, key):
        return None

    def attempt(self, arrangement, latent, verb, target, key):
        seconds = 1.0 + 2.0 * np.asarray(target, dtype=np.float32)
        return Attempt(np.ones(target.shape, dtype=bool), seconds, arrangement.hides, None)


@record
class WashWhatIsDirty:
    """WASH what looks dirtiest of all that is possible; FINISH where nothing looks rather dirty than clean."""

    def decide(self, state, key):
        is_free = possible_actions(state)[..., ActionSpace(state.num_objects).of(Verb.WASH)]
        looks = np.where(is_free, state.log_odds, -np.inf)
        return surely(np.where(looks.max(axis=-1) > 0.0, 1 + looks.argmax(axis=-1), FINISH))


def layout_of(num_robots, reach=None):
    """The scene, with robots that reach what `reach` says, or everything, and are in each other's way nowhere."""
    is_in_reach = np.ones((num_robots, NUM_OBJECTS), dtype=bool) if reach is None else np.asarray(reach, dtype=bool)
    return replace(pad_scenes([SCENE]), workspace=Workspace(is_in_reach[None], np.eye(NUM_OBJECTS, dtype=bool)[None]))


def played(config, num_trajectories, seed=1, reach=None):
    """Uncut trajectories of an exploring team of rules."""
    rule = GreedyPolicy(WorldConfig(), uses_history=True, counts_penalty=True)
    policy, layouts = ExploringPolicy(TeamOfRules(rule)), layout_of(config.num_robots, reach)
    return play(config, layouts, policy, random.key_of(seed), num_trajectories)


def logged(trajectories, cut_share):
    rate = cut_rate(trajectories, cut_share, "independent")
    return to_logs(cut(trajectories, rate, "independent", np.random.default_rng(0)), "independent", [SCENE], 0.6)


def team_of(num_robots, horizon=5, **others):
    return WorldConfig(horizon=horizon, speed=(1.0,) * num_robots, **others)
