"""The exact optimum of a small team against brute force, one robot's optimum, and the world that is simulated."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from naive_small_team import BruteForceTeam

from halfseen.errors import ArgumentError
from halfseen.planners import solve_table
from halfseen.planners.heuristics import GreedyPolicy
from halfseen.team import episodes
from halfseen.team.actions import possible_actions
from halfseen.team.config import TeamConfig
from halfseen.team.optimum import TeamOptimum, team_policy_value, team_state
from halfseen.team.optimum_model import GridGrasping, SmallTeam
from halfseen.team.policy import TeamOfRules, UniformTeam
from halfseen.team.rollout import RolloutTeam
from halfseen.team.rules import OneAtATime, ReservingTeam, RoundRobin
from halfseen.team.state import TeamLayout, Workspace
from halfseen.world import Scene, WorldConfig
from halfseen.world.policy import surely
from halfseen.world.seeing import AssumedSeeing
from halfseen.world.state import pad_scenes

HIDES = np.array([[0.0, 0.5, 0.2], [0.0, 0.0, 0.4], [0.0, 0.0, 0.0]])
REACH = np.array([[True, True, False], [False, True, True]])
GRASPING = GridGrasping(offset_std=1.0)


def small_team(num_objects, horizon, num_robots=2, near=(), num_nodes=2, grasping=GRASPING, **others):
    world = {name: others.pop(name) for name in ("seeing",) if name in others}
    config = TeamConfig(WorldConfig(horizon=horizon, grasping=grasping, **world), (1.0, 0.8)[:num_robots], **others)
    is_near = np.eye(num_objects, dtype=bool)
    for i, j in near:
        is_near[i, j] = is_near[j, i] = True
    reach = REACH[:, :num_objects] if num_objects == 3 else np.ones((num_robots, num_objects), dtype=bool)
    return SmallTeam(config, HIDES[:num_objects, :num_objects], reach, is_near, num_nodes)


def brute_force(team, near=()):
    reach = [set(np.flatnonzero(row)) for row in team.is_in_reach]
    return BruteForceTeam(team.config, team.hides, reach, [set(pair) for pair in near], team.num_grip_nodes).value()


@pytest.mark.parametrize(
    ("num_objects", "horizon", "near"),
    [(1, 3, ()), (3, 1, [(0, 2)]), (2, 1, ()), pytest.param(2, 2, (), marks=pytest.mark.slow)],
)
def test_the_optimum_is_that_of_brute_force(num_objects, horizon, near):
    # Brute force grows beyond reach where all of it is large.
    small: dict = {"num_nodes": 1} if num_objects == 3 else {}
    if (num_objects, horizon) == (2, 2):
        small = {"num_nodes": 1, "grasping": GridGrasping(held_s=(1.0,), missed_s=(2.0,))}
    team = small_team(num_objects, horizon, near=near, reward_per_s=-0.2, **small)
    assert TeamOptimum(team).value == pytest.approx(brute_force(team, near), abs=1e-9)


@pytest.mark.parametrize(("num_objects", "horizon"), [(2, 3), (3, 2)])
def test_the_optimum_of_one_robot_is_that_of_one_robot(num_objects, horizon):
    world = WorldConfig(horizon=horizon, grasping=GRASPING)
    everything = np.ones((1, num_objects), dtype=bool)
    hides = HIDES[:num_objects, :num_objects]
    team = SmallTeam(TeamConfig(world), hides, everything, np.eye(num_objects, dtype=bool), 3)
    assert TeamOptimum(team).value == pytest.approx(solve_table(hides, world, num_grip_nodes=3).value, abs=1e-9)


def test_the_value_of_a_policy_is_what_it_earns_in_the_world():
    # Where a look tells the same however much is hidden, the model leaves nothing out.
    seeing = AssumedSeeing(floor=0.8, gain=0.0)
    team = small_team(3, 2, grasping=GridGrasping(), num_nodes=1, seeing=seeing, reward_per_s=-0.3)
    rule = GreedyPolicy(team.config.world, uses_history=True, counts_penalty=True)
    layouts = TeamLayout(
        pad_scenes([Scene(HIDES)]), Workspace(jnp.asarray(REACH)[None], jnp.asarray(team.is_near)[None])
    )
    for policy in (ReservingTeam(team.config, rule), OneAtATime(rule)):
        earned = np.asarray(episodes.evaluate(team.config, layouts, policy, jax.random.key(2), 20_000).reward)
        found = team_policy_value(team, policy)
        assert found == pytest.approx(earned.mean(), abs=4.0 * earned.std() / np.sqrt(len(earned)))


def test_nobody_does_better_than_the_optimum_and_it_reaches_its_own_value():
    team = small_team(3, 1, reward_per_s=-0.1)
    optimum = TeamOptimum(team)
    rule = GreedyPolicy(team.config.world, uses_history=True, counts_penalty=True)
    reserving = ReservingTeam(team.config, rule)
    policies = (UniformTeam(), TeamOfRules(rule), reserving, RoundRobin(rule), RolloutTeam(team.config, reserving, 16))
    values = [team_policy_value(team, policy) for policy in policies]
    assert max(values) <= optimum.value + 1e-9
    assert values[0] < values[2]


def test_the_same_actions_are_possible_as_in_the_world():
    team = small_team(3, 2, near=[(1, 2)])
    known = [branch.known for branch in team.first()][:1]
    for _ in range(3):
        for each in known:
            assert np.flatnonzero(possible_actions(team_state(team, each))).tolist() == team.possible(each)
        after = [b.known for each in known for action in team.possible(each) for b in team.branches(each, action)]
        known = [each for each in after if not each.is_over][:: max(1, len(after) // 12)]


def test_chances_add_up():
    team = small_team(3, 2)
    known = team.first()[0].known
    for _ in range(3):
        for action in team.possible(known):
            branches = team.branches(known, action)
            assert sum(branch.probability for branch in branches) == pytest.approx(1.0, abs=1e-12)
        known = branches[0].known
        if known.is_over:
            break


class Impossible:
    """Lifts what is out of the robot's reach."""

    def decide(self, state, key):
        return surely(jnp.asarray(6, dtype=jnp.int32))


def test_what_is_not_possible_is_refused():
    with pytest.raises(ArgumentError, match="chose action 6"):
        team_policy_value(small_team(3, 1), Impossible())
