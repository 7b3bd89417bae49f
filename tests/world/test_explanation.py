import json
from dataclasses import replace

import numpy as np
import pytest

from halfseen.errors import ArgumentError
from halfseen.world import Scene, WorldConfig
from halfseen.world.explanation import alike, explained
from halfseen.world.state import initial_state, pad_scenes
from picked import picked

# FINISH, WASH 0, WASH 1, LIFT 0, LIFT 1
VALUES = np.array([0.0, 1.0, -2.0, 1.5, 0.5])
ALL = np.ones(5, dtype=bool)
ONE_IS_GONE = np.array([True, True, False, True, False])


def normal_draws(num_draws=20_000, sd=0.5):
    return VALUES + sd * np.random.default_rng(0).standard_normal((num_draws, 5))


def test_chances_and_intervals_of_normal_draws_are_those_of_the_formula():
    two = [0, 2]
    draws = normal_draws()[:, [0, 1, 3]]
    result = explained(VALUES[[0, 1, 3]], draws, ALL[:3], level=0.8)
    # LIFT leads WASH by 0.5 with standard deviation 0.5 √2; FINISH hardly ever wins.
    assert result.probability_best[2] == pytest.approx(0.76, abs=0.015)
    assert result.probability_best.sum() == pytest.approx(1.0)
    np.testing.assert_allclose(result.high[two] - result.values[two], 1.2816 * 0.5, atol=0.02)
    np.testing.assert_allclose(result.values[two] - result.low[two], 1.2816 * 0.5, atol=0.02)
    assert result.lift_worth == pytest.approx([0.5])
    assert result.lift_low[0] < 0.0 < result.lift_worth[0] < result.lift_high[0]


def test_what_is_common_to_all_actions_is_no_doubt_of_which_is_best():
    common = 10.0 * np.random.default_rng(0).standard_normal((500, 1))
    result = explained(VALUES, VALUES + common, ALL)
    np.testing.assert_array_equal(result.probability_best, [0, 0, 0, 1, 0])
    np.testing.assert_allclose(result.lift_high - result.lift_low, 0.0, atol=1e-9)
    assert (result.high - result.low > 20.0).all()


def test_actions_that_tie_are_all_best():
    draws = np.array([[0.0, 1.0, 1.0 + 1e-9, 0.2, 1.0], [2.0, 1.0, 1.0, 0.2, 1.0]])
    result = explained(VALUES, draws, ALL)
    np.testing.assert_array_equal(result.probability_best, [0.5, 0.5, 0.5, 0.0, 0.5])
    assert result.probability_stop_is_right == 0.5


def test_what_is_impossible_is_never_best_and_says_nothing():
    draws = normal_draws(100)
    draws[:, ~ONE_IS_GONE] = np.nan
    result = explained(np.where(ONE_IS_GONE, VALUES, np.nan), draws, ONE_IS_GONE)
    for numbers in (result.values, result.low, result.high):
        assert np.isneginf(numbers[~ONE_IS_GONE]).all()
        assert np.isfinite(numbers[ONE_IS_GONE]).all()
    np.testing.assert_array_equal(result.probability_best[~ONE_IS_GONE], 0.0)
    assert np.isneginf([result.lift_worth[1], result.lift_low[1], result.lift_high[1]]).all()
    assert "LIFT 1" not in str(result)
    # And all of it goes into JSON.
    read = json.loads(json.dumps(result.as_dict(), allow_nan=False))
    assert read["actions"] == ["FINISH", "WASH 0", "WASH 1", "LIFT 0", "LIFT 1"]
    assert read["values"] == [0.0, 1.0, None, 1.5, None]
    assert read["lift_worth"] == [0.5, None]
    assert (read["best"], read["level"]) == ("LIFT 0", 0.9)
    assert read["probability_stop_is_right"] == result.probability_stop_is_right
    only = explained(VALUES, normal_draws(10), np.array([True, False, False, False, False]))
    assert str(only).endswith("FINISH: best with probability 1.00; stopping now is right with probability 1.00.")


def test_a_large_table_is_reported_in_few_lines():
    values = np.linspace(0.0, 1.0, 41)
    message = str(explained(values, values[None], np.ones(41, dtype=bool)))
    assert len(message.splitlines()) == 11
    assert "and 33 more that are worth less" in message


@pytest.mark.parametrize(
    ("values", "sentence"),
    [
        ([0, 1, -2, 1.5, 0.5], "LIFT 0: best with probability 1.00; worth +0.50 (+0.50 to +0.50) over WASH 0 now; "),
        ([0, 2, -2, 1.5, 0.5], "WASH 0: best with probability 1.00; LIFT 0 is worth -0.50 (-0.50 to -0.50) over WASH"),
        (
            [3, 2, -2, 1, 2],
            "FINISH: best with probability 1.00; LIFT 1 is worth -1.00 (-1.00 to -1.00) over FINISH now",
        ),
    ],
)
def test_the_sentence_names_the_best_and_what_a_look_is_worth(values, sentence):
    values = np.array(values, dtype=float)
    message = str(explained(values, np.tile(values, (3, 1)), ALL))
    assert message.splitlines()[-1].startswith(sentence)
    assert message.endswith(f"stopping now is right with probability {float(values[0] == 3):.2f}.")
    best_first = [line.split()[0] for line in message.splitlines()[1:-1]]
    assert sentence.startswith(best_first[0])
    assert len(best_first) == 5


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"values": VALUES[:4], "draws": np.zeros((9, 4)), "is_possible": ALL[:4]}, "there are 4 actions"),
        ({"is_possible": ~ALL}, "FINISH is impossible"),
        ({"draws": np.zeros((0, 5))}, "no draw"),
        ({"level": 1.0}, r"level is 1\.0"),
        ({"values": np.where(np.arange(5) == 3, np.nan, VALUES)}, "Q of LIFT 0 is not finite"),
        ({"draws": np.where(np.arange(5) == 2, -np.inf, np.zeros((4, 5)))}, "Q of WASH 1 is not finite"),
    ],
)
def test_what_makes_no_sense_is_refused(change, message):
    with pytest.raises(ArgumentError, match=message):
        explained(**{"values": VALUES, "draws": normal_draws(10), "is_possible": ALL} | change)


def state_of(hides, **changes):
    layout = picked(pad_scenes([Scene(np.array(hides, dtype=float))]), 0)
    state = initial_state(WorldConfig(horizon=4), layout)
    return replace(state, **changes)


RING = [[0, 0.5, 0], [0, 0, 0.5], [0.5, 0, 0]]
PAIR = [[0, 0.5, 0.2], [0.5, 0, 0.2], [0, 0, 0]]


@pytest.mark.parametrize(
    ("hides", "changes", "first"),
    [
        (np.zeros((3, 3)), {}, [0, 0, 0]),
        (PAIR, {}, [0, 0, 2]),
        # Turning the ring is no exchange of two.
        (RING, {}, [0, 1, 2]),
        (RING, {"is_on_table": np.array([False, False, True])}, [0, 1, 2]),
        (PAIR, {"log_odds": np.array([1.0, 2.0, 1.0])}, [0, 1, 2]),
        (PAIR, {"grip": np.array([0.0, 0.5, 0.0])}, [0, 1, 2]),
        (PAIR, {"seen": np.array([1.0, 0.5, 1.0])}, [0, 1, 2]),
        (PAIR, {"is_on_table": np.array([True, False, True])}, [0, 1, 2]),
        ([[0, 0, 0.5], [0, 0, 0.1], [0, 0, 0]], {"is_on_table": np.array([True, True, False])}, [0, 0, 2]),
        (PAIR, {"attempt_object": np.array([1, -1, -1, -1])}, [0, 1, 2]),
        (PAIR, {"attempt_object": np.array([1, 0, -1, -1])}, [0, 0, 2]),
        (PAIR, {"attempt_object": np.array([1, 0, -1, -1]), "attempt_succeeded": np.arange(4) == 0}, [0, 1, 2]),
    ],
)
def test_objects_are_alike_if_they_can_trade_places(hides, changes, first):
    first = np.array(first)
    np.testing.assert_array_equal(alike(state_of(hides, **changes)), [0, *(1 + first), *(4 + first)])
