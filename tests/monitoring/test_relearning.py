"""Whether learning again may pay: how many trajectories there are, and how many are needed."""

import pytest

from halfseen.monitoring.answer import FEWEST, num_needed, relearning

VALUE = {"value": 0.6, "standard_error": 0.1}


def test_so_many_are_needed_that_the_loss_is_two_standard_errors():
    needed = num_needed(VALUE, 400, 0.35)
    assert VALUE["standard_error"] * (400 / needed) ** 0.5 * 2.0 == pytest.approx(0.25, rel=1e-2)


def test_where_nothing_is_lost_none_are_needed_and_where_nothing_is_known_the_fewest():
    assert num_needed(VALUE, 400, 0.7) is None
    assert num_needed(None, 400, 0.1) == num_needed(VALUE, 400, None) == num_needed(VALUE, 400, -9.0) == FEWEST


@pytest.mark.parametrize(
    ("given", "told"),
    [
        (
            (80, 301, 100, 0.8),
            "Learning again will not pay yet: there are 80 trajectories since the change, and about",
        ),
        ((200, 301, 100, 0.8), "Learning again may pay: there are 200 trajectories since the change, and about 100"),
        ((200, 301, None, 0.8), "Learning again need not pay: nothing is lost in 200 trajectories since the change."),
        ((200, 301, 100, 1.0), "Learning again may pay"),
    ],
)
def test_it_is_told_in_one_sentence(given, told):
    sentence = relearning(*given)
    assert sentence.startswith(told)
    assert ("serve with --explore first" in sentence) == (given[-1] == 1.0)
