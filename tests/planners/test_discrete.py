import numpy as np
import pytest

from halfseen.errors import ArgumentError
from halfseen.planners import discrete, solve_discrete

LISTEN, OPEN_LEFT, OPEN_RIGHT = range(3)
TIGER = (
    np.array([np.eye(2), np.full((2, 2), 0.5), np.full((2, 2), 0.5)]),
    np.array([[[0.85, 0.15], [0.15, 0.85]], np.full((2, 2), 0.5), np.full((2, 2), 0.5)]),
    np.array([[-1.0, -1.0], [-100.0, 10.0], [10.0, -100.0]]),
)


def random_problem(seed, num_actions=2, num_states=3, num_observations=2):
    rng = np.random.default_rng(seed)
    T = rng.dirichlet(np.ones(num_states), size=(num_actions, num_states))
    O = rng.dirichlet(np.ones(num_observations), size=(num_actions, num_states))  # noqa: E741
    return T, O, rng.normal(size=(num_actions, num_states)), rng.dirichlet(np.ones(num_states))


def by_enumeration(T, O, R, discount, horizon, belief):  # noqa: E741
    """Every action and every observation, forwards from one belief."""
    if horizon == 0:
        return 0.0, None
    values = []
    for a in range(len(R)):
        value = R[a] @ belief
        for o in range(O.shape[2]):
            joint = (belief @ T[a]) * O[a][:, o]
            if joint.sum() > 0:
                after = by_enumeration(T, O, R, discount, horizon - 1, joint / joint.sum())[0]
                value += discount * joint.sum() * after
        values.append(value)
    return max(values), int(np.argmax(values))


def test_tiger_has_its_published_values():
    values = [solve_discrete(*TIGER, 0.95, horizon, [0.5, 0.5]).value for horizon in (1, 2, 3)]
    np.testing.assert_allclose(values, [-1.0, -1.95, 2.3098], atol=5e-5)


def test_tiger_listens_until_it_is_sure():
    solution = solve_discrete(*TIGER, 0.95, 3, [0.5, 0.5])
    assert solution.action == LISTEN
    assert solution.action_of([0.97, 0.03], steps_to_go=1) == OPEN_RIGHT
    assert solution.action_of([0.03, 0.97], steps_to_go=1) == OPEN_LEFT


@pytest.mark.parametrize("seed", range(6))
def test_agrees_with_enumeration(seed):
    T, O, R, belief = random_problem(seed, num_actions=2 + seed % 2, num_observations=2 + seed % 3)  # noqa: E741
    for horizon in (1, 2, 3):
        solution = solve_discrete(T, O, R, 0.9, horizon, belief)
        value, action = by_enumeration(T, O, R, 0.9, horizon, belief)
        assert solution.value == pytest.approx(value, abs=1e-9)
        assert solution.action == action


def test_one_solution_serves_every_belief_and_every_number_of_steps():
    T, O, R, _ = random_problem(0)  # noqa: E741
    solution = solve_discrete(T, O, R, 1.0, 3, [1.0, 0.0, 0.0])
    for belief in np.random.default_rng(1).dirichlet(np.ones(3), size=10):
        for steps in (1, 2, 3):
            value, action = by_enumeration(T, O, R, 1.0, steps, belief)
            assert solution.value_of(belief, steps) == pytest.approx(value, abs=1e-9)
            assert solution.action_of(belief, steps) == action


def test_states_that_are_seen_are_a_decision_process():
    T, _, R, belief = random_problem(3)
    value = np.zeros(3)
    for _ in range(4):
        value = (R + 0.8 * T @ value).max(axis=0)
    seen = np.broadcast_to(np.eye(3), (2, 3, 3))
    first = (R @ belief + 0.8 * (belief @ T) @ value).max()
    assert solve_discrete(T, seen, R, 0.8, 5, belief).value == pytest.approx(first, abs=1e-9)


def test_pruning_keeps_only_what_is_best_somewhere():
    vectors = np.array([[1.0, 0.0], [0.0, 1.0], [0.4, 0.4], [0.6, 0.6], [0.6, 0.6], [0.9, 0.0]])
    np.testing.assert_array_equal(discrete.pruned(vectors), [[1.0, 0.0], [0.0, 1.0], [0.6, 0.6]])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"T": TIGER[0][:2]}, r"T has shape \(2, 2, 2\); R of shape \(3, 2\) needs \(3, 2, 2\)"),
        ({"T": TIGER[0] * 0.9}, r"T\[0, 0\] sums to 0.9; give probabilities that sum to 1"),
        ({"O": TIGER[1] * [-1.0, 1.0]}, r"O\[0, 0, 0\] is -0.85; give probabilities ≥ 0"),
        ({"R": np.where(TIGER[2] == 10.0, np.nan, TIGER[2])}, r"R\[1, 1\] is nan; give a finite number"),
        ({"R": [1.0, 2.0]}, r"R has shape \(2,\); give 2 axes"),
        ({"initial_belief": [0.5, 0.6]}, r"initial_belief sums to 1.1"),
        ({"discount": 1.5}, r"discount is 1.5; give a number in \(0, 1\]"),
        ({"horizon": 0}, "horizon is 0; give at least 1"),
    ],
)
def test_what_is_no_problem_is_refused(change, says):
    good = dict(zip("TOR", TIGER, strict=True)) | {"discount": 0.95, "horizon": 2, "initial_belief": [0.5, 0.5]}
    with pytest.raises(ArgumentError, match=says):
        solve_discrete(**good | change)


def test_steps_beyond_the_horizon_are_refused():
    with pytest.raises(ArgumentError, match="steps_to_go is 3; give 1 to the horizon, 2"):
        solve_discrete(*TIGER, 0.95, 2, [0.5, 0.5]).value_of([0.5, 0.5], steps_to_go=3)


@pytest.mark.parametrize("unit", [1e-300, 1e-12, 1e-6, 1e6, 1e12])
def test_the_unit_of_rewards_changes_no_choice(unit):
    for seed in range(5):
        T, O, R, belief = random_problem(seed)  # noqa: E741
        value, action = by_enumeration(T, O, R, 1.0, 3, belief)
        found = solve_discrete(T, O, unit * R, 1.0, 3, belief)
        assert found.value / unit == pytest.approx(value, rel=1e-8)
        assert found.action == action


@pytest.mark.parametrize("belief", [[1.0, 1.0], [1.5, -0.5], [np.nan, 1.0], [0.5, 0.25, 0.25]])
def test_a_belief_that_is_no_distribution_is_refused(belief):
    solution = solve_discrete(*TIGER, 0.95, 2, [0.5, 0.5])
    for ask in (solution.value_of, solution.action_of):
        with pytest.raises(ArgumentError, match="give each of 2 states a probability, 1 in all"):
            ask(belief)
