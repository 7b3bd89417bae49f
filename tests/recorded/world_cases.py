"""The worlds that are recorded, the scenes and who plays; at commit a5c2804."""

from dataclasses import replace

import jax
import numpy as np
from halfseen.team import Robot, Team
from halfseen.team.episodes import play as play_team
from halfseen.team.policy import ExploringTeam, UniformTeam
from halfseen.team.rules import ReservingTeam
from halfseen.world.episodes import play

from halfseen.cell.calibration.law_folder import read_law
from halfseen.cell.calibration.shipped import shipped_law
from halfseen.planners.heuristics import GreedyPolicy
from halfseen.world import ExploringPolicy, Scene, UniformPolicy, WorldConfig
from halfseen.world.state import pad_scenes

KEY, EPISODES = 7, 40
LAW = read_law(shipped_law()).law
CONFIGS = {"assumed": WorldConfig(), "calibrated": LAW.config(WorldConfig())}
TEAMS = {
    "team1": Team((Robot((-0.5, 0.05), 1.5, 1.3, "one"),), reward_per_s=-0.05),
    "team2": Team(
        (Robot((-0.5, 0.05), 0.65, 1.0, "left", 0.02), Robot((0.5, 0.05), 0.65, 1.5, "right", 0.03)), reward_per_s=-0.05
    ),
    "team2 that nothing stops": Team(
        (Robot((-0.5, 0.05), 0.65, 1.0, "left"), Robot((0.5, 0.05), 0.65, 1.5, "right")), reward_per_s=-0.05
    ),
    "team2 of two laws": Team(
        (
            Robot((-0.5, 0.05), 0.65, 1.0, "left", grasping=replace(WorldConfig().grasping, log_time=1.2)),
            Robot((0.5, 0.05), 0.65, 1.5, "right"),
        ),
        reward_per_s=-0.05,
    ),
    "team3": Team(
        (
            Robot((-0.5, 0.05), 0.8, 1.0, "left"),
            Robot((0.5, 0.05), 0.8, 1.2, "right"),
            Robot((0.0, 0.6), 0.7, 0.8, "far"),
        ),
        reward_per_s=-0.05,
    ),
}


def scenes():
    """Three tables of 4, 6 and 5 objects, with grips and places."""
    rng, made = np.random.default_rng(3), []
    for size in (4, 6, 5):
        hides = rng.uniform(0.0, 0.5, (size, size)) * (rng.random((size, size)) < 0.4) * ~np.eye(size, dtype=bool)
        grip, places_m = rng.normal(0.0, 0.3, size), rng.uniform(-0.4, 0.4, (size, 2))
        made.append(Scene(hides, f"table of {size}", grip, places_m))
    return made


def rule_of(config):
    """The best rule of thumb of one robot."""
    return GreedyPolicy(config, uses_history=True, counts_penalty=True)


def played():
    """All episodes, by world and player: name → (configuration, episodes)."""
    tables, key, found = pad_scenes(scenes()), jax.random.key(KEY), {}
    for name, config in CONFIGS.items():
        players = {"uniform": UniformPolicy(), "greedy": ExploringPolicy(rule_of(config), 0.3)}
        for who, policy in players.items():
            found[f"{name}/{who}"] = config, play(config, tables, policy, key, EPISODES)
    for name, team in TEAMS.items():
        for law, world in CONFIGS.items():
            if law == "calibrated" and name not in ("team2", "team3"):
                continue
            config, layouts = team.config(world), team.layouts(scenes())
            own = ReservingTeam(config, rule_of(config.world))
            for who, policy in {"uniform": UniformTeam(), "greedy": ExploringTeam(own, 0.3)}.items():
                found[f"{name}/{law}/{who}"] = config, play_team(config, layouts, policy, key, EPISODES)
    return found


def leaves(tree, prefix):
    """Arrays of a tree by the names of their fields, joined by dots; what is None is not there."""
    return {
        prefix + jax.tree_util.keystr(path, simple=True, separator="."): np.asarray(leaf)
        for path, leaf in jax.tree_util.tree_flatten_with_path(tree)[0]
    }


def some_states(episodes, count):
    """`count` states, evenly spread over those of all episodes, one after another: indices (episode, stage)."""
    at = np.argwhere(np.asarray(episodes.is_taken))
    return at[np.linspace(0, len(at) - 1, count).astype(int)]


def states_at(episodes, at):
    """States at indices (episode, stage), stacked."""
    return jax.tree.map(lambda leaf: leaf[at[:, 0], at[:, 1]], episodes.states)
