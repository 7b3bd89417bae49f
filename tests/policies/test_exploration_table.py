"""A table of what to try: it is read as it is written, each row has its say, and what is wrong is named."""

from collections import Counter

import numpy as np
import pytest

from halfseen.errors import ArgumentError
from halfseen.policies.decision import Decision
from halfseen.policies.exploration_table import MOST_EXPLORED, as_csv, read_exploration
from halfseen.serving.recording import taken

ACTIONS, COLUMNS = ("look", "grasp", "shake"), ("clutter", "colour")
TEXT = "stage,clutter,action,probability\n<= 1.5,<= 0.5,look,0.4\n<= 1.5,,shake,0.2\n"


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "try.csv"
    path.write_text(TEXT)
    return path


def test_each_row_that_matches_has_its_say(file):
    table = read_exploration(file, ACTIONS, COLUMNS)
    assert table.shares({"clutter": 0.0}, 1) == {"look": 0.4, "shake": 0.2}
    assert table.shares({"clutter": 1.0}, 1) == {"shake": 0.2}
    assert table.shares({"clutter": 0.0}, 2) == {}


def test_it_is_read_as_it_is_written(file):
    asked = [{"stage": "<= 1.5", "clutter": "<= 0.5"}, {"stage": "<= 1.5"}]
    assert as_csv(asked, ["look", "shake"], [0.4, 0.2]) == TEXT


def test_something_is_always_left_to_the_policy(tmp_path):
    path = tmp_path / "try.csv"
    path.write_text("action,probability\nlook,0.8\nshake,0.8\nlook,0.1\n")
    shares = read_exploration(path, ACTIONS, COLUMNS).shares({}, 1)
    assert shares == pytest.approx({"look": MOST_EXPLORED / 2, "shake": MOST_EXPLORED / 2})


def test_what_is_drawn_has_the_probability_that_is_told():
    best = Decision("grasp", {"grasp": 1.0, "look": 0.5, "shake": None}, "grasp: worth more.")
    shares, rng = {"look": 0.3, "shake": 0.2, "grasp": 0.1}, np.random.default_rng(0)
    drawn = [taken(best, shares, rng) for _ in range(4000)]
    told = {one.decision.action: one.probability for one in drawn}
    assert told == pytest.approx({"look": 0.3, "grasp": 0.7})
    counts = Counter(one.decision.action for one in drawn)
    assert counts["look"] == pytest.approx(1200, abs=4 * np.sqrt(4000 * 0.21))
    assert {one.is_explored for one in drawn if one.decision.action == "grasp"} == {False}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("action\nlook\n", "name each column once, one of them 'probability'"),
        ("action,probability\nlock,0.2\n", "row 1: there is no action lock; there are look, grasp, shake; did you"),
        ("cluter,action,probability\n1,look,0.2\n", "row 1: there is no column cluter"),
        ("action,probability\nlook,1\n", "row 1: probability is '1'; give a number between 0 and 1"),
        ("action,probability\nlook,often\n", "row 1: probability is 'often'"),
        ("clutter,action,probability\nnan,look,0.2\n", "row 1: clutter is 'nan', and the policy knows numbers of it"),
        ("colour,action,probability\n> 1,look,0.2\n", "row 1: colour is 1.0, and the policy knows text of it"),
        ("clutter,action,probability\n< ,look,0.2\n", "row 1: clutter is '<', which is no condition"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, text, said):
    path = tmp_path / "try.csv"
    path.write_text(text)
    with pytest.raises(ArgumentError, match=r"try\.csv") as told:
        read_exploration(path, ACTIONS, COLUMNS, ("colour",))
    assert said in str(told.value)
