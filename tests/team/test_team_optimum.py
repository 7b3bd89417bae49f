"""The optimum of a team is what brute force finds, of one robot what `solve_table` finds; values are exact."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from naive_team_optimum import BruteForceTeam

from halfseen.errors import ArgumentError
from halfseen.planners.heuristics import GreedyPolicy
from halfseen.planners.optimum import solve_table
from halfseen.planners.pomdp import POMDPPolicy
from halfseen.team.config import TeamConfig
from halfseen.team.episodes import evaluate
from halfseen.team.grid_grasping import GridGrasping
from halfseen.team.myopic import MyopicTeam
from halfseen.team.optimum import solve_team
from halfseen.team.policy import UniformTeam
from halfseen.team.rules import ReservingTeam
from halfseen.team.state import TeamLayout, Workspace
from halfseen.world import Scene, WorldConfig
from halfseen.world.state import pad_scenes

TWO = np.array([[0.0, 0.4], [0.1, 0.0]])
THREE = np.array([[0.0, 0.4, 0.0], [0.0, 0.0, 0.3], [0.2, 0.0, 0.0]])


def team_of(horizon, num_robots=2, grasping=None, **others):
    grasping = GridGrasping() if grasping is None else grasping
    return TeamConfig(WorldConfig(horizon=horizon, grasping=grasping), (1.0,) * num_robots, **others)


def workspace(num_robots, num_objects, out_of_reach=(), near=()):
    reach, is_near = np.ones((num_robots, num_objects), dtype=bool), np.eye(num_objects, dtype=bool)
    for robot, cup in out_of_reach:
        reach[robot, cup] = False
    for i, j in near:
        is_near[i, j] = is_near[j, i] = True
    return Workspace(jnp.asarray(reach), jnp.asarray(is_near))


def hermite(config, num_nodes):
    nodes, weights = np.polynomial.hermite_e.hermegauss(num_nodes)
    std = config.world.grasping.offset_std
    return [(std * node, weight / sum(weights)) for node, weight in zip(nodes, weights, strict=True)]


def assert_equals_brute_force(config, hides, space, num_nodes):
    brute = BruteForceTeam(
        config, hides, np.asarray(space.is_in_reach), np.asarray(space.is_near), hermite(config, num_nodes)
    )
    optimum = solve_team(hides, config, space, num_grip_nodes=num_nodes)
    np.testing.assert_allclose(optimum.value, brute.value(), atol=1e-9, rtol=0)


# An attempt of 1 s and one of 3 s end at once with others, and are in the air when others look.
FEW = GridGrasping(held_s=(1.0, 3.0), held_share=(0.25, 0.75), limit_s=3.0)
ONE_TIME = GridGrasping(held_s=(1.0,), held_share=(1.0,), limit_s=3.0)


@pytest.mark.parametrize("price", [0.0, -0.3])
def test_two_robots_and_two_objects_equal_brute_force(price):
    assert_equals_brute_force(team_of(1, reward_per_s=price, grasping=FEW), TWO, workspace(2, 2), 2)


def test_two_robots_and_three_objects_equal_brute_force():
    space = workspace(2, 3, out_of_reach=[(0, 2)], near=[(0, 1)])
    assert_equals_brute_force(team_of(1, grasping=FEW, reward_per_s=-0.1), THREE, space, 2)


def test_robots_of_other_speeds_equal_brute_force():
    config = TeamConfig(WorldConfig(horizon=1, grasping=FEW), (1.0, 2.0), -0.2)
    assert_equals_brute_force(config, TWO, workspace(2, 2), 2)


@pytest.mark.slow
def test_two_decisions_of_each_of_two_robots_equal_brute_force():
    space = workspace(2, 2, out_of_reach=[(1, 0)])
    assert_equals_brute_force(team_of(2, reward_per_s=-0.3, grasping=ONE_TIME), TWO, space, 2)


def test_one_robot_is_the_optimum_of_one_robot():
    config = team_of(3, num_robots=1)
    of_team, of_one = solve_team(TWO, config, workspace(1, 2)), solve_table(TWO, config.world)
    np.testing.assert_allclose(of_team.value, of_one.value, atol=1e-9, rtol=0)
    rule = GreedyPolicy(config.world, uses_history=True, counts_penalty=True)
    pairs = [(ReservingTeam(config, rule), rule), (MyopicTeam(config), POMDPPolicy(config.world, 1))]
    for team, alone in pairs:
        np.testing.assert_allclose(of_team.policy_value(team), of_one.policy_value(alone), atol=1e-9, rtol=0)


@pytest.mark.slow
def test_no_policy_beats_the_optimum_and_a_second_robot_is_worth_something():
    config, space = team_of(2), workspace(2, 3)
    optimum = solve_team(THREE, config, space)
    rule = GreedyPolicy(config.world, uses_history=True, counts_penalty=True)
    for policy in (ReservingTeam(config, rule), MyopicTeam(config), UniformTeam()):
        assert optimum.regret(policy) > 0.01
    one = solve_team(THREE, team_of(2, num_robots=1), workspace(1, 3))
    assert optimum.value > one.value + 0.1


@pytest.mark.slow
def test_the_value_of_a_policy_is_what_it_earns():
    config = team_of(3, reward_per_s=-0.2)
    space = workspace(2, 3, out_of_reach=[(0, 2), (1, 0)], near=[(0, 1)])
    optimum = solve_team(THREE, config, space)
    layouts = TeamLayout(pad_scenes([Scene(THREE)]), jax.tree.map(lambda leaf: leaf[None], space))
    rule = GreedyPolicy(config.world, uses_history=True, counts_penalty=True)
    for policy in (ReservingTeam(config, rule), MyopicTeam(config)):
        earned = np.asarray(evaluate(config, layouts, policy, jax.random.key(11), 40_000).reward, dtype=np.float64)
        error = earned.std() / np.sqrt(len(earned))
        assert abs(earned.mean() - optimum.policy_value(policy)) < 4 * error


def test_what_cannot_be_solved_is_refused():
    space = workspace(2, 2)
    with pytest.raises(ArgumentError, match="AssumedGrasping, whose attempts may take any time"):
        solve_team(TWO, TeamConfig(WorldConfig(horizon=1), (1.0, 1.0)), space)
    with pytest.raises(ArgumentError, match="have more than 100 states; shorten the horizon"):
        solve_team(TWO, team_of(2), space, max_states=100)
    with pytest.raises(ArgumentError, match="drop_out_rate is given"):
        solve_team(TWO, team_of(1, drop_out_rate=(0.1, 0.1)), space)


@pytest.mark.parametrize(
    ("numbers", "told"),
    [
        ({"held_share": (0.5, 0.6)}, "held_share is"),
        ({"held_s": (2.0, 7.0)}, "held_s is"),
        ({"held_s": (2.0,)}, "one share"),
    ],
)
def test_a_grid_that_is_none_is_refused(numbers, told):
    with pytest.raises(ArgumentError, match=told):
        GridGrasping(**numbers)
