"""Reasons in words: what speaks for an action beside the next best, of tables and of named actions."""

from dataclasses import replace

import numpy as np
import pytest

from halfseen.learning import FlatPolicy
from halfseen.policies.named_decider import flat_reason
from halfseen.policies.table_decider import table_reason
from halfseen.tables.explain import Grounds
from halfseen.tables.present import first_state
from halfseen.world import Scene

STATE = first_state(
    Scene(np.array([[0.0, 0.0, 0.62], [0.05, 0.0, 0.3], [0.0, 0.0, 0.0]])), horizon=4, dirty_share=0.6
).state
PRIOR = float(np.log(0.6 / 0.4))
WORTHS = ("FINISH", "WASH_0", "WASH_1", "WASH_2", "LIFT_0", "LIFT_1", "LIFT_2")


def reason(changed, worths, chances=None, worst_wash=None):
    """Of the best action in a state that was changed; what is not named is worth −9."""
    state = replace(STATE, **{name: np.array(value) for name, value in changed.items()})
    grounds = Grounds.of(state, dirty_share=0.6, worst_wash=worst_wash)
    return table_reason(grounds, np.array([worths.get(name, -9.0) for name in WORTHS]), chances)


SURE = {"log_odds": [0.5, 0.5, 3.0]}


@pytest.mark.parametrize(
    ("changed", "worths", "worst_wash", "told"),
    [
        (
            {},
            {"WASH_0": 1.2, "LIFT_2": 2.0},
            None,
            "LIFT 2: worth 0.80 more than WASH 0; it would lay bare 62% of object 0 and 30% of object 1, of which "
            "nothing is known yet; as for WASH 0, it is half hidden (0.62), and nothing is known yet of whether it is "
            "dirty.",
        ),
        (
            {},
            {"LIFT_0": 2.0, "FINISH": 0.0},
            None,
            "LIFT 0: worth 2.00 more than FINISH; it would show its own hidden 62%, of which nothing is known yet; as "
            "for FINISH, nothing is known yet of the 3 objects left.",
        ),
        (
            SURE,
            {"WASH_2": 1.5, "WASH_0": 1.0},
            -10.0,
            "WASH 2: worth 0.50 more than WASH 0; it is in plain sight and almost surely dirty (0.95), and it hides 0 "
            "and 1; as for WASH 0, it is half hidden (0.62) and rather dirty than clean (0.62), and a wrong WASH costs "
            "up to 10.",
        ),
    ],
)
def test_a_lift_is_told_by_what_it_would_reveal_and_a_wash_by_how_sure_it_is(changed, worths, worst_wash, told):
    assert reason(changed, worths, worst_wash=worst_wash) == told


@pytest.mark.parametrize(
    ("changed", "worths", "told"),
    [
        ({"log_odds": [2.0, PRIOR, 0.0]}, {"LIFT_2": 1.0, "LIFT_1": 0.5}, "62% of object 0 (probably dirty, 0.88)"),
        ({"seen": [0.3, 0.3, 0.4]}, {"LIFT_0": 1.0}, "show its own hidden 62%"),
        ({"seen": [0.3, 0.3, 0.4], "hides": [[0.0] * 3] * 3}, {"LIFT_2": 1.0}, "show the 60% of it that no label"),
        ({"attempt_object": [0, 0, 1, -1]}, {"WASH_0": 1.0}, "; it slipped 2 times;"),
        ({}, {"FINISH": 1.0, "WASH_0": 1.0}, "FINISH: worth as much as WASH 0"),
        (
            {"log_odds": [-2.5, -3.0, -0.1]},
            {"FINISH": 0.0},
            "FINISH: worth 9.00 more than WASH 0; the likeliest dirty of the 3 objects left, 2, is in plain sight and "
            "as likely clean as dirty (0.48); as for WASH 0,",
        ),
    ],
)
def test_what_is_known_is_told_object_by_object(changed, worths, told):
    assert told in reason(changed, worths)


def test_what_a_wrong_wash_costs_is_told_once_and_where_it_is_known():
    both = reason(SURE, {"WASH_0": 1.5, "WASH_1": 1.0}, worst_wash=-10.0)
    assert both.count("costs up to 10") == 1
    assert "(0.62), and a wrong WASH costs up to 10; as for WASH 1" in both
    assert "costs" not in reason(SURE, {"WASH_0": 1.0, "LIFT_0": 0.5})


def test_how_sure_it_is_stands_with_what_it_is_worth():
    worths = {"FINISH": 1.0, "WASH_0": 0.5}
    assert ", and best with a chance of 71%; nothing" in reason({}, worths, {"FINISH": 0.71, "WASH 0": 0.29})
    doubted = reason({}, worths, {"FINISH": 0.3, "WASH 0": 0.7})
    assert "best with a chance of 30%; WASH 0 is likelier best (70%), but the logs bear it out less;" in doubted


POLICY = FlatPolicy(
    actions=("A", "B", "C"),
    covariates=("x1", "x2"),
    is_possible=np.array([[True, True, False], [False, False, True]]),
    coefficients=np.array([[[0.0, 1.0, 0.0], [0.5, 0.0, 0.0], [9.0, 0.0, 0.0]]] * 2),
)
ROW, FLAG = {"x1": 0.8, "x2": 3.0}, {"x1": (0.0, 1.0), "x2": (0.0, 1.0)}


@pytest.mark.parametrize(
    ("row", "stage", "ranges", "told"),
    [
        (
            ROW,
            1,
            {"x1": (-1.0, 1.0), "x2": (0.0, 4.0)},
            "A: worth 0.30 more than B; that x1 is 0.8 speaks for it most: were it 0, the middle in the logs, it would "
            "be worth 0.50 less than B.",
        ),
        (
            ROW,
            1,
            {"x1": (0.9, 1.1), "x2": (0.0, 4.0)},
            "A: worth 0.30 more than B; none of what it looks at speaks for it more than what is usual in the logs "
            "does.",
        ),
        (ROW, 1, None, "A: worth 0.30 more than B."),
        ({"x1": True, "x2": 1.0}, 1, FLAG, "... that x1 is 1 speaks for it most: were it 0, it"),
        ({"x1": False, "x2": 1.0}, 1, FLAG, "... x1 is 0 speaks for it most: were it 1"),
        ({"x1": 3, "x2": 1}, 1, {"x1": (0.0, 3.0), "x2": (0.0, 4.0)}, "... most: were it 1, the middle in the logs"),
        (ROW, 2, None, "C: nothing else is possible."),
    ],
)
def test_the_covariate_that_speaks_most_for_an_action_is_held_against_the_middle_of_its_range(row, stage, ranges, told):
    found = flat_reason(POLICY, row, stage, ranges)
    assert told.removeprefix("... ") in found if told.startswith("...") else told == found
