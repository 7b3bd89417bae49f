"""A plan finds the optimum, nobody beats it, and the names of the cups do not matter."""

from dataclasses import replace
from functools import partial
from itertools import product

import numpy as np
import pytest

from halfseen.planners import POMDPPolicy, information_relaxation_bound, plan, solve_table
from halfseen.planners.exact_policies import Reached, drawn
from halfseen.world import Scene, UniformPolicy, WorldConfig, random
from halfseen.world.rollout import play
from halfseen.world.state import initial_state, pad_scenes
from picked import picked
from tables import THREE, TWO, rules_of
from world.world_cases import permuted

CONFIG = WorldConfig(horizon=2)
GREEDY = rules_of(CONFIG)
KEY = random.key_of(0)


def state_after_first_look(config, hides, labels):
    """What a policy is shown once each cup was labelled."""
    layouts = pad_scenes([Scene(hides)])
    fresh = initial_state(config, picked(layouts, 0))
    right = config.seeing.floor + config.seeing.gain * (1 - Scene(hides).occlusion) ** config.seeing.power
    update = np.where(labels, 1.0, -1.0) * (np.log(right) - np.log1p(-right))
    return replace(fresh, log_odds=fresh.log_odds + np.asarray(update, dtype=np.float32))


@pytest.mark.parametrize("labels", list(product([False, True], repeat=2)), ids=str)
@pytest.mark.slow
def test_the_anytime_planner_finds_the_optimum_of_two_cups(labels):
    """With two steps, one improvement of the myopic rule is the optimum: the rule is exact at the last step.

    Grip offsets are normal for the one and on a fine grid for the other.
    """
    state = state_after_first_look(CONFIG, TWO, labels)
    exact = solve_table(TWO, CONFIG, num_grip_nodes=31).q_values(state)
    found = plan(CONFIG, state, KEY, num_simulations=20_000)

    assert found.action == np.argmax(exact)
    assert found.values.max() == pytest.approx(exact.max(), abs=0.08)


@pytest.fixture(scope="module")
def states():
    """Along the way of somebody who acts by lot on three cups, over four steps."""
    config = replace(CONFIG, horizon=4)
    played = play(config, pad_scenes([Scene(THREE)]), UniformPolicy(), random.key_of(3), 12)
    return picked(played.states, np.asarray(played.is_taken))


@pytest.mark.parametrize(
    "policy", [GREEDY[0], GREEDY[3], POMDPPolicy(CONFIG, 1)], ids=["greedy", "history", "one step ahead"]
)
def test_names_of_cups_do_not_matter_to_who_plans_without_chance(states, policy):
    keys = random.keys_of(KEY, len(states.steps_to_go))
    order = np.array([2, 0, 1])
    plain, renamed = (policy.decide(of, keys).action for of in (states, permuted(states, order)))

    of_action = np.array([0, *(1 + np.argsort(order)), *(4 + np.argsort(order))])
    np.testing.assert_array_equal(renamed, of_action[plain])
    assert len(set(plain.tolist())) > 2


def ordered(seed, policies_of, horizon=3):
    """What policies earn on a random table in a random world, its optimum and a bound on that."""
    rng = np.random.default_rng(seed)
    hides = rng.uniform(0.0, 0.9, (3, 3)) * (rng.random((3, 3)) < 0.6) * ~np.eye(3, dtype=bool)
    dirty_share, wash_clean = rng.uniform(0.3, 0.8), rng.uniform(-12.0, -2.0)
    config = replace(CONFIG, horizon=horizon, dirty_share=dirty_share, reward_wash_clean=wash_clean)
    optimum = solve_table(hides, config)
    bound = information_relaxation_bound(hides, config, num_samples=4000, seed=seed, num_grip_nodes=7)
    return [optimum.policy_value(policy) for policy in policies_of(config)], optimum.value, bound


@pytest.mark.parametrize("seed", range(4))
def test_nobody_is_above_the_optimum_and_that_is_below_the_bound(seed):
    earned, optimum, bound = ordered(seed, lambda config: [replace(GREEDY[3], config=config), POMDPPolicy(config, 1)])

    assert max(earned) <= optimum + 1e-9
    assert optimum <= bound.value + 3 * bound.standard_error
    # Nor are they in that order only because they are far apart.
    assert max(earned) > optimum - 1.0


@pytest.mark.slow
def test_not_even_who_looks_far_ahead_is_above_the_optimum():
    earned, optimum, _ = ordered(0, lambda config: [POMDPPolicy(config, h) for h in (2, 3)])

    assert max(earned) <= optimum + 1e-9
    assert min(earned) > optimum - 0.3


def test_some_states_stand_for_all_on_average():
    mass = np.random.default_rng(0).dirichlet(np.full(100, 0.3))
    reached = Reached(np.repeat([0, 3], [40, 60]), np.arange(100), mass[None])
    worth = np.random.default_rng(1).normal(size=100)
    lots = [drawn(reached, 20, random.key_of(seed)) for seed in range(400)]

    values = [lot.mass[0] @ worth[lot.cell] for lot in lots]
    assert {len(lot.cell) for lot in lots} == {20}
    np.testing.assert_allclose([lot.mass.sum() for lot in lots], 1.0, atol=1e-9)
    assert all(np.all(lot.place == np.where(lot.cell < 40, 0, 3)) for lot in lots)
    assert np.mean(values) == pytest.approx(mass @ worth, abs=float(4 * np.std(values) / 20))
    # The likely ones are always there, with their own mass.
    likely = np.flatnonzero(mass > 1 / 20)
    assert len(likely) >= 3
    for lot in lots:
        assert np.isin(likely, lot.cell).all()
        np.testing.assert_array_equal(lot.mass[0, np.isin(lot.cell, likely)], mass[likely])


def test_what_a_policy_keeps_does_not_depend_on_whom_it_is_drawn_with():
    mass = np.random.default_rng(0).dirichlet(np.full(100, 0.3), size=2)
    mass[0, 50:] = 0.0
    together = drawn(Reached(np.zeros(100, dtype=int), np.arange(100), mass), 20, KEY)
    for k in range(2):
        alone = drawn(Reached(np.zeros(100, dtype=int), np.arange(100), mass[[k]]), 20, KEY)
        own = together.mass[k] > 0
        np.testing.assert_array_equal(together.cell[own], alone.cell)
        np.testing.assert_array_equal(together.mass[k, own], alone.mass[0])
    assert np.all(together.cell[together.mass[0] > 0] < 50)


@pytest.mark.slow
@pytest.mark.parametrize(("asked", "most"), [(GREEDY[1], 0.2), (UniformPolicy(), 1.2)], ids=["greedy", "lot"])
def test_a_policy_asked_in_some_states_is_valued_right_on_average(asked, most):
    optimum = solve_table(THREE, CONFIG, 4)
    policy = partial(optimum.policy_value, asked)
    exact, lots = policy(), [policy(random.key_of(seed), 24) for seed in range(30)]

    assert policy(max_states=10**6) == pytest.approx(exact, abs=1e-12)
    assert np.mean(lots) == pytest.approx(exact, abs=float(4 * np.std(lots) / np.sqrt(30)))
    assert 0.0 < np.std(lots) < most


@pytest.mark.parametrize("order", [[2, 0, 1], [1, 0, 2]])
@pytest.mark.slow
def test_names_of_cups_do_not_matter_to_optimum_and_bound(states, order):
    config = replace(CONFIG, horizon=4)
    plain, renamed = (solve_table(hides, config, num_grip_nodes=3) for hides in (THREE, THREE[np.ix_(order, order)]))
    of_action = [0, *(1 + np.array(order)), *(4 + np.array(order))]

    assert renamed.value == pytest.approx(plain.value, abs=1e-10)
    assert renamed.num_states == plain.num_states
    other = permuted(states, order)
    for k in range(len(states.steps_to_go)):
        q, q_renamed = (optimum.q_values(picked(of, k)) for optimum, of in ((plain, states), (renamed, other)))
        np.testing.assert_allclose(q_renamed, q[of_action], atol=1e-9)
    for reveals in ("looks", "hidden"):
        bounds = [
            information_relaxation_bound(hides, config, num_grip_nodes=3, reveals=reveals)
            for hides in (THREE, THREE[np.ix_(order, order)])
        ]
        assert bounds[0].standard_error == bounds[1].standard_error == 0.0
        assert bounds[0].value == pytest.approx(bounds[1].value, abs=1e-10)


@pytest.mark.slow
def test_names_of_cups_do_not_matter_to_what_a_plan_with_chance_is_worth():
    """Draws differ with the names, so values agree within their noise."""
    config = replace(CONFIG, horizon=3)
    optima = [solve_table(hides, config) for hides in (THREE, THREE[::-1, ::-1])]
    values = np.array(
        [[one.policy_value(POMDPPolicy(config, 2, 32), random.key_of(k)) for k in range(6)] for one in optima]
    )

    error = np.hypot(*(values.std(axis=1, ddof=1) / np.sqrt(6)))
    assert values[0].mean() == pytest.approx(values[1].mean(), abs=float(4 * error))
    assert error < 0.05
