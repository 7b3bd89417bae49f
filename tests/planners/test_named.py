"""Policies by name: one list for all who take a name, and each name its own policy."""

import pytest

from halfseen.cli import cell_policies
from halfseen.planners.futures import RolloutPolicy
from halfseen.planners.heuristics import GreedyPolicy
from halfseen.planners.myopic import MyopicPolicy
from halfseen.planners.named import HEURISTICS, PLANNER, UNIFORM, named_policy
from halfseen.planners.pomdp import POMDPPolicy
from halfseen.planners.rules import ReservingPolicy
from halfseen.study.policies import HEURISTICS as CONTENDERS
from halfseen.world import ExploringPolicy, UniformPolicy, WorldConfig

CONFIG, PAIR = WorldConfig(), WorldConfig(speed=(1.0, 1.5))


@pytest.mark.parametrize("name", HEURISTICS)
def test_a_heuristic_does_what_its_name_says(name):
    expected = GreedyPolicy(CONFIG, uses_history="history" in name, counts_penalty="penalty" in name)
    assert named_policy(name, CONFIG) == expected
    assert named_policy(name, CONFIG, 0.5) == ExploringPolicy(expected, 0.5)


def test_others_go_by_names_too():
    assert isinstance(named_policy(UNIFORM, CONFIG, 0.5), UniformPolicy)
    planner = named_policy(PLANNER, CONFIG)
    assert isinstance(planner, POMDPPolicy)
    assert planner.planning_horizon == CONFIG.horizon


@pytest.mark.parametrize("name", HEURISTICS)
def test_robots_of_a_team_reserve_by_the_heuristic_of_the_name(name):
    reserving = ReservingPolicy(PAIR, named_policy(name, PAIR, is_team=False))
    assert named_policy(name, PAIR) == reserving
    assert named_policy(name, PAIR, 0.5) == ExploringPolicy(reserving, 0.5)


def test_others_of_a_team_go_by_the_same_names():
    assert isinstance(named_policy(UNIFORM, PAIR, 0.5), UniformPolicy)
    assert named_policy(PLANNER, PAIR) == RolloutPolicy(PAIR, MyopicPolicy(PAIR))
    # One robot with a reach of its own is a team, too.
    assert named_policy(PLANNER, CONFIG, is_team=True) == RolloutPolicy(CONFIG, MyopicPolicy(CONFIG))


def test_the_study_and_the_cell_know_the_same_names():
    assert [each.name for each in CONTENDERS] == list(HEURISTICS)
    assert [each.policy(CONFIG) for each in CONTENDERS] == [named_policy(name, CONFIG) for name in HEURISTICS]
    assert (*HEURISTICS, PLANNER) == cell_policies.NAMES
