from dataclasses import replace

import numpy as np
import pytest

from halfseen.learning import FlatPolicy
from halfseen.policies.flat_reason import flat_reason
from halfseen.policies.table_reason import table_reason
from halfseen.tables.explain import Grounds
from halfseen.tables.present import first_state
from halfseen.world import Scene

STATE = first_state(
    Scene(np.array([[0.0, 0.0, 0.62], [0.05, 0.0, 0.3], [0.0, 0.0, 0.0]])), horizon=4, dirty_share=0.6
).state
POLICY = FlatPolicy(
    actions=("A", "B", "C"),
    covariates=("x1", "x2"),
    is_possible=np.array([[True, True, False], [False, False, True]]),
    coefficients=np.array([[[0.0, 1.0, 0.0], [0.5, 0.0, 0.0], [9.0, 0.0, 0.0]]] * 2),
)
PRIOR = float(np.log(0.6 / 0.4))
ROW = {"x1": 0.8, "x2": 3.0}


def of(**changed):
    known = {name: changed.pop(name, None) for name in ("dirty_share", "worst_wash")}
    return Grounds.of(replace(STATE, **changed), **known)


def q_of(**worths):
    """FINISH, WASH 0 to 2, LIFT 0 to 2; what is not named is worth −9."""
    names = ("FINISH", "WASH_0", "WASH_1", "WASH_2", "LIFT_0", "LIFT_1", "LIFT_2")
    return np.array([worths.get(name, -9.0) for name in names])


def test_a_lift_is_told_by_what_it_would_reveal_and_the_prior_is_no_evidence():
    told = table_reason(of(dirty_share=0.6), q_of(WASH_0=1.2, LIFT_2=2.0))
    assert told == (
        "LIFT 2: worth 0.80 more than WASH 0; it would lay bare 62% of object 0 and 30% of object 1, of which nothing "
        "is known yet; as for WASH 0, it is half hidden (0.62), and nothing is known yet of whether it is dirty."
    )
    assert "0.60" not in told
    own = table_reason(of(dirty_share=0.6), q_of(LIFT_0=2.0, FINISH=0.0))
    assert own == (
        "LIFT 0: worth 2.00 more than FINISH; it would show its own hidden 62%, of which nothing is known yet; as for "
        "FINISH, nothing is known yet of the 3 objects left."
    )


def test_a_wash_is_told_by_how_sure_it_is_and_what_it_costs_if_it_is_wrong():
    log_odds = np.array([0.5, 0.5, 3.0])
    grounds = of(log_odds=log_odds, dirty_share=0.6, worst_wash=-10.0)
    assert table_reason(grounds, q_of(WASH_2=1.5, WASH_0=1.0)) == (
        "WASH 2: worth 0.50 more than WASH 0; it is in plain sight and almost surely dirty (0.95), and it hides "
        "0 and 1; as for WASH 0, it is half hidden (0.62) and rather dirty than clean (0.62), and a wrong WASH costs "
        "up to 10."
    )
    both = table_reason(grounds, q_of(WASH_0=1.5, WASH_1=1.0))
    assert both.count("costs up to 10") == 1
    assert "(0.62), and a wrong WASH costs up to 10; as for WASH 1" in both
    unknown = table_reason(of(log_odds=log_odds, dirty_share=0.6), q_of(WASH_0=1.0, LIFT_0=0.5))
    assert "costs" not in unknown


def test_finish_tells_of_the_likeliest_dirty_object():
    grounds = of(log_odds=np.array([-2.5, -3.0, -0.1]), dirty_share=0.6)
    assert table_reason(grounds, q_of(FINISH=0.0)).startswith(
        "FINISH: worth 9.00 more than WASH 0; the likeliest dirty of the 3 objects left, 2, is in plain sight "
        "and as likely clean as dirty (0.48); as for WASH 0,"
    )


def test_how_sure_it_is_stands_with_what_it_is_worth():
    grounds, q = of(dirty_share=0.6), q_of(FINISH=1.0, WASH_0=0.5)
    assert ", and best with a chance of 71%; nothing" in table_reason(grounds, q, {"FINISH": 0.71, "WASH 0": 0.29})
    doubted = table_reason(grounds, q, {"FINISH": 0.3, "WASH 0": 0.7})
    assert "best with a chance of 30%; WASH 0 is likelier best (70%), but the logs bear it out less;" in doubted


def test_the_covariate_that_speaks_most_for_an_action_is_told():
    ranges = {"x1": (-1.0, 1.0), "x2": (0.0, 4.0)}
    assert flat_reason(POLICY, ROW, 1, ranges) == (
        "A: worth 0.30 more than B; that x1 is 0.8 speaks for it most: were it 0, the middle in the logs, it would be "
        "worth 0.50 less than B."
    )
    speaks_against = flat_reason(POLICY, ROW, 1, {"x1": (0.9, 1.1), "x2": (0.0, 4.0)})
    assert speaks_against == (
        "A: worth 0.30 more than B; none of what it looks at speaks for it more than what is usual in the logs does."
    )
    assert flat_reason(POLICY, ROW, 1, None) == "A: worth 0.30 more than B."


@pytest.mark.parametrize(
    ("changed", "worths", "told"),
    [
        (
            {"log_odds": [2.0, PRIOR, 0.0]},
            {"LIFT_2": 1.0, "LIFT_1": 0.5},
            "62% of object 0 (probably dirty, 0.88)",
        ),
        ({"seen": [0.3, 0.3, 0.4]}, {"LIFT_0": 1.0}, "show its own hidden 62%"),
        (
            {"seen": [0.3, 0.3, 0.4], "hides": [[0.0] * 3] * 3},
            {"LIFT_2": 1.0},
            "show the 60% of it that no label",
        ),
        ({"attempt_object": [0, 0, 1, -1]}, {"WASH_0": 1.0}, "; it slipped 2 times;"),
        ({}, {"FINISH": 1.0, "WASH_0": 1.0}, "FINISH: worth as much as WASH 0"),
    ],
)
def test_what_is_known_is_told_object_by_object(changed, worths, told):
    changed = {name: np.array(value) for name, value in changed.items()}
    assert told in table_reason(of(dirty_share=0.6, **changed), q_of(**worths))


@pytest.mark.parametrize(
    ("row", "stage", "ranges", "told"),
    [
        (
            {"x1": True, "x2": 1.0},
            1,
            {"x1": (0.0, 1.0), "x2": (0.0, 1.0)},
            "that x1 is 1 speaks for it most: were it 0, it",
        ),
        (
            {"x1": False, "x2": 1.0},
            1,
            {"x1": (0.0, 1.0), "x2": (0.0, 1.0)},
            "x1 is 0 speaks for it most: were it 1",
        ),
        ({"x1": 3, "x2": 1}, 1, {"x1": (0.0, 3.0), "x2": (0.0, 4.0)}, "most: were it 1, the middle in the logs"),
        (ROW, 2, None, "C: nothing else is possible."),
    ],
)
def test_a_covariate_is_held_against_the_middle_of_its_range(row, stage, ranges, told):
    assert told in flat_reason(POLICY, row, stage, ranges)
