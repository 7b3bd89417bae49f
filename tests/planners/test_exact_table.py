from dataclasses import replace
from functools import partial

import naive_planner
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from naive_optimum import BruteForce, hermite
from naive_planner import CONFIG, Cup

from fitted_laws import FITTED
from halfseen.arrays import record
from halfseen.errors import ArgumentError
from halfseen.planners import POMDPPolicy, information_relaxation_bound, relaxation, solve_table
from halfseen.world import AssumedGrasping, AssumedSeeing, Scene, UniformPolicy, WorldConfig, random
from halfseen.world.policy import surely
from halfseen.world.rollout import evaluate
from halfseen.world.state import pad_scenes
from tables import THREE, TWO, met_by_lot, rules_of, state_of

ALIKE = np.array([[0.0, 0.3], [0.3, 0.0]])
GRIPPED = Scene(TWO, grip=np.array([-1.0, 0.5]))
GRIPPED3 = Scene(THREE, grip=np.array([0.5, -1.5, 0.0]))
OTHER_WORLD = WorldConfig(
    dirty_share=0.4, reward_wash_clean=-4.0, grasping=AssumedGrasping(offset_std=0.7), reward_lift_per_s=-0.02
)
# Looks are cheap and clean cups dear, so that it pays to lift.
CAREFUL = replace(FITTED, reward_wash_clean=-20.0, reward_lift_per_s=-0.02)
GREEDY = rules_of(CONFIG)


@pytest.mark.parametrize(
    ("config", "scene", "horizon", "num_nodes"),
    [
        *((config, Scene(hides), h, 7) for config in (CONFIG, OTHER_WORLD) for hides in (TWO, ALIKE) for h in (1, 2)),
        *((config, GRIPPED, h, n) for config in (FITTED, CAREFUL) for h, n in ((1, 3), (2, 3), (3, 2))),
        *((config, GRIPPED3, 1, 2) for config in (FITTED, CAREFUL)),
        pytest.param(OTHER_WORLD, Scene(TWO), 3, 3, marks=pytest.mark.slow),
        pytest.param(OTHER_WORLD, Scene(THREE), 2, 2, marks=pytest.mark.slow),
        pytest.param(CAREFUL, GRIPPED3, 2, 2, marks=pytest.mark.slow),
    ],
)
def test_a_table_is_worth_what_brute_force_finds(config, scene, horizon, num_nodes):
    expected = BruteForce(config, scene, num_nodes).value(horizon)

    tolerance = 1e-12 if config in (FITTED, CAREFUL) else 1e-9
    assert solve_table(scene, config, horizon, num_nodes).value == pytest.approx(expected, abs=tolerance)


def test_one_cup_in_full_view_and_one_step():
    """The label is right in 4 of 5 cases; only a cup that is said to be dirty is worth washing."""
    missed = sum(weight * np.exp(-6.0 / np.exp(0.6 - offset)) for offset, weight in hermite(CONFIG, 7))
    caught = 1.0 - missed
    said_dirty, said_clean = 0.6 * 0.8 + 0.4 * 0.2, 0.6 * 0.2 + 0.4 * 0.8
    is_dirty, is_dirty_after_all = 0.6 * 0.8 / said_dirty, 0.6 * 0.2 / said_clean
    washed = caught * (5 * is_dirty - 10 * (1 - is_dirty)) + missed * (-1 - 5 * is_dirty)

    expected = said_dirty * washed + said_clean * -5 * is_dirty_after_all
    assert solve_table([[0.0]], CONFIG, 1).value == pytest.approx(expected, abs=1e-12)


@st.composite
def tables(draw, num_objects=3):
    shares = st.one_of(st.just(0.0), st.just(1.0), st.just(0.5), st.floats(0.0, 1.0))
    hides = draw(arrays(np.float64, (num_objects, num_objects), elements=shares))
    return hides * ~np.eye(num_objects, dtype=bool)


@pytest.mark.slow
@settings(max_examples=20, deadline=None, derandomize=True)
@given(hides=tables(), order=st.permutations(range(3)))
def test_the_order_of_the_cups_changes_nothing_and_nobody_beats_the_bound(hides, order):
    value = solve_table(hides, CONFIG, 2).value
    bound = information_relaxation_bound(hides, CONFIG, 2, num_grip_nodes=7)

    assert solve_table(hides[np.ix_(order, order)], CONFIG, 2).value == pytest.approx(value, abs=1e-9)
    assert value <= bound.value + 1e-9
    assert bound.standard_error == 0.0


def test_cups_apart_have_fewer_states_and_are_worth_more():
    """Each is seen at one occlusion only, so there is less to count."""
    apart, close = solve_table(np.zeros((3, 3)), CONFIG, 4), solve_table(THREE, CONFIG, 4)

    assert apart.num_states < close.num_states / 2
    assert apart.value > close.value


def test_a_step_more_is_never_a_loss():
    values = [solve_table(TWO, CONFIG, horizon).value for horizon in range(1, 8)]

    assert np.all(np.diff(values) > 0.0)
    # A scene is as good as its hides, and the horizon is the world's; one robot alone pays for no time.
    config = WorldConfig(horizon=3, reward_per_s=-1.0)
    assert solve_table(Scene(TWO), config).value == values[2]


@pytest.mark.parametrize(
    ("find", "arguments", "message"),
    [
        (solve_table, {"horizon": 0}, "horizon is 0"),
        (solve_table, {"horizon": 2, "num_grip_nodes": 0}, "num_grip_nodes is 0"),
        (solve_table, {"scene": np.zeros((0, 0))}, "objects is 0"),
        (solve_table, {"config": WorldConfig(dirty_share=1.0)}, "dirty_share is 1; it must lie strictly between"),
        (
            solve_table,
            {"config": WorldConfig(seeing=AssumedSeeing(floor=0.7))},
            "a label's probability of object 0 is 1; it must lie strictly between",
        ),
        (solve_table, {"horizon": 10, "max_states": 1000}, "2 objects over 10 steps have more than 1,000 .* shorten"),
        (information_relaxation_bound, {"horizon": 0}, "horizon is 0"),
        (information_relaxation_bound, {"num_samples": 1}, "num_samples is 1; give at least 2"),
        (information_relaxation_bound, {"num_grip_nodes": 0}, "num_grip_nodes is 0"),
        (information_relaxation_bound, {"reveals": "nothing"}, "reveals is 'nothing'; give one of looks, hidden, eve"),
        (information_relaxation_bound, {"scene": np.zeros((13, 13))}, "13 objects; the bound needs 1 to 12"),
    ],
)
def test_what_cannot_be_found_is_refused(find, arguments, message):
    with pytest.raises(ArgumentError, match=message):
        find(**{"scene": TWO, "config": CONFIG} | arguments)


@pytest.fixture(scope="module")
def played():
    """States along the way of somebody who acts by lot, on two cups over four steps."""
    return met_by_lot(WorldConfig(horizon=4), Scene(TWO), 16)


def cups_of(state):
    tried = zip(*map(np.asarray, (state.attempt_object, state.attempt_occlusion, state.attempt_succeeded)), strict=True)
    attempts = [(int(i), float(occluded), bool(is_grasped)) for i, occluded, is_grasped in tried]
    return [
        Cup(float(1 / (1 + np.exp(-log_odds))), tuple(one[1:] for one in attempts if one[0] == i), bool(is_there))
        for i, (log_odds, is_there) in enumerate(
            zip(np.asarray(state.log_odds), np.asarray(state.is_on_table), strict=True)
        )
    ]


def test_in_every_state_of_the_world_q_is_what_all_futures_say(played):
    optimum = solve_table(TWO, CONFIG, 4)
    states = [state for state in played if state.steps_to_go <= 2]

    assert len(states) > 10
    assert any(state.lifts.any() for state in states)
    assert any(not state.is_on_table.all() for state in states)
    for state in states:
        steps = int(state.steps_to_go)
        expected = naive_planner.q_values(cups_of(state), TWO, steps, depth=steps)
        np.testing.assert_allclose(optimum.q_values(state), expected, atol=2e-5)
        assert optimum.action(state) == np.argmax(optimum.q_values(state))


def test_a_state_of_another_table_or_another_horizon_is_refused(played):
    optimum = solve_table(TWO, CONFIG, 4)

    with pytest.raises(ArgumentError, match="5 steps to go; give a state of 2 objects with 1 to 4 steps"):
        optimum.q_values(replace(played[0], steps_to_go=np.asarray(5)))
    with pytest.raises(ArgumentError, match="attempt 1, on object -1, is not possible"):
        optimum.q_values(replace(played[0], steps_to_go=np.asarray(3)))
    with pytest.raises(ArgumentError, match=r"log-odds of object 0 are 0\.5, with 0 of it seen; .* differ by"):
        optimum.q_values(replace(played[0], log_odds=np.full(2, 0.5)))


@pytest.mark.parametrize(("config", "scene"), [(CONFIG, Scene(TWO)), (FITTED, GRIPPED)], ids=["assumed", "fitted"])
@pytest.mark.parametrize("k", range(4))
def test_the_value_of_a_rule_is_what_brute_force_finds(config, scene, k):
    policy = rules_of(config)[k]

    def choose(is_dirty, seen, there, attempts, steps):
        tried = [tuple(one[1:] for one in attempts if one[0] == i) for i in range(2)]
        cups = [Cup(is_dirty[i], tried[i], i in there, scene.grip[i], seen[i]) for i in range(2)]
        return int(policy.decide(state_of(cups, TWO, steps), random.key_of(0)).action)

    expected = BruteForce(config, scene, 3, choose).value(3)

    assert solve_table(scene, config, 3, num_grip_nodes=3).policy_value(policy) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("config", "scene", "slack"),
    [
        pytest.param(CONFIG, TWO, 0.0, marks=pytest.mark.slow),
        pytest.param(CONFIG, THREE, 0.0, marks=pytest.mark.slow),
        (FITTED, GRIPPED, 1e-9),
        (CAREFUL, GRIPPED, 1e-9),
    ],
)
def test_rules_and_planners_are_below_the_optimum_and_that_below_every_bound(config, scene, slack):
    optimum = solve_table(scene, config, 4)
    *by_rule, by_plan = optimum.policy_values([*rules_of(config), POMDPPolicy(config, 1)])
    bound = partial(information_relaxation_bound, scene, config, 4, num_grip_nodes=3)

    assert max(by_rule) < by_plan + slack < optimum.value + 2 * slack
    assert optimum.value < bound(reveals="looks").value < bound(reveals="hidden").value
    assert optimum.regret(rules_of(config)[0]) == pytest.approx(optimum.value - by_rule[0], abs=1e-12)


@record
class AlwaysWashTheFirst:
    def decide(self, state, key):
        return surely(np.ones(state.is_on_table.shape[:-1], dtype=np.int32))


@pytest.mark.parametrize("max_states", [None, 3])
def test_several_policies_are_worth_what_each_is_by_itself_for_the_draws_of_the_key(max_states):
    optimum, key = solve_table(TWO, CONFIG, 3, num_grip_nodes=3), random.key_of(4)
    policies = (*GREEDY[:2], UniformPolicy(), GREEDY[3])
    alone = [optimum.policy_value(each, key, max_states) for each in policies]
    np.testing.assert_allclose(optimum.policy_values(policies, key, max_states), alone, rtol=1e-12)
    assert len(set(alone)) > 2
    assert max_states or max(alone) < optimum.value
    assert optimum.policy_value(UniformPolicy(), random.key_of(0), max_states) != alone[2]


@pytest.mark.parametrize(
    ("policies", "max_states", "message"),
    [
        ([], None, "policies is empty; give at least one"),
        ([AlwaysWashTheFirst()], None, r"policy chose action 1 with objects \[1\] on the table"),
        ([UniformPolicy()], 0, "max_states is 0; give at least 1"),
    ],
)
def test_what_has_no_value_is_refused(policies, max_states, message):
    with pytest.raises(ArgumentError, match=message):
        solve_table(TWO, CONFIG, 2).policy_values(policies, max_states=max_states)


def enumerated_hidden_bound(hides, horizon, num_nodes):
    """Mean over everything hidden of what one who knows it earns, by plain recursion."""
    brute = BruteForce(CONFIG, Scene(hides), num_nodes)

    def value(dirty, grip, there, steps):
        left = sum(CONFIG.reward_dirty_left for i in there if dirty[i])
        if steps == 0:
            return left
        q = [left]
        for i in there:
            caught = 1 - naive_planner.failure(brute.occlusion(there, i), grip[i])
            won = (5 if dirty[i] else -10) + value(dirty, grip, there - {i}, steps - 1)
            q.append(caught * won + (1 - caught) * (-1 + value(dirty, grip, there, steps - 1)))
        return max(q)

    everyone = frozenset(range(len(hides)))
    worth = [value(*known, everyone, horizon) for known in zip(brute.dirty, brute.offset, strict=True)]
    return brute.prior @ worth


@pytest.mark.parametrize(("hides", "horizon"), [(TWO, 4), (THREE, 3)], ids=["two", "three"])
def test_who_knows_what_is_hidden_earns_what_plain_recursion_finds(hides, horizon):
    bound = information_relaxation_bound(hides, CONFIG, horizon, num_grip_nodes=3, reveals="hidden")

    assert bound == (pytest.approx(enumerated_hidden_bound(hides, horizon, 3), abs=1e-9), 0.0)


@pytest.mark.parametrize("reveals", ["looks", "hidden"])
def test_a_bound_from_draws_agrees_with_the_exact_one(monkeypatch, reveals):
    bound = partial(information_relaxation_bound, TWO, CONFIG, 4, num_grip_nodes=3, reveals=reveals)
    exact = bound()
    monkeypatch.setattr(relaxation, "MAX_ENUMERATED", 0)
    drawn = bound(num_samples=40_000)

    assert exact.standard_error == 0.0
    assert 0.0 < drawn.standard_error < 0.03
    assert drawn.value == pytest.approx(exact.value, abs=4 * drawn.standard_error)


def test_who_knows_the_times_of_grasps_too_earns_more():
    bound = partial(information_relaxation_bound, TWO, CONFIG, 4, num_samples=40_000)
    by_looks, by_hidden, by_everything = (bound(reveals=reveals) for reveals in ("looks", "hidden", "everything"))

    assert by_looks.value < by_hidden.value < by_everything.value
    assert bound() == by_looks != bound(seed=1)


def test_who_knows_that_a_grasp_will_fail_lifts_to_wait_where_that_is_free():
    config = WorldConfig(grasping=AssumedGrasping(limit_s=1.0), reward_lift_per_s=0.0)
    bound = information_relaxation_bound([[0.0]], config, 2, 40_000, num_grip_nodes=1, reveals="everything")
    both_fail = np.exp(-2.0 / np.exp(0.6))

    assert bound.value == pytest.approx(0.6 * (5 - 10 * both_fail), abs=4 * bound.standard_error)
    assert bound.standard_error < 0.025


def test_with_one_label_that_is_all_there_is_and_a_sure_grasp_the_bound_by_looks_is_the_optimum():
    """In full view, with one step, the look that is named is the look that is taken."""
    config, table = WorldConfig(grasping=AssumedGrasping(offset_std=0.0)), np.zeros((2, 2))

    bound = information_relaxation_bound(table, config, 1, num_grip_nodes=1)
    assert bound.value == pytest.approx(solve_table(table, config, 1, num_grip_nodes=1).value, abs=1e-12)


SURE = WorldConfig(grasping=AssumedGrasping(limit_s=1e6))


def test_grasps_that_never_fail_are_worth_what_brute_force_finds():
    assert solve_table(TWO, SURE, 2).value == pytest.approx(BruteForce(SURE, Scene(TWO), 7).value(2), abs=1e-9)


def test_the_bound_by_looks_of_labels_that_never_err_washes_every_dirty_cup():
    known = replace(SURE, seeing=AssumedSeeing(gain=0.5))
    assert information_relaxation_bound([[0.0]], known, 2, num_grip_nodes=7).value == pytest.approx(0.6 * 5)


def test_the_more_grip_offsets_the_nearer_is_the_world_whose_offsets_are_normal():
    values = [solve_table(TWO, CONFIG, 5, num_nodes).value for num_nodes in (3, 7, 15, 31, 63)]

    assert values[2:4] == pytest.approx([values[4]] * 2, abs=1e-4)
    assert 0.02 > abs(values[1] - values[4]) > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("config", "scene", "num", "most", "who"),
    [
        *((CONFIG, Scene(THREE), 150_000, 0.05, who) for who in ("greedy", "history", "pomdp", "lot")),
        *((FITTED, GRIPPED3, 100_000, 0.06, who) for who in ("greedy", "history", "pomdp")),
    ],
)
def test_a_policy_earns_in_the_world_what_it_is_worth(config, scene, num, most, who):
    rules, by_lot = rules_of(config), who == "lot"
    others = {"greedy": rules[1], "history": rules[3], "pomdp": POMDPPolicy(config, 1), "lot": UniformPolicy()}
    policy, layouts = others[who], pad_scenes([scene])
    earned = evaluate(replace(config, horizon=4), layouts, policy, random.key_of(0), num).reward
    rewards = np.asarray(earned, dtype=np.float64)
    optimum = solve_table(scene, config, 4, num_grip_nodes=31)
    worth = [optimum.policy_value(policy, random.key_of(seed)) for seed in range(80 if by_lot else 1)]

    error = np.hypot(rewards.std() / np.sqrt(len(rewards)), np.std(worth) / np.sqrt(len(worth)))
    assert rewards.mean() == pytest.approx(np.mean(worth), abs=4 * error)
    assert error < (0.08 if by_lot else most)


@pytest.mark.slow
def test_three_cups_over_seven_steps_fit_and_no_planner_is_better_on_five():
    longest, five = solve_table(THREE, CONFIG, 7), solve_table(THREE, CONFIG, 5)
    planned = [five.policy_value(POMDPPolicy(CONFIG, horizon, 32)) for horizon in (1, 2)]

    assert longest.num_states < 30_000_000
    assert planned[0] < planned[1] < five.value < longest.value
    assert five.value < information_relaxation_bound(THREE, CONFIG, 5, num_grip_nodes=7).value
