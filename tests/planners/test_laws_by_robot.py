"""Beliefs, rules, looks ahead and imagined futures go by the law of grasping of the robot that tries."""

from dataclasses import replace

import numpy as np
import pytest
from naive_myopic import NODES, WEIGHTS, NaiveMyopic, assumed, logistic, odds_to_share
from scipy.stats import norm

from halfseen.arrays import softmax, stacked
from halfseen.errors import ArgumentError
from halfseen.planners import (
    GreedyPolicy,
    MyopicPolicy,
    ReservingPolicy,
    RolloutPolicy,
    RoundRobin,
    TeamOfRules,
    named_policy,
)
from halfseen.planners.belief import expected_attempt_s, grip_posterior
from halfseen.planners.futures import imagined
from halfseen.world import AssumedGrasping, UniformPolicy, Verb, random
from halfseen.world.actions import possible_actions, wait_of
from halfseen.world.state import NO_ATTEMPT, occlusion
from halfseen.world.transition import start, step
from other_laws import Nudging
from own_laws import KEY, LOGISTIC, NUM_OBJECTS, WORLD, first_layout, met, played, world_of
from picked import leaves_of, picked, repeated

NAIVE_LAWS = [assumed, logistic(0.4, -2.0, 2.0, 4.0)]


@pytest.mark.parametrize("policy_of", [
    lambda config: ReservingPolicy(config, GreedyPolicy(config, uses_history=True, counts_penalty=True)),
    lambda config: RoundRobin(GreedyPolicy(config, uses_history=True, counts_penalty=True)),
    pytest.param(MyopicPolicy, marks=pytest.mark.slow),
    pytest.param(
        lambda config: RolloutPolicy(config, named_policy("history-penalty", config), num_futures=4),
        marks=pytest.mark.slow,
    ),
])  # fmt: skip
def test_where_each_has_the_law_of_the_world_all_is_as_without(policy_of):
    own, shared = (world_of(law, law, price=-0.1) for law in (AssumedGrasping(), None))
    assert own.played_config.has_own_laws
    assert shared.played_config.grasping == AssumedGrasping()
    one, other = (played(world, policy_of(world.played_config), 40) for world in (own, shared))
    for found, known in zip(leaves_of(one.states), leaves_of(other.states), strict=True):
        np.testing.assert_allclose(found, known, rtol=1e-5, atol=1e-5)
    for name in ("action", "probability", "reward", "duration_s", "is_taken", "paid_alone"):
        np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(one.hidden.grasp_latent[1], other.hidden.grasp_latent, rtol=1e-5)


def naive_of(state, config, price=0.0):
    """The same table and team for `NaiveMyopic`."""
    table, robots, me = state, state.robots, int(state.decider)
    verbs = {int(Verb.WASH): "WASH", int(Verb.LIFT): "LIFT"}
    others = [r for r in range(2) if r != me]
    is_leaving = [bool(robots.is_busy[r]) and int(robots.verb[r]) == Verb.FINISH for r in range(2)]
    return NaiveMyopic(
        laws=NAIVE_LAWS,
        stds=[1.0, 1.5],
        speed=list(config.speed),
        price=price,
        hides=np.asarray(table.hides, dtype=np.float64),
        there=np.asarray(table.is_on_table).tolist(),
        dirty=[odds_to_share(float(each)) for each in table.log_odds],
        attempts=[
            (int(table.attempt_robot[k]), int(table.attempt_object[k]), float(table.attempt_occlusion[k]),
             bool(table.attempt_succeeded[k]))
            for k in tried_slots(table)
        ],
        reach=np.asarray(state.workspace.is_in_reach),
        me=me,
        busy={r: (verbs[int(robots.verb[r])], int(robots.target[r]), float(robots.since_s[r]))
              for r in others if bool(robots.is_busy[r]) and int(robots.verb[r]) in verbs},
        to_go=np.asarray(robots.decisions_to_go).tolist(),
        gone=[bool(robots.is_done[r]) or is_leaving[r] for r in range(2)],
    )  # fmt: skip


def tried_slots(table):
    return np.flatnonzero(np.asarray(table.attempt_object) != NO_ATTEMPT).tolist()


@pytest.fixture(scope="module")
def mixed():
    """States of a team of two laws that acts by chance, one by one, and its world."""
    world = world_of(None, LOGISTIC, price=-0.1)
    states = met(played(world, UniformPolicy(), 40))
    return world, [picked(states, k) for k in range(0, len(states.decider), 2)]


def test_each_attempt_tells_of_a_grip_what_the_law_of_its_robot_says(mixed):
    world, states = mixed
    found, by = softmax(grip_posterior(world.played_config, stacked(states)).log_weights), set()
    for state, posterior in zip(states, found, strict=True):
        naive = naive_of(state, world.played_config)
        by |= {each[0] for each in naive.attempts}
        np.testing.assert_allclose(posterior, naive.weights, rtol=2e-4, atol=1e-6)
    assert by == {0, 1}


def test_a_rule_is_worth_what_the_robot_that_decides_can_do(mixed):
    world, states = mixed
    config = world.played_config
    rule = GreedyPolicy(config, uses_history=True, counts_penalty=True)

    batch = stacked(states)
    own = config.as_robot(batch.decider)
    worths = replace(rule, config=own).worth(batch)
    all_seconds = expected_attempt_s(own, occlusion(batch), grip_posterior(own, batch))
    actions = ReservingPolicy(config, rule).decide(batch, np.stack([KEY] * len(states))).action
    for state, worth, seconds, action in zip(states, worths, all_seconds, actions, strict=True):
        naive = naive_of(state, config, price=0.1)
        me, num_going = naive.me, 1 + sum(not each for r, each in enumerate(naive.gone) if r != naive.me)
        best, best_at, is_hope = 0.0, None, False
        possible = np.asarray(possible_actions(state))
        for i in np.flatnonzero(naive.there):
            held = naive.chance(me, i, naive.occluded(i))
            known = held * (naive.dirty[i] * 20.0 - 10.0) - (1.0 - held)
            assert worth[i] == pytest.approx(known, abs=1e-3)
            assert seconds[i] == pytest.approx(naive.seconds(me, i), rel=1e-3)
            gain = known - 0.1 * naive.seconds(me, i) / num_going
            if not naive.reach[me][i] or gain <= 0.0:
                continue
            is_hope = True
            is_shared = any(naive.reach[r][i] and not naive.gone[r] for r in range(2) if r != me)
            gain -= 0.1 * naive.seconds(me, i) if is_shared else 0.0
            if possible[1 + i] and (best_at is None or gain > best):
                best, best_at = gain, i
        wait = wait_of(NUM_OBJECTS)
        assert int(action) == (1 + best_at if best_at is not None else wait if is_hope and possible[wait] else 0)


def test_a_look_one_step_ahead_is_that_of_plain_loops(mixed):
    world, states = mixed
    seen, q_values = set(), MyopicPolicy(world.played_config).q_values(stacked(states))
    for state, found in zip(states, q_values, strict=True):
        naive = naive_of(state, world.played_config, price=0.1)
        possible = np.asarray(possible_actions(state))
        for action in np.flatnonzero(possible):
            verb, i = divmod(int(action) - 1, NUM_OBJECTS)
            if action == 0:
                known, name = naive.finish(), "FINISH"
            elif action == wait_of(NUM_OBJECTS):
                if not naive.busy:  # it waits for one that goes home
                    continue
                known, name = naive.wait(), "WAIT"
            else:
                name = ("WASH", "LIFT")[verb]
                known = naive.attempt(name, i)
            seen.add((name, naive.me))
            assert found[action] == pytest.approx(known, abs=2e-3), (name, i)
    assert len(seen) == 8


def test_rules_leave_to_the_other_what_they_never_hold():
    clumsy = replace(LOGISTIC, log_odds=-30.0)
    world = world_of(None, clumsy, price=-0.05)
    for name in ("greedy", "history-penalty"):
        trajectories = played(world, named_policy(name, world.played_config))
        states, action = met(trajectories), np.asarray(trajectories.action)[np.asarray(trajectories.is_taken)]
        of_clumsy = np.asarray(states.decider) == 1
        assert not np.isin(action[of_clumsy], np.arange(1, 1 + 2 * NUM_OBJECTS)).any()
        assert np.isin(action[~of_clumsy], np.arange(1, 1 + NUM_OBJECTS)).any()
    # A rule that believes in one law for all does not know.
    unknowing = TeamOfRules(GreedyPolicy(WORLD, uses_history=True, counts_penalty=True))
    trajectories = played(world, unknowing)
    is_wash = np.isin(np.asarray(trajectories.action), np.arange(1, 1 + NUM_OBJECTS)) & np.asarray(
        trajectories.is_taken
    )
    assert (np.asarray(trajectories.states.decider)[is_wash] == 1).any()


@pytest.mark.slow
def test_what_another_is_at_ends_as_its_own_law_says():
    world = world_of(None, replace(LOGISTIC, log_std=0.3))
    config = world.played_config
    state, hidden = start(config, first_layout(world), KEY)
    for action in (1, 1 + 2):  # robot 0 washes 0, robot 1 washes 2
        state, hidden, _ = step(config, state, hidden, np.asarray(action), KEY)
    robots = replace(
        state.robots,
        is_busy=np.array([False, True]),
        verb=np.array([1, 1], dtype=np.int32),
        target=np.array([0, 2], dtype=np.int32),
        since_s=np.array([0.0, 3.0], dtype=np.float32),
    )
    is_on_table = np.ones(NUM_OBJECTS, dtype=bool)
    state = replace(state, robots=robots, decider=np.asarray(0, dtype=np.int32), is_on_table=is_on_table)
    draws = imagined(config, repeated(state, 8_000), random.keys_of(KEY, 8_000))
    # 2 s without transport have passed: an attempt that holds lasts longer with 1/2, one that misses all but surely.
    weights = WEIGHTS.copy()
    naive = naive_of(state, config)
    held = np.array([NAIVE_LAWS[1](naive.occluded(2), 1.5 * node)[0] for node in NODES])
    lasts_missed = 1.0 - norm.cdf((np.log(2.0) - np.log(4.0)) / 0.3)
    weights = naive.weights[2] * (held * 0.5 + (1.0 - held) * lasts_missed)
    weights /= weights.sum()
    still_held = held * 0.5 / (held * 0.5 + (1.0 - held) * lasts_missed)
    assert np.mean(draws.pending.is_held[:, 1]) == pytest.approx(weights @ still_held, abs=0.015)
    one, other = draws.grasp_latent
    assert np.mean(one[:, 2]) == pytest.approx(weights @ NODES, abs=0.03)
    np.testing.assert_allclose(other, 1.5 * one, rtol=1e-5, atol=1e-6)


def test_a_law_that_can_only_be_drawn_from_is_reported():
    world = world_of(None, Nudging())
    state, _ = start(world.played_config, first_layout(world), KEY)
    with pytest.raises(ArgumentError, match="grasping of the config is Nudging, which can be sampled but"):
        MyopicPolicy(world.played_config).q_values(state)
