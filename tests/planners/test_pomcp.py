import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import naive_planner
import numpy as np
import pytest
from naive_planner import CONFIG, Cup

from halfseen.errors import ArgumentError
from halfseen.planners import TableProblem, plan, solve_discrete
from halfseen.planners.belief import belief_of
from halfseen.planners.one_step import one_step_q
from tables import state_of

sys.path.insert(0, str(Path(__file__).parents[2] / "examples"))
from tiger import TigerProblem

T = [[[1, 0], [0, 1]], [[0.5, 0.5]] * 2, [[0.5, 0.5]] * 2]
O = [[[0.85, 0.15], [0.15, 0.85]], [[1.0, 0.0]] * 2, [[1.0, 0.0]] * 2]  # noqa: E741
R = [[-1, -1], [-100, 10], [10, -100]]
HIDES = np.array([[0.0, 0.6], [0.1, 0.0]])
CUPS = [Cup(0.85, ((0.6, False), (0.6, True))), Cup(0.4, ((0.1, False),))]
TABLE = TableProblem(CONFIG, state_of(CUPS, HIDES, steps_to_go=7))
KEY = jax.random.key(0)


def plan_tiger(problem, num_simulations, seed=0, **options):
    key = jax.random.key(seed)
    return plan(problem, key, num_simulations=num_simulations, exploration=100.0, **options)


@pytest.mark.parametrize("horizon", [2, 3, 4])
@pytest.mark.parametrize("left_chance", [0.5, 0.15, 0.999])
def test_the_tiger_is_planned_as_the_exact_optimum_is(horizon, left_chance):
    belief = [left_chance, 1 - left_chance]
    exact = solve_discrete(T, O, R, 0.95, horizon, belief)
    found = plan_tiger(TigerProblem(left_chance, horizon=horizon), 20_000)

    assert found.was_searched
    assert found.depth == horizon
    assert found.action == exact.action
    assert found.value == pytest.approx(exact.value, abs=4 * found.standard_errors[found.action] + 0.05)
    assert found.standard_errors[found.action] < 0.3


def test_more_simulations_come_closer_to_the_optimum():
    exact = solve_discrete(T, O, R, 0.95, 3, [0.5, 0.5]).value
    errors = {
        num: np.mean([abs(plan_tiger(TigerProblem(), num, seed).value - exact) for seed in range(8)])
        for num in (100, 10_000)
    }
    assert errors[10_000] < 0.5 * errors[100]


def test_particles_stand_for_the_belief():
    known_left = jnp.zeros(50, dtype=jnp.int32)
    found = plan_tiger(TigerProblem(horizon=1), 1000, particles=known_left)
    assert found.action == 2
    # The rule's −45 still counts as one of some five hundred tries.
    assert found.value == pytest.approx(10.0, abs=0.2)


@pytest.mark.parametrize("problem", [TigerProblem(), TABLE], ids=["tiger", "table"])
def test_the_same_key_and_number_give_the_same_plan(problem):
    first, again, other = (plan(problem, jax.random.key(seed), num_simulations=300) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first.values, again.values)
    np.testing.assert_array_equal(first.num_tries, again.num_tries)
    assert not np.array_equal(first.values, other.values)


def test_the_clock_decides_nothing_but_the_number():
    plan(TABLE, KEY, num_simulations=1)
    timed = plan(TABLE, KEY, budget_s=0.05)
    counted = plan(TABLE, KEY, num_simulations=timed.num_simulations)
    np.testing.assert_array_equal(timed.values, counted.values)
    assert timed.num_simulations > 4


@pytest.mark.parametrize("problem", [TigerProblem(), TABLE], ids=["tiger", "table"])
def test_what_was_not_searched_says_so_and_is_the_rule(problem):
    found = plan(problem, KEY, num_simulations=0)
    rule = problem.rule_values(problem.initial_state(KEY))

    assert not found.was_searched
    assert found.num_simulations == found.depth == 0
    assert found.action == int(jnp.argmax(rule))
    assert np.isinf(found.standard_errors).all()
    assert plan(problem, KEY, num_simulations=50).was_searched


def test_a_budget_that_is_gone_at_once_searches_nothing():
    assert not plan(TABLE, KEY, budget_s=1e-9).was_searched


def test_counts_add_up_and_impossible_actions_are_left_out():
    cups = [Cup(0.9, ((0.6, False),)), Cup(0.6, ((0.1, True),), is_on_table=False)]
    found = plan(TableProblem(CONFIG, state_of(cups, HIDES, 5)), KEY, num_simulations=500)

    assert found.num_tries.sum() == found.num_simulations == 500
    assert (found.num_tries[[0, 1, 3]] > 0).all()
    assert (found.num_tries[[2, 4]] == 0).all()
    assert np.isneginf(found.values[[2, 4]]).all()


def test_a_full_tree_is_refined_and_grows_no_further():
    found = plan(TABLE, KEY, num_simulations=500, max_nodes=101)
    assert found.num_nodes == 101
    assert plan(TABLE, KEY, num_simulations=500).num_nodes > 101
    assert found.num_tries.sum() == 500


def test_at_the_last_step_the_rule_is_exact_and_the_search_agrees():
    state = state_of(CUPS, HIDES, steps_to_go=1)
    found = plan(TableProblem(CONFIG, state), KEY, num_simulations=200)
    np.testing.assert_allclose(found.values, one_step_q(CONFIG, belief_of(CONFIG, state)), atol=1e-3)
    assert found.depth == 1


def test_names_of_objects_do_not_matter():
    found = plan(TABLE, KEY, num_simulations=2000)
    swapped = plan(
        TableProblem(CONFIG, state_of(CUPS[::-1], HIDES[::-1, ::-1], steps_to_go=7)), KEY, num_simulations=2000
    )
    order = [0, 2, 1, 4, 3]
    assert swapped.action == order.index(found.action)
    np.testing.assert_allclose(swapped.value, found.value, atol=0.3)


def test_padding_of_nan_is_never_tried():
    found = plan(TableProblem(CONFIG, state_of(CUPS, HIDES, 7, num_padding=1)), KEY, num_simulations=200)
    assert np.isfinite(found.values[[0, 1, 2, 4, 5]]).all()
    assert (found.num_tries[[3, 6]] == 0).all()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({}, "give one of the two"),
        ({"budget_s": 1.0, "num_simulations": 3}, "give one of the two"),
        ({"budget_s": 0.0}, "budget_s is 0.0"),
        ({"num_simulations": -1}, "num_simulations is -1"),
        ({"num_simulations": 1, "exploration": float("nan")}, "exploration is nan"),
        ({"num_simulations": 1, "rule_weight": 0.0}, "rule_weight is 0.0"),
        ({"num_simulations": 1, "max_nodes": 0}, "max_nodes is 0"),
    ],
)
def test_a_wrong_number_is_refused(options, said):
    with pytest.raises(ArgumentError, match=said):
        plan(TigerProblem(), KEY, **options)


def test_simulations_as_deep_as_allowed_are_worth_the_rule_there():
    found = plan(TABLE, KEY, num_simulations=20_000, max_depth=1)
    expected = naive_planner.q_values(CUPS, HIDES, int(TABLE.seen.steps_to_go), depth=2)
    np.testing.assert_allclose(found.values, expected, atol=0.06)
    assert found.depth == 1
    assert found.num_tries.sum() == 20_000
