import numpy as np
import pytest
from naive_optimum import BruteForce, hermite
from naive_planner import CONFIG

from halfseen.errors import ArgumentError
from halfseen.planners import GreedyPolicy
from halfseen.planners.optimum import solve_table
from halfseen.world import Scene, WorldConfig

TWO = np.array([[0.0, 0.6], [0.1, 0.0]])
ALIKE = np.array([[0.0, 0.3], [0.3, 0.0]])
THREE = np.array([[0.0, 0.6, 0.3], [0.1, 0.0, 0.2], [0.4, 0.05, 0.0]])
OTHER_WORLD = WorldConfig(dirty_share=0.4, reward_wash_clean=-4.0, grip_offset_std=0.7, reward_lift_per_s=-0.02)
GREEDY = [GreedyPolicy(CONFIG, uses_history=h, counts_penalty=p) for h in (False, True) for p in (False, True)]


@pytest.mark.parametrize("config", [CONFIG, OTHER_WORLD], ids=["this world", "another"])
@pytest.mark.parametrize("hides", [TWO, ALIKE], ids=["two", "two alike"])
@pytest.mark.parametrize("horizon", [1, 2])
def test_two_cups_are_worth_what_brute_force_finds(config, hides, horizon):
    expected = BruteForce(config, hides, 7).value(horizon)

    assert solve_table(hides, config, horizon).value == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(("hides", "horizon", "num_nodes"), [(TWO, 3, 3), (THREE, 2, 2)], ids=["3 steps", "3 cups"])
def test_more_steps_and_more_cups_are_worth_what_brute_force_finds(hides, horizon, num_nodes):
    expected = BruteForce(OTHER_WORLD, hides, num_nodes).value(horizon)

    assert solve_table(hides, OTHER_WORLD, horizon, num_nodes).value == pytest.approx(expected, abs=1e-9)


def test_one_cup_in_full_view_and_one_step():
    """The label is right in 4 of 5 cases; only a cup that is said to be dirty is worth washing."""
    missed = sum(weight * np.exp(-6.0 / np.exp(0.6 - offset)) for offset, weight in hermite(CONFIG, 7))
    caught = 1.0 - missed
    said_dirty, said_clean = 0.6 * 0.8 + 0.4 * 0.2, 0.6 * 0.2 + 0.4 * 0.8
    is_dirty, is_dirty_after_all = 0.6 * 0.8 / said_dirty, 0.6 * 0.2 / said_clean
    washed = caught * (5 * is_dirty - 10 * (1 - is_dirty)) + missed * (-1 - 5 * is_dirty)

    expected = said_dirty * washed + said_clean * -5 * is_dirty_after_all
    assert solve_table([[0.0]], CONFIG, 1).value == pytest.approx(expected, abs=1e-12)


def test_the_order_of_the_cups_changes_nothing():
    order = [2, 0, 1]
    shuffled = THREE[np.ix_(order, order)]

    assert solve_table(shuffled, CONFIG, 3).value == pytest.approx(solve_table(THREE, CONFIG, 3).value, abs=1e-12)


def test_a_step_more_is_never_a_loss():
    values = [solve_table(TWO, CONFIG, horizon).value for horizon in range(1, 8)]

    assert np.all(np.diff(values) > 0.0)


def test_a_scene_is_as_good_as_its_hides_and_the_horizon_is_the_worlds():
    config = WorldConfig(horizon=3)

    assert solve_table(Scene(TWO), config).value == solve_table(TWO, config, 3).value


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"horizon": 0}, "horizon is 0"),
        ({"horizon": 2, "num_grip_nodes": 0}, "num_grip_nodes is 0"),
        ({"horizon": 10, "max_states": 1000}, "2 objects over 10 steps have more than 1,000 states .* shorten"),
    ],
)
def test_what_cannot_be_solved_is_refused(arguments, message):
    with pytest.raises(ArgumentError, match=message):
        solve_table(TWO, CONFIG, **arguments)
