"""Optima, what policies are worth, and bounds are those recorded of the solvers that came before."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from halfseen.cell.calibration.law_folder import read_law, shipped_law
from halfseen.planners import POMDPPolicy, information_relaxation_bound, solve_table, solve_team
from halfseen.planners.grid_grasping import GridGrasping
from halfseen.planners.heuristics import GreedyPolicy
from halfseen.planners.myopic import MyopicPolicy
from halfseen.planners.named import HEURISTICS
from halfseen.planners.rules import ReservingPolicy
from halfseen.world import Scene, UniformPolicy, WorldConfig, random
from halfseen.world.rollout import play
from halfseen.world.state import Workspace, pad_scenes
from picked import picked

RECORDED = np.load(Path(__file__).parents[1] / "recorded" / "planners.npz")
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
