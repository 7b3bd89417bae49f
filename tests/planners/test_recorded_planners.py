"""Rules, looks ahead, rollouts, optima and bounds are what was recorded of those that came before."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from halfseen.cell.calibration.law import read_law, shipped_law
from halfseen.planners import (
    HEURISTICS,
    GreedyPolicy,
    MyopicPolicy,
    OneAtATime,
    POMDPPolicy,
    ReservingPolicy,
    RolloutPolicy,
    RoundRobin,
    TeamOfRules,
    information_relaxation_bound,
    solve_table,
    solve_team,
)
from halfseen.planners.belief import grip_posterior
from halfseen.planners.exact_table import GridGrasping
from halfseen.planners.futures import future_rewards
from halfseen.planners.heuristics import TrueGrasp
from halfseen.planners.rollout import sampled_values
from halfseen.world import ExploringPolicy, Scene, UniformPolicy, Workspace, WorldConfig, random
from halfseen.world.rollout import play
from halfseen.world.state import pad_scenes
from picked import picked
from world.world_cases import recorded_scenes as scenes
from world.world_cases import world_of

RECORDED = np.load(Path(__file__).parents[1] / "recorded" / "planners.npz")
CASES = sorted({name.rsplit("/", 1)[0] for name in RECORDED if not name.startswith("exact")})
KEY = random.key_of(3)
pytestmark = pytest.mark.filterwarnings("ignore:.*in no robot's reach")


def played(world, policy, at):
    """States of episodes in which a policy explores, by episode and stage."""
    layouts, config = world.layouts(scenes()), world.played_config
    states = play(config, layouts, ExploringPolicy(policy, 0.3), random.key_of(7), 40).states
    return picked(states, (at[:, 0], at[:, 1]))


def of_one(config, states, keys):
    found = {f"worth {name}": GreedyPolicy(config, *how).worth(states) for name, how in HEURISTICS.items()}
    found |= {f"pomdp_q {h}": POMDPPolicy(config, h, 128).q_values(states, keys) for h in (2, 10)}
    found["one_step_q"] = POMDPPolicy(config, 1).q_values(states, keys)
    found["sampled_values"] = np.stack([sampled_values(config, picked(states, k), KEY, 8) for k in range(8)])
    found["true_grasp"] = TrueGrasp(config).probability(states)
    return found | {"grip_log_weights": grip_posterior(config, states).log_weights}


def of_team(config, states, keys):
    rule = GreedyPolicy(config, uses_history=True, counts_penalty=True)
    by_rule, some = ReservingPolicy(config, rule), picked(states, np.s_[:30:2])
    rules = {"TeamOfRules": TeamOfRules(rule), "RoundRobin": RoundRobin(rule), "OneAtATime": OneAtATime(rule)}
    found = {
        f"action {name}": policy.decide(states, keys).action
        for name, policy in (rules | {"ReservingTeam": by_rule}).items()
    }
    found["myopic_q"] = MyopicPolicy(config).q_values(states)
    found["future_rewards"] = future_rewards(config, some, by_rule, keys[:15], 16)
    return found | {"action RolloutTeam": RolloutPolicy(config, by_rule, 16).decide(some, keys[:15]).action}


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_planners_say_what_was_recorded(case):
    is_team, (*team, law) = case.startswith("team"), case.split("/")[:-1]
    world, at = world_of(team[0] if is_team else "alone", law), RECORDED[f"{case}/at"]
    rule = GreedyPolicy(world.played_config, uses_history=True, counts_penalty=True)
    states = played(world, ReservingPolicy(world.played_config, rule) if is_team else rule, at)
    found = (of_team if is_team else of_one)(world.played_config, states, np.stack([KEY] * len(at)))
    for what, values in found.items():
        expected = RECORDED[f"{case}/{what}"]
        if what.startswith("worth"):
            values = np.where(np.isfinite(expected), values, expected)
        np.testing.assert_allclose(values, expected, rtol=2e-5, atol=3e-5, err_msg=what)


TWO = np.array([[0.0, 0.4], [0.1, 0.0]])
THREE = np.array([[0.0, 0.4, 0.0], [0.0, 0.0, 0.3], [0.2, 0.0, 0.0]])
CONFIGS = {"assumed": WorldConfig(), "calibrated": read_law(shipped_law()).law.config(WorldConfig())}


@pytest.mark.parametrize("name", CONFIGS)
def test_the_optimum_of_a_table(name):
    config = CONFIGS[name]
    optimum = solve_table(TWO, config, horizon=4)
    recorded = {what: RECORDED[f"exact/optimum/{name}/{what}"] for what in ("at", "q_values", "action")}
    tables = pad_scenes([Scene(TWO)])
    states = play(replace(config, horizon=4), tables, UniformPolicy(), random.key_of(7), 20).states
    states = [picked(states, tuple(at)) for at in recorded["at"]]

    assert optimum.value == pytest.approx(RECORDED[f"exact/optimum/{name}/value"], abs=1e-12)
    assert optimum.num_states == RECORDED[f"exact/optimum/{name}/num_states"]
    np.testing.assert_allclose([optimum.q_values(state) for state in states], recorded["q_values"], rtol=1e-10)
    assert [optimum.action(state) for state in states] == recorded["action"].tolist()
    worth = RECORDED[f"exact/optimum/{name}/policy_values of heuristics"]
    rules = [GreedyPolicy(config, *how) for how in HEURISTICS.values()]
    np.testing.assert_allclose(optimum.policy_values(rules), worth, rtol=1e-10)
    worth = RECORDED[f"exact/optimum/{name}/policy_value of POMDPPolicy 1"]
    assert optimum.policy_value(POMDPPolicy(config, 1)) == pytest.approx(worth, rel=1e-10)


@pytest.mark.parametrize(
    ("name", "reveals"),
    [(law, reveals) for law in CONFIGS for reveals in ("looks", "hidden")] + [("assumed", "everything")],
)
def test_the_bound(name, reveals):
    bound = information_relaxation_bound(THREE, CONFIGS[name], num_samples=200, seed=0, reveals=reveals)

    np.testing.assert_allclose(bound, RECORDED[f"exact/bound/{name}/{reveals}"], rtol=1e-10)


def test_the_optimum_of_a_team():
    law = GridGrasping(held_s=(1.0, 3.0), held_share=(0.25, 0.75), limit_s=3.0)
    config = WorldConfig(horizon=1, grasping=law, speed=(1.0, 2.0), reward_per_s=-0.2)
    space = Workspace(np.array([[True, True, False], [True, True, True]]), np.eye(3, dtype=bool))
    optimum = solve_team(THREE, config, space, num_grip_nodes=3)
    rule = GreedyPolicy(config, uses_history=True, counts_penalty=True)

    assert optimum.value == pytest.approx(RECORDED["exact/team optimum/value"], abs=1e-12)
    assert optimum.num_states == RECORDED["exact/team optimum/num_states"]
    for was, policy in (("ReservingTeam", ReservingPolicy(config, rule)), ("MyopicTeam", MyopicPolicy(config))):
        worth = RECORDED[f"exact/team optimum/policy_value of {was}"]
        assert optimum.policy_value(policy) == pytest.approx(worth, rel=1e-10)
