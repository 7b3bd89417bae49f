"""Policies and rules that answer with pandas: read by its labels, not by place."""

import numpy as np
import pandas as pd
import pytest

from halfseen.errors import ArgumentError
from halfseen.evaluation import FixedSequence, evaluate
from halfseen.learning.discrete_policy import checked_probabilities
from halfseen.policies import Rule
from refusals import refused, refused_type
from small_logs import flat_log

STATES = pd.DataFrame({"x": [0.3, -1.0, 2.0]}, index=[7, 4, 9])
CHANCES = pd.DataFrame({"A": [0.1, 0.6, 0.3], "B": [0.9, 0.4, 0.7]}, STATES.index)


class Answers:
    """A policy with one answer."""

    horizon = 1

    def __init__(self, answer, actions=("A", "B")):
        self.answer, self.actions = answer, actions

    def probabilities(self, frame, stage):
        return self.answer


@pytest.mark.parametrize(
    "answer",
    [
        CHANCES,
        CHANCES[["B", "A"]],
        CHANCES.sort_index()[["B", "A"]],
        CHANCES.set_axis(["p", "q"], axis=1).sort_index(),
        CHANCES.reset_index(drop=True),
        CHANCES.to_numpy(),
    ],
)
def test_probabilities_in_a_table_are_read_by_its_labels(answer):
    np.testing.assert_array_equal(checked_probabilities(Answers(answer), STATES, 1), CHANCES)


def test_an_action_with_two_columns_is_refused():
    with pytest.raises(ArgumentError, match=r"Answers\.actions names 'A' twice; give each action one column"):
        checked_probabilities(Answers(np.full((3, 3), 1 / 3), ("A", "B", "A")), STATES, 1)


@pytest.mark.parametrize("turned", [lambda one: one, lambda one: one.sort_values(), lambda one: one.to_list()])
def test_a_rule_that_sorts_its_states_is_read_by_their_labels(turned):
    rule = Rule(lambda frame, stage: turned(frame["x"].gt(0).map({True: "A", False: "B"})), ("A", "B"), 1)
    np.testing.assert_array_equal(rule.probabilities(STATES, 1), [[1, 0], [0, 1], [1, 0]])


def test_an_answer_that_is_no_array_and_folds_that_are_no_count_are_refused_in_a_line():
    with refused(r"Answers.probabilities, stage 1: a list is no array \(.*\); give one, \(3, 2\)"):
        checked_probabilities(Answers([{"A": 1.0}] * 3), STATES, 1)
    with refused_type("num_folds is 10.0; give a whole number of at least 2"):
        evaluate(FixedSequence(("A", "A")), flat_log(), num_folds=10.0)


def test_a_sequence_may_be_an_array():
    np.testing.assert_array_equal(FixedSequence(np.array(["B", "A"])).probabilities(STATES, 1), [[1.0, 0.0]] * 3)
