"""The port: heuristics, planners and learned policies, of named actions or of tables, answer alike."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from halfseen.errors import ArgumentError, OutOfRangeError, PolicyError
from halfseen.learning import DiscretePolicy
from halfseen.planners import GreedyPolicy, POMDPPolicy
from halfseen.policies import Decider, NamedObservation, decider_of
from halfseen.policies.decision import QError
from halfseen.policies.named_decider import flat_reason
from halfseen.policies.ranges import beyond, margin, refuse_far
from halfseen.policies.table_decider import table_reason
from halfseen.tables import LinearTablePolicy
from halfseen.tables.explain import TableExplanation
from halfseen.tables.features import NUM_FEATURES, table_features
from halfseen.tables.present import first_state
from halfseen.world import Scene, UniformPolicy, WorldConfig, random
from halfseen.world.actions import ActionSpace, Verb
from refusals import refused_type

CONFIG = WorldConfig(horizon=4)
NOW = first_state(Scene(np.array([[0.0, 0.6], [0.0, 0.0]])), horizon=4, dirty_share=0.6)
NAMES, VERBS = ActionSpace(2).names, np.asarray(ActionSpace(2).verbs)
SIZE = NUM_FEATURES + 1
DESIGN = np.concatenate([np.ones((len(VERBS), 1)), np.asarray(table_features(NOW.state))], axis=1)
COEFFICIENTS = 0.1 * random.normal(random.key_of(0), 4, len(Verb), SIZE)
FLAT = DiscretePolicy(
    actions=("A", "B"),
    covariates=("x",),
    is_possible=np.array([[True, True], [True, False]]),
    coefficients=np.array([[[0.0, 1.0], [0.5, 0.0]], [[0.0, 1.0], [9.0, 0.0]]]),
)
TABLES = {
    "heuristic": GreedyPolicy(CONFIG, uses_history=True, counts_penalty=True),
    "planner": POMDPPolicy(CONFIG, 1),
    "learned": LinearTablePolicy(COEFFICIENTS),
    "uniform": UniformPolicy(),
}


OF_COLOURS = replace(FLAT, categories={"x": ("blue", "red")})


def seen(x, stage=1):
    return NamedObservation(pd.DataFrame({"x": np.atleast_1d(x)}), stage)


@pytest.mark.parametrize("name", TABLES)
def test_a_table_gets_a_possible_action_a_reason_and_the_same_again(name):
    decider = decider_of(TABLES[name])
    decision = decider.decide(NOW)
    assert isinstance(decider, Decider)
    assert decision.action in NAMES
    assert decision.reason.startswith(f"{decision.action}: ")
    assert decision.warnings == ()
    assert decider.decide(NOW) == decision
    if name in ("planner", "learned"):
        assert decision.action == max(decision.q_values, key=lambda action: decision.q_values[action])
        assert NAMES[int(TABLES[name].decide(NOW.state, random.key_of(0)).action)] == decision.action
    if name == "heuristic":
        assert (decision.q_values, decision.intervals, decision.chance_best) == ({}, {}, {})
        assert "by GreedyPolicy; it is in plain sight, not labelled yet" in decision.reason


def test_named_actions_answer_through_the_same_door():
    decider = decider_of(FLAT, lambda stage: {"x": (0.0, 1.0)})
    decision = decider.decide(seen(2.0))
    assert (decision.action, decision.q_values) == ("A", {"A": 2.0, "B": 0.5})
    assert decision.warnings == ("x is 2, outside the logs (0 to 1); Q is extrapolated",)
    assert decider.decide(seen(0.2, 2)).q_values == {"A": 0.2, "B": None}
    assert decider_of(FLAT).decide(seen(2.0)).warnings == ()


@pytest.mark.parametrize(
    ("ask", "error", "message"),
    [
        (lambda: decider_of(object()), ArgumentError, "is not a policy"),
        (lambda: decider_of(FLAT).decide(seen(np.nan)), PolicyError, "the state: covariate 'x' is null; fill it in"),
        (lambda: decider_of(FLAT).decide(seen([0.5, 2.0])), PolicyError, "the state: 2 rows; give a frame of one row"),
        *(
            (lambda x=x: decider_of(FLAT).decide(NamedObservation({"x": x}, 1)), PolicyError, f"the state: .*{result}")
            for x, result in ((np.nan, "null"), (np.inf, "finite"), ("0.5", "not numeric"), (None, "null"))
        ),
        (lambda: decider_of(FLAT).decide(NamedObservation({"y": 1.0}, 1)), PolicyError, "but 'x' is missing"),
        (lambda: decider_of(OF_COLOURS).decide(NamedObservation({"x": "green"}, 1)), PolicyError, "'green', which the"),
        (lambda: decider_of(FLAT).decide(seen(0.0, 3)), ArgumentError, "stage is 3"),
    ],
)
def test_what_is_no_policy_or_no_observation_is_refused(ask, error, message):
    with pytest.raises(error, match=message):
        ask()


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"coefficients": FLAT.coefficients[:1]}, "a row for each stage and each of the 2 actions"),
        ({"actions": ("A", "B", "C")}, "a row for each stage and each of the 3 actions"),
        ({"coefficients": np.nan * FLAT.coefficients}, "a coefficient is not finite"),
        ({"is_possible": FLAT.is_possible & [[True], [False]]}, "a stage has no possible action"),
    ],
)
def test_a_policy_of_other_stages_or_of_nan_is_refused(changed, message):
    with refused_type(message):
        replace(FLAT, **changed)


def test_a_state_is_no_observation():
    with refused_type("observation is a dict; give NamedObservation"):
        decider_of(FLAT).decide({"x": 0.5})


def test_what_is_not_possible_has_no_value():
    gone = replace(NOW.state, is_on_table=np.array([True, False]))
    values = decider_of(TABLES["learned"]).decide(replace(NOW, state=gone)).q_values
    assert [name for name, value in values.items() if value is None] == ["WASH 1", "LIFT 1"]


def test_on_a_table_a_margin_counts_as_far_as_the_log_does_something_else():
    keys = random.split(random.key_of(1), 2)
    root = 0.2 * random.normal(keys[0], 4, len(Verb), SIZE, SIZE)
    behaviour = random.normal(keys[1], len(Verb), SIZE)
    policy = LinearTablePolicy(COEFFICIENTS, margin=root, behaviour=behaviour)
    score, low, q = (
        np.asarray(replace(policy, **changed).q_values(NOW.state))
        for changed in ({}, {"behaviour": None}, {"behaviour": None, "margin": None})
    )
    is_possible = np.isfinite(q)
    chances = np.where(is_possible, np.exp(np.einsum("af,af->a", DESIGN, np.asarray(behaviour)[VERBS])), 0.0)
    even = 1 / is_possible.sum()
    excess_propensity = np.clip((chances / chances.sum() - even) / (1 - even), 0.0, 1.0)
    assert 0.0 < excess_propensity.max() < 1.0
    np.testing.assert_allclose(
        score[is_possible], (q - (1 - excess_propensity) * (q - low))[is_possible], rtol=1e-4, atol=1e-5
    )


def test_on_a_table_the_interval_is_of_q_without_its_margin_and_the_chance_that_of_drawn_coefficients():
    pessimism, root = 0.5, 0.1 * random.normal(random.split(random.key_of(3), 2)[0], 4, len(Verb), SIZE, SIZE)
    policy = LinearTablePolicy(COEFFICIENTS, margin=pessimism * root)
    decision = decider_of(policy, q_error=QError(pessimism, [1.0])).decide(NOW)
    middle, root = np.asarray(COEFFICIENTS)[3], np.asarray(root)[3]
    q = np.einsum("af,af->a", DESIGN, middle[VERBS])
    reach = 1.959964 * np.linalg.norm(np.einsum("afg,af->ag", root[VERBS], DESIGN), axis=1)
    intervals = [decision.intervals[name] for name in NAMES]
    np.testing.assert_allclose(intervals, np.stack([q - reach, q + reach], axis=1), atol=1e-4)
    draws = np.random.default_rng(5).normal(size=(40_000, len(Verb), SIZE))
    worth = np.einsum("af,baf->ba", DESIGN, (middle + np.einsum("kfg,bkg->bkf", root, draws))[:, VERBS])
    often = np.bincount(worth.argmax(axis=1), minlength=len(VERBS)) / len(worth)
    assert 0.05 < often.max() < 0.95
    np.testing.assert_allclose([decision.chance_best[name] for name in NAMES], often, atol=0.02)
    assert decider_of(policy).decide(NOW).intervals == {}


def test_far_more_objects_than_in_the_logs_are_refused_unless_they_are_to_be_extrapolated():
    ranges = {"num_objects": (5.0, 6.0), "occlusion": (0.0, 0.1), "log_odds": (8.0, 9.0), "num_attempts": (4.0, 4.0)}
    with pytest.raises(
        PolicyError, match=r"num_objects is 2, outside the logs \(5 to 6\) by more than the width of this range"
    ):
        decider_of(TABLES["learned"], lambda stage: ranges).decide(NOW)
    result = decider_of(TABLES["learned"], lambda stage: ranges, extrapolates=True).decide(NOW)
    assert result.warnings[0] == "num_objects is 2, outside the logs (5 to 6); Q is extrapolated"
    near = ranges | {"num_objects": (3.0, 4.0)}
    assert decider_of(TABLES["learned"], lambda stage: near).decide(NOW).warnings[0].startswith("num_objects is 2")


NEVER_VARIED = {"x": (4.0, 4.0), "y": (0.0, 0.0)}


@pytest.mark.parametrize(
    ("ranges", "values", "refused"),
    [
        ({"x": (1.0, 3.0)}, {"x": -1.0}, None),
        (
            {"x": (1.0, 3.0)},
            {"x": -1.01},
            r"^x is .*, outside the logs \(1 to 3\) by more than the width of this range",
        ),
        ({"x": (1.0, 3.0)}, {"x": 5.0}, None),
        ({"x": (1.0, 3.0)}, {"x": 5.01}, r"^x is .*, outside the logs \(1 to 3\) by more than the width of this range"),
        ({"x": (1.0, 3.0)}, {"x": 2.0}, None),
        # What never varied is taken to be as wide as its value is large.
        (NEVER_VARIED, {"x": 8.0, "y": 1.0}, None),
        (NEVER_VARIED, {"x": 8.1, "y": 0.0}, "^x is"),
        (NEVER_VARIED, {"x": 4.0, "y": 1.1}, "^y is"),
        ({"a": (0.0, 1.0), "b": (0.1, 3.0)}, {"a": 1.5, "b": 800.0}, r"^b is 800,"),
        # Words, and stages that no trajectory came to.
        (None, {"x": 1e9}, None),
        ({"x": {"red": 3}}, {"x": "mauve"}, None),
    ],
)
def test_more_than_a_whole_range_beyond_an_end_is_refused(ranges, values, refused):
    result = {name: {name: value} for name, value in values.items()}
    if refused is None:
        refuse_far(ranges, result)
        return
    with pytest.raises(PolicyError, match=refused) as refusal:
        refuse_far(ranges, result)
    assert "--extrapolate" in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_stage_that_no_trajectory_came_to_is_reported():
    assert beyond(None, {}) == ("no trajectory of the logs reached this stage; Q is extrapolated",)


@pytest.mark.parametrize(
    ("seen", "value", "says"),
    [
        ((0.1013, 0.9998), 1, "1, outside the logs (0.1013 to 0.9998)"),
        ((0.101, 0.9998), 0.9999, "0.9999, outside the logs (0.101 to 0.9998)"),
        ((0.0, 1.0), 1.0000000000000002, "1.0000000000000002, outside the logs (0 to 1)"),
        ((0.0, 1.0), 1.0, None),
        ((-1e-7, 1.0), -1e-7, None),
        ((1e-7, 1.0), 0.0, "0, outside the logs (1e-07 to 1)"),
    ],
)
def test_ranges_are_compared_without_rounding_and_distinguished(seen, value, says):
    result = beyond({"x": seen}, {"x": {"x": value}})
    assert result == (() if says is None else (f"x is {says}; Q is extrapolated",))
    assert beyond({"x": seen}, {"x": {"x": value}}, 1e-2) == ()


def test_a_decider_that_stays_within_refuses_whatever_is_outside():
    decider = decider_of(FLAT, lambda stage: {"x": (0.0, 1.0)} if stage == 1 else None, stays_within=True)
    assert decider.decide(seen(1.0)).warnings == ()
    for asked, says in ((seen(1.0000001), "outside the logs"), (seen(0.5, 2), "no trajectory of the logs reached")):
        with pytest.raises(OutOfRangeError, match=says):
            decider.decide(asked)


def test_what_chance_explains_is_decided_with_a_warning_and_more_is_refused_with_the_margin():
    decider = decider_of(FLAT, lambda _: {"x": (0.0, 1.0)}, stays_within=True, margins=lambda _: {"x": (0.25, 0.5)})
    for x in (-0.25, 1.5):
        assert decider.decide(seen(x)).warnings == (f"x is {x:g}, outside the logs (0 to 1); Q is extrapolated",)
    for x in (-0.2500001, 1.75):
        with pytest.raises(OutOfRangeError, match=r"farther outside the logs than chance explains \(-0.25 to 1.5\)"):
            decider.decide(seen(x))


@pytest.mark.parametrize(
    ("largest", "expected"),
    [
        ([2.0] * 50, 0.0),
        ([1.0], 0.0),
        # The three largest of nine exceed the next by (1 + 2 + 6) / 3.
        ([0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 2.0, 3.0, 7.0], 3.0 * np.log(2.0 * 4 / (9 * 0.01))),
    ],
)
def test_a_margin_is_the_mean_excess_times_the_log_of_how_much_chance_is_to_be_left(largest, expected):
    assert margin(np.array(largest), 4) == pytest.approx(expected)


@pytest.mark.slow
def test_fresh_states_of_many_covariates_are_seldom_outside():
    rng, shares = np.random.default_rng(0), []
    for _ in range(40):
        log, fresh = rng.exponential(size=(100, 20)), rng.exponential(size=(2000, 20))
        shares.append((fresh > log.max(axis=0) + [margin(column, 20) for column in log.T]).any(axis=1).mean())
    assert np.mean(shares) < 0.02


# Reasons in words: what speaks for an action beside the next best
STATE = first_state(
    Scene(np.array([[0.0, 0.0, 0.62], [0.05, 0.0, 0.3], [0.0, 0.0, 0.0]])), horizon=4, dirty_share=0.6
).state
PRIOR = float(np.log(0.6 / 0.4))
WORTHS = ("FINISH", "WASH_0", "WASH_1", "WASH_2", "LIFT_0", "LIFT_1", "LIFT_2")


def reason(changed, worths, chances=None, worst_wash=None):
    """Of the best action in a state that was changed; what is not named is worth −9."""
    state = replace(STATE, **{name: np.array(value) for name, value in changed.items()})
    explanation = TableExplanation.of(state, dirty_share=0.6, worst_wash=worst_wash)
    return table_reason(explanation, np.array([worths.get(name, -9.0) for name in WORTHS]), chances)


SURE = {"log_odds": [0.5, 0.5, 3.0]}


@pytest.mark.parametrize(
    ("changed", "worths", "worst_wash", "message"),
    [
        (
            {},
            {"WASH_0": 1.2, "LIFT_2": 2.0},
            None,
            "LIFT 2: worth 0.80 more than WASH 0; it would uncover 62% of object 0 and 30% of object 1, not labelled "
            "yet; as for WASH 0, it is half hidden (0.62), and not labelled yet.",
        ),
        (
            {},
            {"LIFT_0": 2.0, "FINISH": 0.0},
            None,
            "LIFT 0: worth 2.00 more than FINISH; it would show its own hidden 62%, not labelled yet; as for "
            "FINISH, none of the 3 objects left is labelled yet.",
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
def test_a_lift_is_reported_by_what_it_would_reveal_and_a_wash_by_how_sure_it_is(changed, worths, worst_wash, message):
    assert reason(changed, worths, worst_wash=worst_wash) == message


@pytest.mark.parametrize(
    ("changed", "worths", "message"),
    [
        ({"log_odds": [2.0, PRIOR, 0.0]}, {"LIFT_2": 1.0, "LIFT_1": 0.5}, "62% of object 0 (probably dirty, 0.88)"),
        ({"seen": [0.3, 0.3, 0.4]}, {"LIFT_0": 1.0}, "show its own hidden 62%"),
        ({"seen": [0.3, 0.3, 0.4], "hides": [[0.0] * 3] * 3}, {"LIFT_2": 1.0}, "show the 60% of it that no label"),
        ({"attempt_object": [0, 0, 1, -1]}, {"WASH_0": 1.0}, "; it slipped 2 times;"),
        ({}, {"FINISH": 1.0, "WASH_0": 1.0}, "FINISH: worth as much as WASH 0"),
        (
            {"log_odds": [-2.5, -3.0, -0.1]},
            {"FINISH": 0.0},
            "FINISH: worth 9.00 more than WASH 0; the object most likely dirty of the 3 left, 2, is in plain sight and "
            "as likely clean as dirty (0.48); as for WASH 0,",
        ),
    ],
)
def test_what_is_known_is_reported_object_by_object(changed, worths, message):
    assert message in reason(changed, worths)


def test_what_a_wrong_wash_costs_is_reported_once_and_where_it_is_known():
    both = reason(SURE, {"WASH_0": 1.5, "WASH_1": 1.0}, worst_wash=-10.0)
    assert both.count("costs up to 10") == 1
    assert "(0.62), and a wrong WASH costs up to 10; as for WASH 1" in both
    assert "costs" not in reason(SURE, {"WASH_0": 1.0, "LIFT_0": 0.5})


def test_how_sure_it_is_stands_with_what_it_is_worth():
    worths = {"FINISH": 1.0, "WASH_0": 0.5}
    assert ", and best with a chance of 71%; none" in reason({}, worths, {"FINISH": 0.71, "WASH 0": 0.29})
    doubted = reason({}, worths, {"FINISH": 0.3, "WASH 0": 0.7})
    assert (
        "best with a chance of 30%; WASH 0 is more likely the best (70%), but has less support in the logs;" in doubted
    )


POLICY = DiscretePolicy(
    actions=("A", "B", "C"),
    covariates=("x1", "x2"),
    is_possible=np.array([[True, True, False], [False, False, True]]),
    coefficients=np.array([[[0.0, 1.0, 0.0], [0.5, 0.0, 0.0], [9.0, 0.0, 0.0]]] * 2),
)
ROW, FLAG = {"x1": 0.8, "x2": 3.0}, {"x1": (0.0, 1.0), "x2": (0.0, 1.0)}


@pytest.mark.parametrize(
    ("row", "stage", "ranges", "message"),
    [
        (
            ROW,
            1,
            {"x1": (-1.0, 1.0), "x2": (0.0, 4.0)},
            "A: worth 0.30 more than B; mainly because x1 is 0.8: at 0 (mid-range in the logs), it would "
            "be worth 0.50 less than B.",
        ),
        (
            ROW,
            1,
            {"x1": (0.9, 1.1), "x2": (0.0, 4.0)},
            "A: worth 0.30 more than B; no covariate favours it more than its usual value does.",
        ),
        ({**ROW, "x1": 0.8004}, 1, {"x1": (0.6, 1.0), "x2": (0.0, 4.0)}, "... no covariate favours it more"),
        (ROW, 1, None, "A: worth 0.30 more than B."),
        ({"x1": True, "x2": 1.0}, 1, FLAG, "... mainly because x1 is 1: at 0, it"),
        ({"x1": False, "x2": 1.0}, 1, FLAG, "... x1 is 0: at 1"),
        ({"x1": 3, "x2": 1}, 1, {"x1": (0.0, 3.0), "x2": (0.0, 4.0)}, "... at 1 (mid-range in the logs)"),
        (ROW, 2, None, "C: no other action is possible."),
    ],
)
def test_the_covariate_that_speaks_most_for_an_action_is_held_against_the_middle_of_its_range(
    row, stage, ranges, message
):
    found = flat_reason(POLICY, row, stage, ranges)
    assert message.removeprefix("... ") in found if message.startswith("...") else message == found
