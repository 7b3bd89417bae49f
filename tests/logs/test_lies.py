"""Logs that cannot be true: each lie is found in a cell of four actions, and an honest log of it raises no doubt."""

import warnings
from functools import cache

import numpy as np
import pandas as pd
import pytest
from scipy import stats

from halfseen.errors import ArgumentError
from halfseen.evaluation import evaluate
from halfseen.evaluation.targets import FixedSequence
from halfseen.logs import Logs
from halfseen.logs.data_quality import data_warnings
from halfseen.logs.grouping import coded, grouped, grouped_covariates, rows_with
from halfseen.logs.plausibility import (
    chance_of_shorter,
    copied_trajectories,
    excess_p,
    imbalance_p,
    outcomes_among_covariates,
)
from small_logs import log_of

ACTIONS = ("vacuum", "fingers", "shake", "skip")
CHANCE = {"vacuum": 0.8, "fingers": 0.5, "shake": 0.0, "skip": 0.0}


def a_part(number, rng):
    """Stages of one part, each with its outcome, and when it was cut."""
    shine, elapsed_s, cut_s, rows = rng.random(), 0.0, rng.exponential(25.0), []
    for stage in range(1, 6):
        p = np.full(4, 0.0625)
        p[0 if shine < 0.7 else 2] += 0.75
        action = ACTIONS[rng.choice(4, p=p)]
        is_won, lasts_s = rng.random() < CHANCE[action] * (1.0 - 0.6 * shine), rng.gamma(6.0, 0.8)
        row = {"trajectory": number, "stage": stage, "action": action, "probability": p[ACTIONS.index(action)]}
        row |= {"shine": shine, "won": float(is_won)}
        if elapsed_s + lasts_s > cut_s:
            rows.append(row | {"elapsed_s": np.nan, "reward": np.nan})
            return rows, {"trajectory": number, "end_s": cut_s, "ending": "cut", "cause": "operator"}
        elapsed_s += lasts_s
        rows.append(row | {"elapsed_s": elapsed_s, "reward": float(is_won)})
        if is_won or action == "skip":
            break
        shine = rng.random()
    return rows, {"trajectory": number, "end_s": elapsed_s, "ending": "finished", "cause": None}


@cache
def tables(num_parts=400, seed=0):
    rng = np.random.default_rng(seed)
    rows, trajectories = zip(*(a_part(number, rng) for number in range(num_parts)), strict=True)
    return pd.DataFrame([row for each in rows for row in each]), pd.DataFrame(trajectories)


def kinds(stages, trajectories):
    logs = Logs(stages.drop(columns="won", errors="ignore"), trajectories)
    return {each.kind for each in data_warnings(logs)}


def as_finished(stages, trajectories):
    end_s = stages["trajectory"].map(trajectories.set_index("trajectory")["end_s"])
    stages = stages.assign(elapsed_s=stages["elapsed_s"].fillna(end_s), reward=stages["reward"].fillna(0.0))
    return stages, trajectories.assign(ending="finished", cause=None)


def with_clock(stages, trajectories):
    begun_s = stages.groupby("trajectory")["elapsed_s"].shift(fill_value=0.0)
    return stages.assign(clock=1.7e9 + 60.0 * stages["trajectory"] + begun_s), trajectories


def in_milliseconds(stages, trajectories):
    return stages.assign(elapsed_s=1000 * stages["elapsed_s"]), trajectories.assign(end_s=1000 * trajectories["end_s"])


def with_comma(x):
    return f"{x:.1f}".replace(".", ",")


def in_thousands(x):
    return f"{int(900 + 400 * round(x, 1)):,}"


LIES = {
    "the rule's own chance": ("untrue-probability", lambda s, p: (s.assign(probability=0.8125), p)),
    "one probability for all": ("untrue-probability", lambda s, p: (s.assign(probability=0.25), p)),
    "the outcome among covariates": ("outcome-as-covariate", lambda s, p: (s.assign(vacuum_bar=s["won"]), p)),
    "cuts called finished": ("cut-called-finished", as_finished),
    "the number of the part": ("identifier", lambda s, p: (s.assign(part=s["trajectory"] + 70_000), p)),
    "the clock": ("identifier", with_clock),
    "milliseconds": ("long-clock", in_milliseconds),
    "decimal commas": ("number-as-text", lambda s, p: (s.assign(shine=s["shine"].map(with_comma)), p)),
    "separators of thousands": ("number-as-text", lambda s, p: (s.assign(mass_mg=s["shine"].map(in_thousands)), p)),
    "one action": ("one-action", lambda s, p: (s.assign(action="vacuum", probability=1.0), p)),
    "no alternative": (
        "no-alternative",
        lambda s, p: (s.assign(action=s["action"].where(s["shine"] < 0.7, "shake")), p),
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", LIES)
def test_a_lie_is_found(name):
    kind, lie = LIES[name]
    assert kind in kinds(*lie(*tables()))


def test_what_depends_on_the_action_was_written_down_after_it():
    stages, trajectories = tables(1000)
    load = stages["action"].eq("fingers") + 0.3 * np.random.default_rng(1).standard_normal(len(stages))
    assert kinds(stages.assign(load=load), trajectories) == {"leak"}


@pytest.mark.parametrize("seed", range(5))
def test_an_honest_log_raises_no_doubt(seed):
    assert kinds(*tables(300, seed)) == set()


@pytest.mark.slow
def test_hardly_an_honest_log_raises_a_doubt():
    assert sum(bool(kinds(*tables(num, seed))) for num in (60, 300) for seed in range(100, 200)) <= 4


def test_a_covariate_that_foretells_much_and_was_known_before_raises_no_doubt():
    rng, num = np.random.default_rng(0), 500
    x, action = rng.random(num), rng.integers(0, 2, num)
    seen = {"trajectory": range(num), "elapsed_s": rng.gamma(4.0, 1.0, num), "x": x}
    seen |= {"action": np.where(action, "A", "B"), "reward": 3.0 * x + 0.1 * action}
    assert data_warnings(log_of(**seen, probability=0.5)) == ()
    # Without probabilities nobody can tell.
    (said,) = outcomes_among_covariates(log_of(**seen))
    (x_group,) = grouped_covariates(log_of(**seen), log_of(**seen).stages)
    reward = pd.Series(seen["reward"])
    by_action, by_both = (reward - reward.groupby(by).transform("mean") for by in (action, [action, x_group.group]))
    left = (by_both @ by_both / (num - 2 * x_group.num_groups)) / (by_action @ by_action / (num - 2))
    assert f"explains {1.0 - left:.0%} of" in said
    assert list(outcomes_among_covariates(log_of(**seen), of=("y",))) == []


@pytest.mark.parametrize(
    ("name", "values", "kind"),
    [
        ("jam", pd.array([k % 2 == 0 for k in range(120)], dtype="boolean"), set()),
        ("jam", np.arange(120) % 2 == 0, set()),
        ("part", pd.array(range(120), dtype="Int64"), {"identifier"}),
        ("colour", pd.Categorical(["red", "blue"] * 60), set()),
        ("mass", pd.array([f"{k},5" for k in range(120)], dtype="string"), {"number-as-text"}),
        ("level", [f"{k % 4}.5" for k in range(120)], {"number-as-text"}),
        ("lamp", ["on", "nan", "off", " NULL"] * 30, {"missing-as-text"}),
        ("tool", ["none", "NA", "a", "b"] * 30, set()),
        ("floor", [f"{k % 4}" for k in range(120)], set()),
        ("probability", np.full(120, 1e-300), {"untrue-probability"}),
    ],
    ids=["boolean", "bool", "Int64", "category", "string", "fractions", "missing", "names", "digits", "tiny"],
)
def test_columns_of_all_kinds_are_looked_at_without_a_warning(name, values, kind):
    rng, num = np.random.default_rng(0), 120
    seen = {"trajectory": range(num), "elapsed_s": rng.gamma(3.0, 1.0, num), "probability": 0.5}
    seen |= {"action": rng.choice(["A", "B"], num), "reward": rng.random(num), "x": rng.random(num)}
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert {each.kind for each in data_warnings(log_of(**seen | {name: values}))} == kind


def evaluated(stages, trajectories, **options):
    logs = Logs(stages.drop(columns="won", errors="ignore"), trajectories)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return evaluate(FixedSequence(("vacuum",) * 5), logs, against="logging", **options)


def test_the_number_of_a_row_is_no_covariate():
    rng, num = np.random.default_rng(0), 40
    seen = {
        "trajectory": np.repeat(range(num), 6),
        "stage": np.tile(range(1, 7), num),
        "elapsed_s": np.tile(np.cumsum(rng.gamma(0.5, 1.0, 6)), num),
    }
    seen |= {"action": rng.choice(["A", "B"], 6 * num), "reward": rng.random(6 * num), "x": rng.random(6 * num)}
    for row in (np.arange(6 * num), np.arange(6.0 * num)[::-1] + 7):
        result = [each.sentence for each in data_warnings(log_of(**seen, row=row)) if each.kind == "identifier"]
        assert result == ["covariate row numbers the rows, which predicts nothing about the next one: leave it out"]
    assert "identifier" not in {
        each.kind for each in data_warnings(log_of(**seen, row=rng.permutation(960)[: 6 * num]))
    }


@pytest.mark.slow
def test_no_verdict_rests_on_copies_unless_they_are_trusted():
    once = tables(500)
    stages, trajectories = (
        pd.concat([each, again.assign(trajectory=again["trajectory"] + 1000)])
        for each, again in ((each, each[each["trajectory"] < 100]) for each in once)
    )
    result = evaluated(stages, trajectories)
    assert result.verdict == "inconclusive"
    assert " trajectories are copies of another" in result.reason
    assert "--trust-trajectories" in result.reason
    assert evaluated(stages, trajectories, trust=("trajectories",)).verdict == evaluated(*once).verdict == "better"
    few = [each[each["trajectory"] < 1005] for each in (stages, trajectories)]
    assert evaluated(*few).verdict == "better"


def test_trajectories_of_a_coarse_clock_may_agree():
    rng, num = np.random.default_rng(0), 4000
    ticks = rng.integers(1, 9, (num, 2)).cumsum(axis=1)
    seen = {"trajectory": np.repeat(range(num), 2), "stage": np.tile([1, 2], num), "elapsed_s": ticks.ravel() / 16.0}
    logs = log_of(**seen, action=rng.choice(["A", "B"], 2 * num), reward=rng.integers(0, 2, 2 * num))
    assert not any(copied_trajectories(logs))


@pytest.mark.slow
def test_no_verdict_rests_on_probabilities_that_nobody_had_unless_they_are_trusted():
    stages, trajectories = tables(1000)
    honest, result = evaluated(stages, trajectories), evaluated(stages.assign(probability=0.8125), trajectories)
    assert honest.verdict == "better"
    assert result.verdict == result.comparisons[0].verdict == "inconclusive"
    assert "the log cannot be true" in result.reason
    assert "--trust-probabilities" in result.reason
    # What cannot be said anyway keeps its reason, and the doubt is noted.
    few = evaluated(*(each[each["trajectory"] < 60] for each in (stages.assign(probability=0.8125), trajectories)))
    assert (few.verdict, few.reason == result.reason) == ("inconclusive", False)
    assert "the log cannot be true" in few.notes[0]
    trusted = evaluated(stages.assign(probability=0.8125), trajectories, trust=("probabilities",))
    assert trusted.verdict == "better"
    assert trusted.doubly_robust == result.doubly_robust
    with pytest.raises(ArgumentError, match="trust is 'all'; give a list of some of probabilities, covariates"):
        evaluated(stages, trajectories, trust=("all",))


@pytest.mark.parametrize("lie", [as_finished, lambda s, p: (s.assign(vacuum_bar=s["won"]), p)], ids=["ends", "leak"])
def test_no_verdict_rests_on_cuts_called_ends_or_on_outcomes_among_covariates(lie):
    assert evaluated(*lie(*tables(1000))).verdict == "inconclusive"


def test_the_bound_of_an_excess_holds():
    rng, group = np.random.default_rng(0), np.zeros(200, dtype=np.int64)
    p = 0.25
    found = []
    for _ in range(2000):
        took = rng.random(200) < p
        found.append(excess_p(np.full(took.sum(), 1.0 / p), group[took], 1, np.array([200.0]))[0])
    assert np.mean(np.array(found) < 0.05) <= 0.05


def test_an_imbalance_is_rare_where_there_is_none_and_sure_where_there_is_one():
    rng, group = np.random.default_rng(0), np.arange(400) % 4
    even = [imbalance_p(rng.random(400) < 0.5, np.full(400, 0.5), group, 4) for _ in range(1000)]
    assert np.mean(np.array(even) < 0.05) < 0.08
    assert imbalance_p(rng.random(400) < np.where(group == 0, 0.9, 0.4), np.full(400, 0.5), group, 4) < 1e-5


@pytest.mark.parametrize("exploring", [0.04, 0.1, 0.3])
def test_an_imbalance_is_rare_where_an_action_is(exploring):
    # A rule by group that explores: where A is rare, it may have been taken by no stage of the group at all.
    rng, group = np.random.default_rng(3), np.arange(100) % 5
    chance = np.where(group < 2, 1.0 - exploring / 2.0, exploring / 2.0)
    found = 0
    for _ in range(1000):
        took = rng.random(100) < chance
        found += imbalance_p(took, np.where(took, chance, 1.0 - chance), group, 5) < 0.01
    assert found <= 10


def test_values_are_grouped_by_fifths_and_names_by_name():
    numbers, names = grouped("x", pd.Series(np.arange(100.0))), grouped("colour", pd.Series(["red", "blue", "red"]))
    assert numbers is not None
    assert names is not None
    assert np.bincount(numbers.group).tolist() == [20] * 5
    assert numbers.words[0] == "19.8 or less"
    assert (names.group.tolist(), names.words) == ([0, 1, 0], ("'red'", "'blue'"))
    assert grouped("number", pd.Series([f"part {k}" for k in range(50)])) is None
    assert grouped("same", pd.Series([1.0, 1.0])) is None
    assert grouped("parts", pd.Series([[1], [2]])) is None
    late = pd.Series([0.0] * 3000 + [1.0] * 1000)  # a long beginning with one value
    assert grouped("late", late).words == ("0.0", "1.0")


@pytest.mark.parametrize(
    "names",
    [
        pd.Series(["b", "a", "b", "ä"]),
        pd.Series([10, 9, 10]),
        pd.Series([10, 9], dtype="Int64"),
        pd.Series(["b", "a", "b"], dtype="category"),
        pd.Series([], dtype=object),
    ],
)
def test_actions_are_numbered_in_the_order_of_their_text(names):
    code, words = coded(names)
    texts = [str(name) for name in names]
    assert list(words) == sorted(set(texts))
    assert [words[k] for k in code] == texts


def test_rows_with_all_that_is_asked_for_are_kept():
    table = pd.DataFrame({"a": [1.0, None, 3.0, 4.0], "b": ["x", "y", None, "z"], "c": None})
    assert rows_with(table, "a", "b").index.tolist() == [0, 3]
    assert rows_with(table, "a", "b", most=1).index.tolist() == [0]
    whole = table.iloc[:1]
    assert rows_with(whole, "a", "b") is whole


@pytest.mark.parametrize("seed", range(5))
def test_the_chance_of_being_shorter_is_scipy_s(seed):
    rng = np.random.default_rng(seed)
    one, other = rng.normal(-0.3, 1.0, 12 + seed).round(1), rng.normal(size=15).round(1)
    wanted = stats.mannwhitneyu(one, other, alternative="less", method="asymptotic").pvalue
    assert chance_of_shorter(one, other) == pytest.approx(wanted, rel=1e-12)
    assert chance_of_shorter(np.ones(10), np.ones(12)) == 1.0
