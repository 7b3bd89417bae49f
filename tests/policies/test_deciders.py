"""The port: heuristics, planners and learned policies, of named actions or of tables, answer alike."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from halfseen.errors import ArgumentError, LogError, PolicyError
from halfseen.learning import FlatPolicy
from halfseen.planners import GreedyPolicy, POMDPPolicy
from halfseen.policies import Decider, NamedObservation, decider_of
from halfseen.policies.certainty import QError
from halfseen.policies.ranges import beyond, refuse_far
from halfseen.tables import LinearTablePolicy
from halfseen.tables.features import NUM_FEATURES, table_features
from halfseen.tables.present import first_state
from halfseen.world import Scene, UniformPolicy, WorldConfig, random
from halfseen.world.actions import ActionSpace, Verb

CONFIG = WorldConfig(horizon=4)
NOW = first_state(Scene(np.array([[0.0, 0.6], [0.0, 0.0]])), horizon=4, dirty_share=0.6)
NAMES = ActionSpace(2).names
COEFFICIENTS = 0.1 * random.normal(random.key_of(0), 4, len(Verb), NUM_FEATURES + 1)
FLAT = FlatPolicy(
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


@pytest.mark.parametrize("policy", TABLES.values(), ids=TABLES)
def test_a_table_gets_a_possible_action_a_reason_and_the_same_again(policy):
    decider = decider_of(policy)
    decision = decider.decide(NOW)
    assert isinstance(decider, Decider)
    assert decision.action in NAMES
    assert decision.reason.startswith(f"{decision.action}: ")
    assert decision.warnings == ()
    assert decider.decide(NOW) == decision


@pytest.mark.parametrize("name", ["planner", "learned"])
def test_the_action_is_the_best_by_the_values_that_are_told(name):
    decision = decider_of(TABLES[name]).decide(NOW)
    assert decision.action == max(decision.q_values, key=lambda action: decision.q_values[action])
    taken = TABLES[name].decide(NOW.state, random.key_of(0)).action
    assert NAMES[int(taken)] == decision.action


def test_a_rule_that_values_nothing_says_by_whom_it_decides():
    decision = decider_of(TABLES["heuristic"]).decide(NOW)
    assert decision.q_values == {}
    assert "by GreedyPolicy; it is in plain sight, nothing is known yet of" in decision.reason
    assert (decision.intervals, decision.chance_best) == ({}, {})


def test_named_actions_answer_through_the_same_door():
    decider = decider_of(FLAT, lambda stage: {"x": (0.0, 1.0)})
    decision = decider.decide(NamedObservation(pd.DataFrame({"x": [2.0]}), 1))
    assert (decision.action, decision.q_values) == ("A", {"A": 2.0, "B": 0.5})
    assert decision.warnings == ("x is 2, outside the logs (0 to 1); Q is extrapolated",)
    assert decider.decide(NamedObservation(pd.DataFrame({"x": [0.2]}), 2)).q_values == {"A": 0.2, "B": None}
    assert decider_of(FLAT).decide(NamedObservation(pd.DataFrame({"x": [2.0]}), 1)).warnings == ()


def test_what_is_no_policy_or_no_observation_is_refused():
    with pytest.raises(ArgumentError, match="is no policy"):
        decider_of(object())
    with pytest.raises(LogError, match="finite"):
        decider_of(FLAT).decide(NamedObservation(pd.DataFrame({"x": [np.nan]}), 1))
    with pytest.raises(ArgumentError, match="stage is 3"):
        decider_of(FLAT).decide(NamedObservation(pd.DataFrame({"x": [0.0]}), 3))


def test_on_a_table_a_margin_counts_as_far_as_the_log_does_something_else():
    keys = random.split(random.key_of(1), 2)
    root = 0.2 * random.normal(keys[0], 4, len(Verb), NUM_FEATURES + 1, NUM_FEATURES + 1)
    behaviour = random.normal(keys[1], len(Verb), NUM_FEATURES + 1)
    policy = LinearTablePolicy(COEFFICIENTS, margin=root, behaviour=behaviour)
    score, low, q = (
        np.asarray(replace(policy, **changed).q_values(NOW.state))
        for changed in ({}, {"behaviour": None}, {"behaviour": None, "margin": None})
    )
    verbs = np.asarray(ActionSpace(2).verbs)
    design = np.concatenate([np.ones((len(verbs), 1)), np.asarray(table_features(NOW.state))], axis=1)
    chances = np.exp(np.einsum("af,af->a", design, np.asarray(behaviour)[verbs]))
    is_possible = np.isfinite(q)
    chances = np.where(is_possible, chances, 0.0) / chances[is_possible].sum()
    leaning = np.clip((chances - 1 / is_possible.sum()) / (1 - 1 / is_possible.sum()), 0.0, 1.0)
    assert 0.0 < leaning.max() < 1.0
    np.testing.assert_allclose(score[is_possible], (q - (1 - leaning) * (q - low))[is_possible], rtol=1e-4, atol=1e-5)


def test_on_a_table_the_interval_is_of_q_without_its_margin_and_the_chance_that_of_drawn_coefficients():
    keys = random.split(random.key_of(3), 2)
    pessimism, size = 0.5, NUM_FEATURES + 1
    root = 0.1 * random.normal(keys[0], 4, len(Verb), size, size)
    policy = LinearTablePolicy(COEFFICIENTS, margin=pessimism * root)
    decision = decider_of(policy, q_error=QError(pessimism, [1.0])).decide(NOW)
    verbs = np.asarray(ActionSpace(2).verbs)
    design = np.concatenate([np.ones((len(verbs), 1)), np.asarray(table_features(NOW.state))], axis=1)
    q = np.einsum("af,af->a", design, np.asarray(COEFFICIENTS)[3][verbs])
    covariance = np.einsum("kfg,khg->kfh", np.asarray(root)[3], np.asarray(root)[3])[verbs]
    error = np.sqrt(np.einsum("af,afg,ag->a", design, covariance, design))
    for name, middle, deviation in zip(NAMES, q, error, strict=True):
        np.testing.assert_allclose(
            decision.intervals[name], (middle - 1.959964 * deviation, middle + 1.959964 * deviation), atol=1e-4
        )
    rng = np.random.default_rng(5)
    drawn = np.asarray(COEFFICIENTS)[3] + np.einsum(
        "kfg,bkg->bkf", np.asarray(root)[3], rng.normal(size=(40_000, len(Verb), size))
    )
    worth = np.einsum("af,baf->ba", design, drawn[:, verbs])
    often = np.bincount(worth.argmax(axis=1), minlength=len(verbs)) / len(worth)
    assert 0.05 < often.max() < 0.95
    for name, expected in zip(NAMES, often, strict=True):
        assert abs(decision.chance_best[name] - expected) < 0.02
    assert decider_of(policy).decide(NOW).intervals == {}


def test_far_more_objects_than_in_the_logs_are_refused_unless_they_are_to_be_extrapolated():
    ranges = {"num_objects": (5.0, 6.0), "occlusion": (0.0, 0.1), "log_odds": (8.0, 9.0), "num_attempts": (4.0, 4.0)}
    with pytest.raises(PolicyError, match=r"num_objects is 2, outside the logs \(5 to 6\) by more than these span"):
        decider_of(TABLES["learned"], lambda stage: ranges).decide(NOW)
    told = decider_of(TABLES["learned"], lambda stage: ranges, extrapolates=True).decide(NOW)
    assert told.warnings[0] == "num_objects is 2, outside the logs (5 to 6); Q is extrapolated"
    near = ranges | {"num_objects": (3.0, 4.0)}
    assert decider_of(TABLES["learned"], lambda stage: near).decide(NOW).warnings[0].startswith("num_objects is 2")


def test_what_is_not_possible_has_no_value():
    gone = replace(NOW.state, is_on_table=np.array([True, False]))
    values = decider_of(TABLES["learned"]).decide(replace(NOW, state=gone)).q_values
    assert [name for name, value in values.items() if value is None] == ["WASH 1", "LIFT 1"]


def values(**of):
    return {name: {name: value} for name, value in of.items()}


@pytest.mark.parametrize(
    ("value", "is_refused"), [(-1.0, False), (-1.01, True), (5.0, False), (5.01, True), (2.0, False)]
)
def test_more_than_a_whole_range_beyond_an_end_is_refused(value, is_refused):
    ranges, told = {"x": (1.0, 3.0)}, values(x=value)
    if not is_refused:
        refuse_far(ranges, told)
        return
    with pytest.raises(PolicyError, match=r"^x is .*, outside the logs \(1 to 3\) by more than these span") as refusal:
        refuse_far(ranges, told)
    assert "--extrapolate" in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_what_never_varied_is_taken_to_be_as_wide_as_its_value_is_large():
    refuse_far({"x": (4.0, 4.0), "y": (0.0, 0.0)}, values(x=8.0, y=1.0))
    for name, value in (("x", 8.1), ("y", 1.1)):
        with pytest.raises(PolicyError, match=f"^{name} is"):
            refuse_far({"x": (4.0, 4.0), "y": (0.0, 0.0)}, values(x=4.0, y=0.0) | values(**{name: value}))


def test_the_first_that_is_far_is_named():
    with pytest.raises(PolicyError, match=r"^b is 800,"):
        refuse_far({"a": (0.0, 1.0), "b": (0.1, 3.0)}, values(a=1.5, b=800.0))


def test_words_and_stages_that_no_path_came_to_are_not_refused():
    refuse_far(None, values(x=1e9))
    refuse_far({"x": {"red": 3}}, values(x="mauve"))
    assert beyond(None, {}) == ("no path of the logs came to this stage; Q is extrapolated",)
