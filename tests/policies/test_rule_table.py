"""Rules of thumb as policies: read from files, refused where they are none, and against a loop over the rows."""

from collections import Counter

import numpy as np
import pandas as pd
import pytest

from halfseen.errors import ArgumentError, LogError
from halfseen.learning.discrete_policy import NamedActionPolicy
from halfseen.policies import Rule, read_rule_table
from halfseen.policies.decision import Decision
from halfseen.policies.exploration import MOST_EXPLORED, as_csv, read_exploration, taken

PARTS = pd.DataFrame({"weight_kg": [2.0, 1.5, 0.2, 2.9], "shine": [0.9, 0.7, 0.1, 0.5], "colour": list("rgbr")})
CSV = "stage,weight_kg,shine,action\n> 2,,,hand over\n,> 1.5 and <= 2.5,,parallel\n,,> 0.5,suction\n,,,soft\n"
TOML = """
[[rule]]
when = { stage = "> 2" }
action = "hand over"

[[rule]]
when = { weight_kg = "> 1.5 and <= 2.5" }
action = "parallel"

[[rule]]
when = { shine = "> 0.5" }
action = "suction"

[[rule]]
action = "soft"
"""


def written(folder, text, name="rule.csv"):
    (folder / name).write_text(text, encoding="utf-8")
    return folder / name


def chosen_by(rule, stage, parts=PARTS):
    return [rule.actions[column] for column in rule.probabilities(parts, stage).argmax(axis=1)]


def by_hand(weight, shine, stage):
    if stage > 2:
        return "hand over"
    if 1.5 < weight <= 2.5:
        return "parallel"
    return "suction" if shine > 0.5 else "soft"


@pytest.mark.parametrize(("text", "name"), [(CSV, "rule.csv"), (TOML, "rule.toml")])
@pytest.mark.parametrize("stage", [1, 2, 3])
def test_the_first_row_that_matches_wins(tmp_path, text, name, stage):
    rule = read_rule_table(written(tmp_path, text, name), horizon=3)
    assert isinstance(rule, NamedActionPolicy)
    assert chosen_by(rule, stage) == [
        by_hand(*row, stage) for row in zip(PARTS["weight_kg"], PARTS["shine"], strict=True)
    ]
    np.testing.assert_array_equal(rule.probabilities(PARTS, stage).sum(axis=1), 1.0)


@pytest.mark.parametrize(
    ("condition", "holds"),
    [
        ("1.5", [False, True, False, False]),
        ("= 1.5", [False, True, False, False]),
        ("!= 1.5", [True, False, True, True]),
        ("< 1.5", [False, False, True, False]),
        ("<=1.5", [False, True, True, False]),
        (">= 1.5", [True, True, False, True]),
    ],
)
def test_every_comparison(tmp_path, condition, holds):
    rule = read_rule_table(written(tmp_path, f"weight_kg,action\n{condition},yes\n,no\n"), horizon=1)
    assert chosen_by(rule, 1) == ["yes" if it_does else "no" for it_does in holds]


def test_texts_are_compared_as_texts_and_numbers_of_toml_as_numbers(tmp_path):
    rule = read_rule_table(written(tmp_path, "colour,action\nr,red\n!= g,other\n,green\n"), horizon=1)
    assert chosen_by(rule, 1) == ["red", "green", "other", "red"]
    number = read_rule_table(
        written(tmp_path, '[[rule]]\nwhen = {stage = 1}\naction = 7\n[[rule]]\naction = "b"', "r.toml"), 2
    )
    assert (chosen_by(number, 1), chosen_by(number, 2)) == ([7] * 4, ["b"] * 4)
    truth = '[[rule]]\nwhen = {is_heavy = true}\naction = "A"\n[[rule]]\naction = "B"'
    heavy = read_rule_table(written(tmp_path, truth, "t.toml"), 1)
    assert chosen_by(heavy, 1, pd.DataFrame({"is_heavy": [True, False]})) == ["A", "B"]
    assert [heavy.action({"is_heavy": each}, 1) for each in (True, 0)] == ["A", "B"]


def test_text_may_hold_the_word_and_or_look_like_a_number(tmp_path):
    text = "task,part,action\nnuts and bolts,,A\n!= pick and place,007,B\n,!= 7,C\n,,D\n"
    parts = pd.DataFrame(
        {"task": ["nuts and bolts", "bolts", "pick and place", "bolts"], "part": ["7", "007", "007", "7"]}
    )
    rule = read_rule_table(written(tmp_path, text), horizon=1)
    assert chosen_by(rule, 1, parts) == ["A", "B", "C", "D"]
    assert [rule.action(dict(row), 1) for _, row in parts.iterrows()] == ["A", "B", "C", "D"]
    with pytest.raises(ArgumentError, match="x is '> 1 and heavy', which is not a condition"):
        read_rule_table(written(tmp_path, "x,action\n> 1 and heavy,A\n,B\n"), horizon=1)


@pytest.mark.parametrize(
    ("text", "name", "message"),
    [
        ("", "rule.csv", "its first line is ''"),
        ("stage,act\n1,A\n", "rule.csv", "name each column once, one of them 'action'"),
        ("x,x,action\n1,2,A\n", "rule.csv", "name each column once"),
        ("x,action\n", "rule.csv", "no rows"),
        ("x,action\n1,A,B\n", "rule.csv", "row 1 has 3 cells, but the first line 2"),
        ("x,action\n1,\n,A\n", "rule.csv", "row 1: action is ''"),
        ("x,action\n1,A\n", "rule.csv", "the last row has conditions"),
        ("x,action\n1,A\n,B\n2,A\n,B\n", "rule.csv", "row 2 has no conditions, so rows below it"),
        ("x,action\n>> 1,A\n,B\n", "rule.csv", "row 1: x is '>> 1', which is not a condition"),
        ("x,action\n> heavy,A\n,B\n", "rule.csv", "row 1: x is '> heavy', which is not a condition"),
        ("x,action\n>,A\n,B\n", "rule.csv", "row 1: x is '>', which is not a condition"),
        ("x,action\n< nan,A\n,B\n", "rule.csv", "row 1: x is '< nan', which is not a condition"),
        ("stage,action\nfirst,A\n,B\n", "rule.csv", "row 1: stage is 'first', which is not a condition"),
        ("stage,action\n0,A\n,B\n", "rule.csv", "row 1: no stage is 0; stages are whole numbers from 1"),
        ("stage,action\n< 1,A\n,B\n", "rule.csv", "row 1: no stage is < 1"),
        ("stage,action\n1,A\n> 1 and < 2,A\n,B\n", "rule.csv", "row 2: no stage is > 1 and < 2"),
        ("x,action\n> 3 and <= 1,A\n,B\n", "rule.csv", "row 1: no x is > 3 and <= 1; the row would never match"),
        ("x,action\n> 3 and < 3,A\n,B\n", "rule.csv", "row 1: no x is > 3 and < 3"),
        ("x = ", "rule.toml", "cannot be read as a rule"),
        ("", "rule.toml", "it holds nothing; give"),
        ("rule = 1", "rule.toml", "it holds rule; give"),
        ("[[rule]]\nif = 1\naction = 'A'", "rule.toml", "row 1 has an unknown key 'if'"),
        ("[[rule]]\nwhen = 1\naction = 'A'", "rule.toml", "row 1 has a 'when' that is not a table"),
        ("[[rule]]\nwhen = {x = 1}", "rule.toml", "row 1: action is ''"),
        ("[[rule]]\naction = true", "rule.toml", "row 1: action is True"),
        ("x,action\n1,A\n", "rule.txt", "ends in .csv or .toml"),
    ],
)
def test_what_is_no_rule_is_reported_in_one_line(tmp_path, text, name, message):
    with pytest.raises(ArgumentError) as refusal:
        read_rule_table(written(tmp_path, text, name), horizon=1)
    words = str(refusal.value)
    assert message in words
    assert name in words
    assert "\n" not in words


@pytest.mark.parametrize(
    ("column", "condition"),
    [
        *(("stage", condition) for condition in ("> 0", ">= 1 and < 2", "> 1 and != 2", "9")),
        *(("x", condition) for condition in ("> 0.25 and < 0.5", "!= 1", "> 1 and <= 2", "> 1e300")),
    ],
)
def test_conditions_that_some_number_fulfils_are_a_rule(tmp_path, column, condition):
    assert len(read_rule_table(written(tmp_path, f"{column},action\n{condition},A\n,B\n"), horizon=2).rows) == 2


@pytest.mark.parametrize(
    ("condition", "parts", "error", "message"),
    [
        (
            "reward,action\n> 1,A",
            PARTS,
            ArgumentError,
            "asks for 'reward', which is unknown when deciding; ask for cov",
        ),
        (
            "size,action\n1,A",
            PARTS,
            ArgumentError,
            "asks for 'size', but the log has no such column; give one of weight_kg",
        ),
        ("colour,action\n> 1,A", PARTS, ArgumentError, "colour > 1.0, but colour holds no numbers"),
        ("shine,action\nhigh,A", PARTS, ArgumentError, "shine = high, but shine holds numbers"),
        (
            "shine,action\n1,A",
            pd.DataFrame({"trajectory": [4, 7], "stage": [2, 2], "shine": [0.1, None]}),
            LogError,
            "trajectory 7.*stage 2.*'shine' is null",
        ),
    ],
)
def test_covariates_that_do_not_fit_the_rule(tmp_path, condition, parts, error, message):
    rule = read_rule_table(written(tmp_path, f"{condition}\n,B\n"), horizon=2)
    with pytest.raises(error, match=message):
        rule.probabilities(parts, 2)


def test_a_function_names_one_of_its_actions_for_each_row():
    heavy = Rule(lambda parts, stage: np.where(parts["weight_kg"] > stage, "A", "B"), ("B", "A"), horizon=2)
    np.testing.assert_array_equal(heavy.probabilities(PARTS, 2), [[1, 0], [1, 0], [1, 0], [0, 1]])
    with pytest.raises(ArgumentError, match="took 'C', which is not one of its actions"):
        Rule(lambda parts, stage: ["C"] * len(parts), ("A",), 1).probabilities(PARTS, 1)
    with pytest.raises(ArgumentError, match=r"gave shape \(\) for 4 rows"):
        Rule(lambda parts, stage: "A", ("A",), 1).probabilities(PARTS, 1)


# A table of what to try
ACTIONS, COLUMNS = ("look", "grasp", "shake"), ("clutter", "colour")
TEXT = "stage,clutter,action,probability\n<= 1.5,<= 0.5,look,0.4\n<= 1.5,,shake,0.2\n"


def test_each_row_that_matches_has_its_say_and_it_is_read_as_it_is_written(tmp_path):
    table = read_exploration(written(tmp_path, TEXT), ACTIONS, COLUMNS)
    assert table.shares({"clutter": 0.0}, 1) == {"look": 0.4, "shake": 0.2}
    assert table.shares({"clutter": 1.0}, 1) == {"shake": 0.2}
    assert table.shares({"clutter": 0.0}, 2) == {}
    asked = [{"stage": "<= 1.5", "clutter": "<= 0.5"}, {"stage": "<= 1.5"}]
    assert as_csv(asked, ["look", "shake"], [0.4, 0.2]) == TEXT


def test_something_is_always_left_to_the_policy(tmp_path):
    path = written(tmp_path, "action,probability\nlook,0.8\nshake,0.8\nlook,0.1\n")
    shares = read_exploration(path, ACTIONS, COLUMNS).shares({}, 1)
    assert shares == pytest.approx({"look": MOST_EXPLORED / 2, "shake": MOST_EXPLORED / 2})


def test_what_is_drawn_has_the_probability_that_is_reported():
    best = Decision("grasp", {"grasp": 1.0, "look": 0.5, "shake": None}, "grasp: worth more.")
    shares, rng = {"look": 0.3, "shake": 0.2, "grasp": 0.1}, np.random.default_rng(0)
    drawn = [taken(best, shares, rng) for _ in range(4000)]
    result = {one.decision.action: one.probability for one in drawn}
    assert result == pytest.approx({"look": 0.3, "grasp": 0.7})
    counts = Counter(one.decision.action for one in drawn)
    assert counts["look"] == pytest.approx(1200, abs=4 * np.sqrt(4000 * 0.21))
    assert {one.is_explored for one in drawn if one.decision.action == "grasp"} == {False}


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("action\nlook\n", "name each column once, one of them 'probability'"),
        ("action,probability\nlock,0.2\n", "row 1: unknown action lock; give one of look, grasp, shake; did you"),
        ("cluter,action,probability\n1,look,0.2\n", "row 1: unknown column cluter"),
        ("action,probability\nlook,1\n", "row 1: probability is '1'; give a number between 0 and 1"),
        ("action,probability\nlook,often\n", "row 1: probability is 'often'"),
        ("clutter,action,probability\nnan,look,0.2\n", "row 1: clutter is 'nan'; give numbers, as in the policy"),
        ("colour,action,probability\n> 1,look,0.2\n", "row 1: colour is 1.0; give text, as in the policy"),
        ("clutter,action,probability\n< ,look,0.2\n", "row 1: clutter is '<', which is not a condition"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, text, said):
    with pytest.raises(ArgumentError, match=r"rule\.csv") as caught:
        read_exploration(written(tmp_path, text), ACTIONS, COLUMNS, ("colour",))
    assert said in str(caught.value)


def test_one_state_is_decided_as_many_are(tmp_path):
    file = tmp_path / "rule.csv"
    file.write_text("stage,x,colour,action\n> 1,,= red,A\n,> 0.5 and <= 2,,B\n,,!= blue,C\n,,,A\n")
    rule = read_rule_table(file, 3)
    rng = np.random.default_rng(0)
    frame = pd.DataFrame({"x": rng.normal(size=60).round(1), "colour": rng.choice(["red", "blue", "green"], 60)})
    for stage in (1, 2):
        many = np.array(rule.actions, dtype=object)[rule.probabilities(frame, stage).argmax(axis=1)]
        assert [rule.action(dict(row), stage) for _, row in frame.iterrows()] == many.tolist()
    with pytest.raises(ArgumentError, match=r"asks for x > 0\.5, but x is None"):
        rule.action({"colour": "blue"}, 1)
    with pytest.raises(ArgumentError, match="asks for colour = red, but colour is 1"):
        rule.action({"colour": 1}, 2)
    with pytest.raises(ArgumentError, match=r"asks for x > 0\.5, but x is nan"):
        rule.action({"x": np.nan, "colour": "blue"}, 1)
