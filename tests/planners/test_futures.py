"""Futures: drawn from what is known, alike in law to what happens, and of one robot alone what beliefs are worth."""

from dataclasses import replace

import numpy as np
import pytest

import own_laws
from halfseen.errors import ArgumentError
from halfseen.planners import (
    GreedyPolicy,
    POMDPPolicy,
    ReservingPolicy,
    RolloutPolicy,
    futures,
    named_policy,
    solve_team,
)
from halfseen.planners.exact_table import GridGrasping
from halfseen.planners.futures import future_rewards, imagined
from halfseen.planners.rollout import sampled_values
from halfseen.world import Verb, Workspace, WorldConfig, random
from halfseen.world.actions import possible_actions
from halfseen.world.rollout import play
from halfseen.world.transition import start, step
from picked import picked, repeated
from world.world_cases import layouts_of

HIDES = np.array([[0.0, 0.5, 0.2], [0.0, 0.0, 0.4], [0.0, 0.0, 0.0]])
WORLD = WorldConfig(horizon=4)
RULE = GreedyPolicy(WORLD, uses_history=True, counts_penalty=True)
KEY, NUM_FUTURES = random.key_of(5), 1500
PAIR = replace(WORLD, speed=(1.0, 1.0))


def layouts(num_robots):
    return layouts_of(HIDES, np.ones((num_robots, len(HIDES))))


def first_layout(num_robots):
    return picked(layouts(num_robots), 0)


def alone(layout):
    """The same for one robot without a team."""
    return replace(layout, workspace=None)


def test_futures_are_worth_what_rollouts_in_beliefs_are():
    state, _ = start(WORLD, alone(first_layout(1)), KEY)
    in_beliefs = sampled_values(WORLD, state, KEY, NUM_FUTURES)
    in_worlds = future_rewards(WORLD, state, POMDPPolicy(WORLD, planning_horizon=1), KEY, NUM_FUTURES)
    error = np.sqrt(in_beliefs.var(axis=0) + in_worlds.var(axis=0)) / np.sqrt(NUM_FUTURES)
    np.testing.assert_array_less(np.abs(in_beliefs.mean(axis=0) - in_worlds.mean(axis=0)), 4.0 * error + 1e-4)


def test_one_robot_has_the_futures_of_one_without_a_team(monkeypatch):
    layout, keys = first_layout(1), np.stack([random.key_of(seed) for seed in range(3)])
    by_itself, of_team = (repeated(start(WORLD, each, KEY)[0], len(keys)) for each in (alone(layout), layout))
    in_team = future_rewards(WORLD, of_team, ReservingPolicy(WORLD, RULE), keys, 50)
    # What robots are at is drawn from the second half of a team's key.
    monkeypatch.setattr(futures, "imagined", lambda world, state, key: imagined(world, state, random.split(key)[0]))
    np.testing.assert_allclose(in_team[..., :-1], future_rewards(WORLD, by_itself, RULE, keys, 50), rtol=1e-5)
    assert np.isneginf(in_team[..., -1]).all()


def test_what_another_is_at_ends_as_its_law_says_given_that_it_has_not_ended():
    state, hidden = start(PAIR, first_layout(2), KEY)
    state, _, _ = step(PAIR, state, hidden, np.asarray(1), KEY)
    since_s = 3.0
    state = replace(state, robots=replace(state.robots, since_s=np.array([since_s, 0.0], dtype=np.float32)))
    draws = imagined(PAIR, repeated(state, 8_000), random.keys_of(KEY, 8_000))
    # Of u on the nodes of its prior: exponential times, some of them cut at the limit.
    nodes, weights = np.polynomial.hermite_e.hermegauss(7)
    scale_s = np.exp(0.6 + 2.2 * (1.0 - 0.5 * 0.8) - nodes)
    passed_s, limit_s = since_s - WORLD.transport_s, 6.0
    weights = weights * np.exp(-passed_s / scale_s)
    weights /= weights.sum()
    missed = np.exp(-(limit_s - passed_s) / scale_s)
    left_s = scale_s * (1.0 - missed)
    is_held, found_s = draws.pending.is_held[:, 0], draws.pending.left_s[:, 0]
    assert found_s.min() >= 0.0
    assert np.mean(is_held) == pytest.approx(weights @ (1.0 - missed), abs=0.015)
    assert np.mean(found_s) == pytest.approx(weights @ left_s, abs=0.06)
    assert np.mean(draws.grasp_latent[:, 0]) == pytest.approx(weights @ nodes, abs=0.03)
    assert np.isinf(draws.pending.left_s[:, 1]).all()


@pytest.mark.slow
@pytest.mark.parametrize("laws", ["shared", "own"])
def test_futures_of_a_team_are_worth_what_comes_of_it(laws):
    num_trajectories = 200
    if laws == "shared":
        config, stages = replace(PAIR, reward_per_s=-0.1), (1, 3)
        rule = ReservingPolicy(config, RULE)
        trajectories = play(config, layouts(2), rule, KEY, num_trajectories)
    else:
        world, stages = own_laws.world_of(None, own_laws.LOGISTIC, price=-0.1), (2,)
        config, rule = world.played_config, named_policy("history-penalty", world.played_config)
        trajectories = own_laws.played(world, rule, num_trajectories)
    keys = random.keys_of(random.key_of(11), num_trajectories)
    for stage in stages:
        is_there = trajectories.is_taken[:, stage]
        later = np.sum(np.where(trajectories.is_taken, trajectories.reward, 0.0)[:, stage:], axis=1)[is_there]
        states, taken = picked(trajectories.states, (is_there, stage)), trajectories.action[is_there, stage]
        worth = future_rewards(config, states, rule, keys[is_there], 8)
        found = worth[np.arange(len(taken)), :, taken].mean(axis=1)
        difference = found - later
        assert abs(difference.mean()) < 4.0 * difference.std() / np.sqrt(len(difference))
        assert np.corrcoef(found, later)[0, 1] > 0.1


def test_a_choice_rests_on_what_is_seen_alone_and_is_possible():
    policy = RolloutPolicy(PAIR, ReservingPolicy(PAIR, RULE), num_futures=16)
    state, hidden = start(PAIR, first_layout(2), KEY)
    other = replace(hidden, is_dirty=~hidden.is_dirty)
    after = [step(PAIR, state, each, np.asarray(1), KEY)[0] for each in (hidden, other)]
    choices = [int(policy.decide(each, KEY).action) for each in after]
    assert choices[0] == choices[1]
    assert possible_actions(after[0])[choices[0]]


def test_what_goes_on_is_not_yet_over_also_on_a_grid_of_times():
    config = replace(PAIR, grasping=GridGrasping())
    state, _ = start(config, first_layout(2), KEY)
    # Attempts take 3, 5 or 7 s. If robot 0 decides after 3 s, robot 1 may be at its end, too; not the other way round.
    at = [(0, [0.0, 3.0], 1, {0.0, 2.0, 4.0}), (1, [3.0, 0.0], 0, {2.0, 4.0})]
    for decider, since_s, robot, left_s in at:
        robots = replace(
            state.robots,
            is_busy=np.arange(2) == robot,
            verb=np.full(2, int(Verb.WASH), dtype=np.int32),
            target=np.full(2, 1, dtype=np.int32),
            since_s=np.asarray(since_s, dtype=np.float32),
        )
        seen = replace(state, robots=robots, decider=np.asarray(decider, dtype=np.int32))
        draws = imagined(config, repeated(seen, 400), random.keys_of(KEY, 400))
        assert set(draws.pending.left_s[:, robot].tolist()) == left_s


def test_a_scatter_needs_two_futures():
    with pytest.raises(ArgumentError, match="num_futures is 1; give at least 2"):
        RolloutPolicy(WORLD, ReservingPolicy(WORLD, RULE), num_futures=1)


@pytest.mark.slow
def test_a_team_that_looks_ahead_earns_more_than_its_rule_and_no_more_than_the_optimum():
    config = WorldConfig(horizon=2, grasping=GridGrasping(), speed=(1.0, 1.0), reward_per_s=-0.1)
    rule = ReservingPolicy(config, GreedyPolicy(config, uses_history=True, counts_penalty=True))
    hides, everything = np.array([[0.0, 0.5], [0.0, 0.0]]), np.ones((2, 2), dtype=bool)
    optimum = solve_team(hides, config, Workspace(everything, np.eye(2, dtype=bool)))
    # Exact expectations: no luck is in them but that of the futures drawn.
    plain, ahead = (optimum.regret(policy) for policy in (rule, RolloutPolicy(config, rule, 32)))
    assert 0.0 < ahead < 0.5 * plain
