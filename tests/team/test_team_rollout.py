"""Futures of a team: drawn from what is known, alike in law to what happens, and one robot's where there is one."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from halfseen.errors import ArgumentError
from halfseen.planners.futures import KnownRewards, foreseen, future_rewards, imagined
from halfseen.planners.heuristics import GreedyPolicy
from halfseen.planners.pomdp import POMDPPolicy
from halfseen.planners.rollout import sampled_values
from halfseen.team import dynamics, episodes
from halfseen.team.actions import possible_actions
from halfseen.team.config import TeamConfig
from halfseen.team.grid_grasping import GridGrasping
from halfseen.team.optimum import solve_team
from halfseen.team.rollout import RolloutTeam, imagined_team, team_future_rewards
from halfseen.team.rules import ReservingTeam
from halfseen.team.state import TeamLayout, Workspace
from halfseen.world import Scene, WorldConfig
from halfseen.world import dynamics as one_robot
from halfseen.world.action_space import Verb
from halfseen.world.action_space import possible_actions as possible_of_table
from halfseen.world.episodes import ONE_ROBOT
from halfseen.world.state import pad_scenes
from picked import picked

NUM_OBJECTS = 3
HIDES = np.array([[0.0, 0.5, 0.2], [0.0, 0.0, 0.4], [0.0, 0.0, 0.0]])
WORLD = WorldConfig(horizon=4)
RULE = GreedyPolicy(WORLD, uses_history=True, counts_penalty=True)
KEY, NUM_FUTURES = jax.random.key(5), 1500
START, STEP = jax.jit(dynamics.start), jax.jit(dynamics.step)
OF_TABLE, OF_TEAM = (KnownRewards(WORLD, table_of) for table_of in (lambda each: each, lambda each: each.table))


def layouts_of(num_robots):
    reach = jnp.ones((1, num_robots, NUM_OBJECTS), dtype=bool)
    return TeamLayout(pad_scenes([Scene(HIDES)]), Workspace(reach, jnp.eye(NUM_OBJECTS, dtype=bool)[None]))


def first_of(layouts):
    return picked(layouts, 0)


def test_futures_are_worth_what_rollouts_in_beliefs_are():
    state, _ = jax.jit(one_robot.start)(WORLD, first_of(layouts_of(1)).table, KEY)
    in_beliefs = np.asarray(sampled_values(WORLD, state, KEY, NUM_FUTURES))
    in_worlds = np.asarray(
        jax.jit(
            lambda key: future_rewards(
                ONE_ROBOT,
                foreseen(WORLD),
                state,
                possible_of_table(state),
                lambda key: imagined(WORLD, state, key),
                POMDPPolicy(WORLD, planning_horizon=1),
                key,
                NUM_FUTURES,
                OF_TABLE,
            )
        )(KEY)
    )
    error = np.sqrt(in_beliefs.var(axis=0) + in_worlds.var(axis=0)) / np.sqrt(NUM_FUTURES)
    np.testing.assert_array_less(np.abs(in_beliefs.mean(axis=0) - in_worlds.mean(axis=0)), 4.0 * error + 1e-4)


def test_one_robot_has_the_futures_of_the_dynamics_of_one_robot():
    config, layout = TeamConfig(WORLD), first_of(layouts_of(1))

    @jax.jit
    def futures(key):
        state, _ = dynamics.start(config, layout, key)

        def imagine(key):
            return imagined(WORLD, state.table, jax.random.split(key)[0])

        is_possible = possible_of_table(state.table)
        world = foreseen(WORLD)
        alone = future_rewards(ONE_ROBOT, world, state.table, is_possible, imagine, RULE, key, 50, OF_TABLE)
        return alone, team_future_rewards(config, state, ReservingTeam(config, RULE), key, 50)

    for seed in range(3):
        alone, team = futures(jax.random.key(seed))
        np.testing.assert_allclose(team[:, :-1], alone, rtol=1e-5)
        assert np.isneginf(team[:, -1]).all()


def test_what_another_is_at_ends_as_its_law_says_given_that_it_has_not_ended():
    config, layout = TeamConfig(WORLD, speed=(1.0, 1.0)), first_of(layouts_of(2))
    state, hidden = START(config, layout, KEY)
    state, _, _ = STEP(config, state, hidden, jnp.asarray(1), KEY)
    since_s = 3.0
    state = replace(state, robots=replace(state.robots, since_s=jnp.array([since_s, 0.0])))
    draws = jax.jit(jax.vmap(lambda key: imagined_team(config, state, key)))(jax.random.split(KEY, 20_000))
    # Of u on the nodes of its prior: exponential times, some of them cut at the limit.
    nodes, weights = np.polynomial.hermite_e.hermegauss(7)
    scale_s = np.exp(0.6 + 2.2 * (1.0 - 0.5 * 0.8) - nodes)
    passed_s, limit_s = since_s - WORLD.transport_s, 6.0
    weights = weights * np.exp(-passed_s / scale_s)
    weights /= weights.sum()
    missed = np.exp(-(limit_s - passed_s) / scale_s)
    left_s = scale_s * (1.0 - missed)
    is_held, found_s = np.asarray(draws.pending.is_held[:, 0]), np.asarray(draws.pending.left_s[:, 0])
    assert found_s.min() >= 0.0
    assert np.mean(is_held) == pytest.approx(weights @ (1.0 - missed), abs=0.015)
    assert np.mean(found_s) == pytest.approx(weights @ left_s, abs=0.06)
    assert np.mean(draws.table.grasp_trait[:, 0]) == pytest.approx(weights @ nodes, abs=0.03)
    assert np.isinf(draws.pending.left_s[:, 1]).all()


@pytest.mark.slow
def test_futures_of_a_team_are_worth_what_comes_of_it():
    config, num_paths = TeamConfig(WORLD, (1.0, 1.0), reward_per_s=-0.1), 200
    rule = ReservingTeam(config, RULE)
    paths = episodes.play(config, layouts_of(2), rule, KEY, num_paths)
    keys = jax.random.split(jax.random.key(11), num_paths)

    def worth(state, action, key):
        only = jnp.arange(possible_actions(state).shape[0]) == action
        foreseeing = replace(config, world=foreseen(WORLD))
        return future_rewards(
            dynamics.TEAM, foreseeing, state, only, lambda key: imagined_team(config, state, key), rule, key, 8, OF_TEAM
        )[:, action].mean()

    worths = jax.jit(lambda given: jax.lax.map(lambda each: worth(*each), given))
    for stage in (1, 3):
        is_there = np.asarray(paths.is_taken[:, stage])
        later = np.asarray(jnp.sum(jnp.where(paths.is_taken, paths.reward, 0.0)[:, stage:], axis=1))[is_there]
        states = picked(paths.states, np.s_[:, stage])
        found = np.asarray(worths((states, paths.action[:, stage], keys)))[is_there]
        difference = found - later
        assert abs(difference.mean()) < 4.0 * difference.std() / np.sqrt(len(difference))
        assert np.corrcoef(found, later)[0, 1] > 0.1


def test_a_choice_rests_on_what_is_seen_alone_and_is_possible():
    config, layout = TeamConfig(WORLD, speed=(1.0, 1.0)), first_of(layouts_of(2))
    policy = RolloutTeam(config, ReservingTeam(config, RULE), num_futures=16)
    decide, step = jax.jit(policy.decide), jax.jit(dynamics.step)
    state, hidden = START(config, layout, KEY)
    other = replace(hidden, table=replace(hidden.table, is_dirty=~hidden.table.is_dirty))
    after = [step(config, state, each, jnp.asarray(1), KEY) for each in (hidden, other)]
    choices = [decide(each[0], KEY).action for each in after]
    assert int(choices[0]) == int(choices[1])
    assert bool(possible_actions(after[0][0])[choices[0]])


def test_what_goes_on_is_not_yet_over_also_on_a_grid_of_times():
    config = TeamConfig(replace(WORLD, grasping=GridGrasping()), (1.0, 1.0))
    state, _ = START(config, first_of(layouts_of(2)), KEY)
    # Attempts take 3, 5 or 7 s. If robot 0 decides after 3 s, robot 1 may be at its end, too; not the other way round.
    at = [(0, [0.0, 3.0], 1, {0.0, 2.0, 4.0}), (1, [3.0, 0.0], 0, {2.0, 4.0})]
    for decider, since_s, robot, left_s in at:
        robots = replace(
            state.robots,
            is_busy=jnp.arange(2) == robot,
            verb=jnp.full(2, int(Verb.WASH)),
            target=jnp.full(2, 1),
            since_s=jnp.asarray(since_s),
        )
        seen = replace(state, robots=robots, decider=jnp.asarray(decider))
        draws = jax.jit(jax.vmap(lambda key, seen=seen: imagined_team(config, seen, key)))(jax.random.split(KEY, 400))
        assert set(np.asarray(draws.pending.left_s[:, robot]).tolist()) == left_s


def test_a_scatter_needs_two_futures():
    with pytest.raises(ArgumentError, match="num_futures is 1; give at least 2"):
        RolloutTeam(TeamConfig(WORLD), ReservingTeam(TeamConfig(WORLD), RULE), num_futures=1)


@pytest.mark.slow
def test_a_team_that_looks_ahead_earns_more_than_its_rule_and_no_more_than_the_optimum():
    world = WorldConfig(horizon=2, grasping=GridGrasping())
    config = TeamConfig(world, (1.0, 1.0), reward_per_s=-0.1)
    rule = ReservingTeam(config, GreedyPolicy(world, uses_history=True, counts_penalty=True))
    hides, everything = np.array([[0.0, 0.5], [0.0, 0.0]]), np.ones((2, 2), dtype=bool)
    optimum = solve_team(hides, config, Workspace(jnp.asarray(everything), jnp.eye(2, dtype=bool)))
    # Exact expectations: no luck is in them but that of the futures drawn.
    plain, ahead = (optimum.regret(policy) for policy in (rule, RolloutTeam(config, rule, 32)))
    assert 0.0 < ahead < 0.5 * plain
