from datetime import date

import numpy as np
import pandas as pd
import pytest

from halfseen.errors import ArgumentError, LogError
from halfseen.learning import CensoredQLearner, DoublyRobust, Weighted
from halfseen.learning.covariates import (
    MOST_CATEGORIES,
    Covariates,
    fit_covariates,
    learned_categories,
    unfit_covariates,
)
from halfseen.logs import Logs, LogStream
from text_logs import ACTIONS, BY_HAND, COLOURS, COVARIATES, by_hand, text_log, with_indicators

STATES = pd.DataFrame({"x": [0.3, -1.0, 0.0, 2.0], "colour": ["red", "blue", "green", "red"], "is_heavy": [True] * 4})


@pytest.fixture(scope="module")
def logs():
    return text_log()


def learner(covariates=COVARIATES, **parameters):
    return CensoredQLearner.of_paper(2, ACTIONS, covariates, **{"reg": 0.01, **parameters})


@pytest.mark.parametrize(
    "parameters",
    [
        {"reg": 0.0},
        {"q_function": "quadratic"},
        {"q_function": "kernel", "stages": "pooled"},
        {"q_function": "smooth", "censoring": "buckley-james", "pessimism": 1.0},
        {"censoring": Weighted("cox")},
        {"censoring": DoublyRobust("cox", by="stage", covariates=["colour", "action"], outcome_covariates=["colour"])},
    ],
    ids=str,
)
def test_text_is_learned_from_as_pandas_would_encode_it(logs, parameters):
    ours, other = learner(**parameters).fit(logs), dict(parameters)
    if isinstance(other.get("censoring"), DoublyRobust):
        indicators = ["colour=green", "colour=red"]
        other["censoring"] = DoublyRobust(
            "cox", by="stage", covariates=[*indicators, "action"], outcome_covariates=indicators
        )
    theirs = learner(BY_HAND, **other).fit(by_hand(logs))
    np.testing.assert_array_equal(ours.weights_, theirs.weights_)
    for stage in (1, 2):
        np.testing.assert_allclose(
            ours.q_values(STATES, stage), theirs.q_values(with_indicators(STATES), stage), rtol=1e-9, atol=1e-9
        )
        assert list(ours.decide(STATES, stage)) == list(theirs.decide(with_indicators(STATES), stage))


def test_the_policy_looks_at_what_the_text_says(logs):
    assert list(learner().fit(logs).decide(STATES, 1)) == ["B", "A", "A", "B"]


def test_a_stream_learns_categories_from_all_its_parts(logs, tmp_path):
    late = logs.stages.assign(colour=logs.stages["colour"].where(logs.stages["trajectory"] < 40, "violet"))
    log = Logs(late, logs.trajectories)
    log.write(tmp_path / "logs")
    whole = learner(censoring=Weighted("cox")).fit(log)
    parts = learner(censoring=Weighted("cox")).fit(LogStream(tmp_path / "logs", trajectories_at_once=20))
    assert parts.policy_.categories == {"colour": ("blue", "green", "red", "violet")}
    np.testing.assert_allclose(parts.policy_.coefficients, whole.policy_.coefficients, atol=1e-9)


def test_an_unknown_category_is_named_with_those_that_are_known(logs):
    policy = learner().fit(logs)
    strange = logs.stages.assign(colour=logs.stages["colour"].where(logs.stages.index != 5, "mauve"))
    row = strange.iloc[5]
    told = (
        f"trajectory {row['trajectory']}, stage {row['stage']}: covariate 'colour' is 'mauve', which the log that was "
        "learned from never showed; known are 'blue', 'green', 'red': give one of these, or learn again from logs that "
        "show 'mauve'"
    )
    for ask in (policy.q_values, policy.decide):
        with pytest.raises(LogError) as refusal:
            ask(strange, 1)
        assert str(refusal.value) == told
    with pytest.raises(LogError, match="row 1: covariate 'colour' is null; fill it in"):
        policy.decide(STATES.assign(colour=["red", None, "blue", "red"]), 1)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (
            lambda trajectory, stage: None if trajectory == 7 and stage == 1 else "ok",
            "is null at trajectory 7, stage 1; fill it in",
        ),
        (
            lambda trajectory, stage: f"{trajectory % (MOST_CATEGORIES + 1)}",
            f"has more than {MOST_CATEGORIES} categories",
        ),
        (lambda trajectory, stage: "always", "is 'always' in every stage"),
        (lambda trajectory, stage: date(2026, 1, 1 + trajectory % 3), "holds date, neither numbers nor text"),
        (lambda trajectory, stage: [1.0, 2.0], "holds mixed, neither numbers nor text"),
        (lambda trajectory, stage: True if trajectory % 2 else None, "is null at trajectory 0, stage 1"),
    ],
)
def test_what_cannot_be_looked_at_is_refused_where_it_is_asked_for(make, message):
    log = text_log(num_trajectories=40, other=make)
    for refused, ask in (
        (LogError, lambda: learner(["x", "other"]).fit(log)),
        (ArgumentError, lambda: learner(["x"], censoring=Weighted("cox", covariates=["other"])).fit(log)),
    ):
        with pytest.raises(refused) as refusal:
            ask()
        assert f"covariate 'other' {message}" in str(refusal.value)
        assert "\n" not in str(refusal.value)
    assert unfit_covariates([log])["other"].startswith(message)
    assert fit_covariates(log) == COVARIATES
    learner().fit(log)


def test_a_name_of_trajectories_is_told_from_a_category_across_the_parts_of_a_log():
    names = [text_log(num_trajectories=15, order=lambda trajectory, stage: f"{trajectory}")]
    parts = [
        text_log(num_trajectories=2, order=lambda trajectory, stage: f"{trajectory}"),
        text_log(num_trajectories=2, order=lambda p, s: "1"),
    ]
    with pytest.raises(LogError, match="no category that two trajectories share"):
        learned_categories(names, ["order"], {})
    assert learned_categories(parts, ["order"], {})["order"] == ("0", "1")


def test_categories_may_be_numbers_or_truth_where_the_column_says_that_they_are_categories(logs):
    bins = pd.Categorical((logs.stages["x"] > 0).astype(int) + 1)
    log = Logs(logs.stages.assign(bin=bins, is_heavy=logs.stages["is_heavy"].map(str)), logs.trajectories)
    fitted = learner(["bin", "is_heavy"]).fit(log)
    assert fitted.policy_.categories == {"bin": ("1", "2"), "is_heavy": ("False", "True")}
    as_numbers = fitted.q_values(pd.DataFrame({"bin": [1, 2], "is_heavy": [True, False]}), 1)
    as_text = fitted.q_values(pd.DataFrame({"bin": ["1", "2"], "is_heavy": ["True", "False"]}), 1)
    np.testing.assert_array_equal(as_numbers, as_text)


def test_features_are_named_and_know_their_column():
    looks_at = Covariates(("colour", "x", "size"), {"colour": COLOURS, "size": ("L",)})
    assert looks_at.names == ("colour=green", "colour=red", "x")
    assert looks_at.sources == ("colour", "colour", "x")
    encoded = looks_at.encode(pd.DataFrame({"x": [4], "size": ["L"], "colour": ["green"]}))
    np.testing.assert_array_equal(encoded, [[1.0, 0.0, 4.0]])
    assert Covariates(()).encode(pd.DataFrame(index=range(3))).shape == (3, 0)
