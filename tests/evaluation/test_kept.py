"""What a policy was promised, beside a log of the same cell, of another, and of swapped columns."""

import re
from typing import Any

import numpy as np
import pandas as pd
import pytest

from halfseen.errors import PolicyError
from halfseen.evaluation.estimate import around
from halfseen.evaluation.kept import drifts_of, kept_promise
from halfseen.learning import CensoredQLearner
from halfseen.logs import Logs
from halfseen.monitoring.streams import input_streams
from halfseen.policies.folder.promised_parts import promised_parts, promised_states
from halfseen.policies.folder.record import Promise, converted

COLUMNS = ("weight", "shine", "colour", "jams")


def log(seed=0, num=400, **changed):
    rng = np.random.default_rng(seed)
    stages = pd.DataFrame({"trajectory": np.repeat(np.arange(num), 2), "stage": np.tile([1, 2], num)})
    stages["elapsed_s"] = np.tile([1.0, 2.0], num)
    stages["action"], stages["reward"] = "PICK", rng.random(2 * num)
    stages["weight"], stages["shine"] = rng.gamma(2.0, 3.0, 2 * num), rng.random(2 * num)
    stages["colour"] = rng.choice(["red", "blue"], 2 * num, p=[0.7, 0.3])
    stages["jams"] = rng.poisson(0.3, 2 * num)
    trajectories = pd.DataFrame({"trajectory": np.arange(num), "end_s": 2.0, "ending": "finished", "cause": None})
    return Logs(stages.assign(**{name: change(stages) for name, change in changed.items()}), trajectories)


PROMISED = promised_states(log(), COLUMNS)


def test_the_distribution_is_what_a_loop_counts():
    logs = log()
    for stage in PROMISED:
        rows: Any = logs.stages[logs.stages["stage"] == stage["stage"]]
        result = stage["covariates"]["weight"]
        for value, share in zip(result["values"], result["below"], strict=True):
            assert share == np.mean([each <= value for each in rows["weight"]])
        assert dict(zip(*stage["covariates"]["colour"].values(), strict=True)) == pytest.approx(
            rows["colour"].value_counts(normalize=True).to_dict()
        )
    assert PROMISED[0]["covariates"]["jams"]["values"][0] == 0.0


@pytest.mark.parametrize("seed", range(1, 11))
def test_a_log_of_the_same_cell_has_not_drifted(seed):
    assert drifts_of(PROMISED, log(seed)) == ((), ())


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("weight", lambda s: 7.0 * s["weight"]),
        ("shine", lambda s: s["shine"] ** 2),
        ("colour", lambda s: np.where(s["shine"] < 0.5, "red", "blue")),
        ("colour", lambda s: "green"),
        ("jams", lambda s: s["jams"] + 1),
        ("jams", lambda s: s["jams"].astype(str)),
    ],
)
def test_a_covariate_that_drifted_is_named(name, change):
    units, found = drifts_of(PROMISED, log(1, **{name: change}))
    assert not units
    assert len(found) == 1
    assert f"covariate {name} is distributed differently" in found[0]
    assert "from stage 1 on" in found[0]


@pytest.mark.parametrize(
    ("name", "factor", "words"),
    [
        ("weight", 1e3, "is 1,000 times as large as .* another unit \\(thousandths\\): divide it by 1,000$"),
        ("weight", 1 / 60, "is 60 times as small as .* the other way round\\): multiply it by 60$"),
        ("shine", 100.0, "is 100 times as large as .*percent for shares.*: divide it by 100$"),
        ("shine", -1.0, "has the opposite sign of .* another direction: multiply it by -1$"),
    ],
)
def test_another_unit_is_named_and_said_first(name, factor, words):
    changed: Any = {name: lambda s: factor * s[name], "jams": lambda s: s["jams"] + 1}
    promise = {"value": {"value": 0.52, "low": 0.4, "high": 0.64, "standard_error": 0.06}, "stages": PROMISED}
    found = kept_promise(promise, log(1, **changed), around(0.5, 0.05, 100, np.inf, 0.95), True)
    (unit,) = found.units
    assert re.search(f"^covariate {name} {words}", unit)
    assert found.lines[0] == f"C{unit[1:]}."
    assert found.lines[1].startswith("Promised")
    assert found.lines[2].startswith("- covariate jams is distributed differently")


@pytest.mark.parametrize(
    ("usual", "now", "is_named"),
    [
        (lambda rng: rng.normal(size=800), lambda rng: 0.4 + rng.normal(size=800), False),
        (lambda rng: 0.1 + rng.normal(size=800), lambda rng: -0.3 + rng.normal(size=800), False),
        (lambda rng: 0.3 + rng.normal(size=800), lambda rng: -0.35 + rng.normal(size=800), False),
        (lambda rng: 2.0 + rng.normal(size=800), lambda rng: -2.0 + rng.normal(size=800), True),
        (lambda rng: rng.gamma(2.0, size=800), lambda rng: -rng.gamma(2.0, size=800), True),
    ],
)
def test_the_opposite_sign_is_named_where_no_small_drift_gives_the_same(usual, now, is_named):
    promised = promised_states(log(shine=lambda _: usual(np.random.default_rng(2))), COLUMNS)
    units, found = drifts_of(promised, log(1, shine=lambda _: now(np.random.default_rng(3))))
    assert len((*units, *found)) == 1
    assert any("the opposite sign" in each for each in units) == is_named


@pytest.mark.parametrize(("kind", "later"), [(np.float32, np.float64), (np.float64, np.float32)])
def test_single_precision_is_no_drift(kind, later):
    def tenths(kind):
        return log(1, shine=lambda s: (s["shine"].round(1) + 0.1).astype(kind))

    promised = promised_states(tenths(kind), COLUMNS)
    assert drifts_of(promised, tenths(later)) == ((), ())
    usual, found = (input_streams(promised, tenths(each)) for each in (kind, later))
    for one, other in zip(usual, found, strict=True):
        np.testing.assert_array_equal(one.bins, other.bins)


def test_numbers_are_the_categories_that_are_written_so():
    promised = promised_states(log(colour=lambda rows: (rows["shine"] > 0.3).astype(int).astype(str)), COLUMNS)
    assert drifts_of(promised, log(1, colour=lambda rows: (rows["shine"] > 0.3).astype(int))) == ((), ())
    (result,) = drifts_of(promised, log(1, colour=lambda rows: rows["shine"]))[1]
    assert "colour is distributed differently" in result


def test_a_drift_of_few_states_is_no_other_unit():
    units, drifts = drifts_of(PROMISED, log(1, num=14, shine=lambda s: s["shine"] + 12.0))
    assert (units, len(drifts)) == ((), 1)


def test_what_drifts_in_a_later_stage_is_reported_of_that():
    _, (found,) = drifts_of(PROMISED, log(1, shine=lambda s: s["shine"].where(s["stage"] == 1, 0.5 * s["shine"])))
    assert "from stage 2 on" in found


def test_swapped_columns_are_reported_as_such():
    found = drifts_of(PROMISED, log(1, weight=lambda s: s["shine"], shine=lambda s: s["weight"]))
    assert found == ((), ("covariates weight and shine look swapped",))


@pytest.mark.parametrize(
    ("value", "is_own", "words"),
    [
        (0.5, True, "it earned 0.5 a trajectory here (0.402 to 0.598): as promised."),
        (0.2, True, ": less than promised."),
        (0.9, False, "it would earn 0.9 a trajectory here (0.802 to 0.998): more than promised."),
    ],
)
def test_what_was_earned_is_beside_what_was_promised(value, is_own, words):
    promise = {"value": {"value": 0.52, "low": 0.4, "high": 0.64, "standard_error": 0.06}, "stages": PROMISED}
    found = kept_promise(promise, log(), around(value, 0.05, 100, np.inf, 0.95), is_own)
    assert found.lines == [found.sentence]
    assert found.sentence.startswith("Promised 0.52 a trajectory (0.4 to 0.64); ")
    assert found.sentence.endswith(words)
    nothing = kept_promise(promise | {"value": None}, log(), around(value, 0.05, 100, np.inf, 0.95), is_own)
    assert nothing.lines == []


@pytest.mark.parametrize(
    "promise",
    [
        {"value": {"value": 1.0}, "stages": []},
        {"value": {"value": np.nan, "low": 0.0, "high": 1.0, "standard_error": 1.0}, "stages": []},
        {"value": None, "stages": [{"stage": 0, "num_states": 3, "covariates": {}}]},
        {"value": None, "stages": [{"stage": 1, "num_states": 3, "covariates": {"x": {"values": [], "below": []}}}]},
        {
            "value": None,
            "stages": [{"stage": 1, "num_states": 3, "covariates": {"x": {"values": [2, 1], "below": [0, 1]}}}],
        },
        {
            "value": None,
            "stages": [{"stage": 1, "num_states": 3, "covariates": {"x": {"names": ["a"], "shares": [2.0]}}}],
        },
    ],
)
def test_what_is_no_promise_is_refused(promise):
    with pytest.raises((PolicyError, KeyError)):
        converted(promise, Promise)
    converted({"value": None, "stages": PROMISED}, Promise)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("times", "words"),
    [
        (
            1000.0,
            "1,000 times as large as in the training log, as if in another unit (thousandths): divide it by 1,000.",
        ),
        (
            1 / 60,
            "60 times as small as in the training log, as if in another unit (seconds for minutes, or minutes for ",
        ),
        (1.3, ""),
        (10.0, ""),
    ],
)
def test_a_clock_in_another_unit_is_named_first(times, words):
    """Also where a later state has a category that the policy does not know."""
    policy = CensoredQLearner(2, ["PICK"], ["weight", "colour"]).fit(log()).policy_
    promise = {"value": None, "stages": [], **promised_parts(log(), policy)}

    later = log(1, colour=lambda s: s["colour"].where(s.index > 0, "green"))
    ends = later.trajectories.assign(end_s=later.trajectories["end_s"] * times)
    later = Logs(later.stages.assign(elapsed_s=later.stages["elapsed_s"] * times), ends)
    found = kept_promise(promise, later, around(0.5, 0.05, 100, np.inf, 0.95), True, policy).units
    assert len(found) == bool(words)
    assert all(each.startswith("the time of a stage is " + words.removesuffix(".")) for each in found)
