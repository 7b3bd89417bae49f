"""Policies by name: one list for all who take a name, and each name its own policy."""

from dataclasses import replace

import pytest

from halfseen.cli import inputs
from halfseen.planners import GreedyPolicy, MyopicPolicy, POMDPPolicy, ReservingPolicy, RolloutPolicy, named_policy
from halfseen.planners.named import HEURISTICS, PLANNER, UNIFORM
from halfseen.study.policies import HEURISTICS as CONTENDERS
from halfseen.world import ExploringPolicy, UniformPolicy, WorldConfig

CONFIG, PAIR = WorldConfig(), WorldConfig(speed=(1.0, 1.5))


@pytest.mark.parametrize("name", HEURISTICS)
def test_a_heuristic_does_what_its_name_says_and_robots_of_a_team_reserve_by_it(name):
    rule = GreedyPolicy(CONFIG, uses_history="history" in name, counts_penalty="penalty" in name)
    for config, expected in ((CONFIG, rule), (PAIR, ReservingPolicy(PAIR, replace(rule, config=PAIR)))):
        assert named_policy(name, config) == expected
        assert named_policy(name, config, 0.5) == ExploringPolicy(expected, 0.5)
    assert named_policy(name, PAIR, is_team=False) == replace(rule, config=PAIR)


def test_others_go_by_names_too():
    for config in (CONFIG, PAIR):
        assert isinstance(named_policy(UNIFORM, config, 0.5), UniformPolicy)
    planner = named_policy(PLANNER, CONFIG)
    assert isinstance(planner, POMDPPolicy)
    assert planner.planning_horizon == CONFIG.horizon
    assert named_policy(PLANNER, PAIR) == RolloutPolicy(PAIR, MyopicPolicy(PAIR))
    # One robot with a reach of its own is a team, too.
    assert named_policy(PLANNER, CONFIG, is_team=True) == RolloutPolicy(CONFIG, MyopicPolicy(CONFIG))


def test_the_study_and_the_cell_know_the_same_names():
    assert [each.name for each in CONTENDERS] == list(HEURISTICS)
    assert [each.policy(CONFIG) for each in CONTENDERS] == [named_policy(name, CONFIG) for name in HEURISTICS]
    assert (*HEURISTICS, PLANNER) == inputs.NAMES
