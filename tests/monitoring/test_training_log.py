"""Whether a log is of one cell: against a naive loop, part by part, and seldom wrong."""

import numpy as np
import pandas as pd
import pytest

from halfseen.evaluation import FixedSequence
from halfseen.learning import CensoredQLearner, sample
from halfseen.logs import Logs
from halfseen.monitoring.training_log import ALPHA, FEWEST, changes_in, farthest_apart
from small_logs import table_log

BROKEN = {"reward": 1.0, "duration": 1.0, "x": 0.0, "cut": 0.02, "next": 0.5, "colour": 0.0}
NOW = {"reward": 0.2, "duration": 2.0, "x": 1.0, "cut": 0.4, "next": -0.5, "colour": 0.8}


def cell(broken=(), num=240, at=160, seed=0, tends=0.5):
    """Two stages; of the actions A and B, A is better where x is large; what is broken differs from a place on."""
    rng = np.random.default_rng(seed)
    is_late = np.arange(num) >= at
    of = {name: np.where(is_late, NOW[name] if name in broken else BROKEN[name], BROKEN[name]) for name in BROKEN}
    x = [rng.normal(size=num) + of["x"]]
    chosen = [rng.random(num) < tends for _ in range(2)]
    x.append(0.3 * x[0] + of["next"] * chosen[0] + 0.5 * rng.normal(size=num))
    took = [np.exp(0.3 * rng.normal(size=num)) * np.where(is_a, of["duration"], 1.5) for is_a in chosen]
    reward = [
        np.where(is_a, of["reward"] + v, 0.5) + 0.5 * rng.normal(size=num) for is_a, v in zip(chosen, x, strict=True)
    ]
    end_s, cut_s = took[0] + took[1], rng.exponential(size=num) / of["cut"]
    colour = np.where(rng.random(num) < of["colour"] + 0.1, "red", "blue")
    stages, clock = [], np.zeros(num)
    for k in range(2):
        is_begun, clock = clock <= cut_s, clock + took[k]
        is_done = clock <= cut_s
        columns = {"trajectory": np.arange(num), "stage": k + 1, "x": x[k], "colour": colour}
        columns |= {"action": np.where(chosen[k], "A", "B"), "elapsed_s": np.where(is_done, clock, np.nan)}
        stages.append(pd.DataFrame(columns | {"reward": np.where(is_done, reward[k], np.nan)})[is_begun])
    ends = {"trajectory": np.arange(num), "end_s": np.minimum(end_s, cut_s)}
    return Logs(pd.concat(stages), pd.DataFrame(ends | {"ending": np.where(cut_s < end_s, "cut", "finished")}))


@pytest.fixture(scope="module")
def policy():
    return CensoredQLearner.of_paper(2, ["A", "B"], ["x", "colour"], reg=0.01).fit(cell()).policy_


@pytest.mark.parametrize(
    ("broken", "words"),
    [
        ("reward", "A brings 0.[789][0-9]* less than before in the same states"),
        ("duration", "A takes [0-9]+% more time than before in the same states"),
        ("x", "x in stage 1 is larger than before"),
        ("colour", "colour=red in stage 1 is larger than before"),
        ("cut", "cuts are more frequent than before"),
        ("next", "after A, x is smaller than before in the same states"),
    ],
)
def test_the_part_that_changed_is_named_and_since_when(policy, broken, words):
    first = changes_in(cell([broken]), policy)[0]
    assert pd.Series([first.sentence]).str.contains(words).all(), first.sentence
    assert first.since_low <= 160 <= first.since_high
    assert first.num_since == 240 - first.since
    assert first.p_value <= ALPHA


def test_nothing_is_reported_of_one_cell_whoever_decides(policy):
    assert changes_in(cell(), policy) == []
    early, late = cell(num=120, seed=1, tends=0.2), cell(num=120, seed=2, tends=0.9)
    tables = [
        pd.concat([one, other.assign(trajectory=other["trajectory"] + 120)])
        for one, other in ((early.stages, late.stages), (early.trajectories, late.trajectories))
    ]
    assert changes_in(Logs(*tables), policy) == []


def test_the_number_since_is_of_the_whole_log_where_a_sample_is_compared(policy, monkeypatch):
    monkeypatch.setattr(sample, "MOST_TRAJECTORIES", 120)
    first = changes_in(cell(["x"]), policy)[0]
    assert first.num_since == 240 - first.since


def test_farthest_apart_is_what_a_loop_over_places_finds():
    rng = np.random.default_rng(0)
    scores = rng.normal(size=(50, 3))
    scores[rng.random((50, 3)) < 0.3] = np.nan
    scores[:, 2] = 4.0
    least, found = np.array([0.0, 1.7, 0.0]), []
    for column, floor in zip(scores.T, least, strict=True):
        x = column[~np.isnan(column)]
        sigma = max(x.std(), floor)
        places = range(FEWEST, len(x) - FEWEST + 1)
        apart = [
            abs(x[:k].mean() - x[k:].mean()) / (sigma or np.inf) * np.sqrt(k * (len(x) - k) / len(x)) for k in places
        ]
        found.append(max(apart))
    np.testing.assert_allclose(farthest_apart(scores, least), found, atol=1e-9)


def test_of_tables_verbs_and_cuts_are_watched_and_few_trajectories_tell_nothing():
    logs = table_log(40)
    policy = CensoredQLearner.for_table(3, laws=None, grasp=None, reg=0.1).fit(logs).policy_
    assert changes_in(logs, policy) == []
    assert changes_in(table_log(8), policy) == []


@pytest.mark.slow
def test_at_most_one_in_twenty_unchanged_logs_is_reported_of(policy):
    num = 300
    share = np.mean([bool(changes_in(cell(num=120, seed=seed), policy, seed)) for seed in range(10, 10 + num)])
    assert share <= 0.05


@pytest.mark.parametrize(("at", "since"), [(9, FEWEST), (231, 240 - FEWEST)])
def test_a_change_near_an_end_is_reported_where_some_are_left_on_both_sides(policy, at, since):
    logs = cell()
    is_few = (logs.stages["trajectory"] < at) == (at < 120)
    stages = logs.stages.assign(x=np.where(is_few, 40.0, logs.stages["x"]))
    result = [each for each in changes_in(Logs(stages, logs.trajectories), policy) if each.words.startswith("x in")]
    assert result[0].since == since
    assert result[0].since_low <= since <= result[0].since_high


def test_a_clock_whose_ticks_were_added_up_tells_of_cuts_what_whole_ticks_tell():
    rng, num = np.random.default_rng(0), 240
    ticks = rng.integers(1, 6, num).astype(float)
    is_cut = rng.random(num) < np.where(np.arange(num) >= 120, 0.6, 0.3)
    found = []
    for end_s in (ticks, ticks + 1e-12 * rng.normal(size=num)):
        one = {"trajectory": np.arange(num), "end_s": end_s, "ending": np.where(is_cut, "cut", "finished")}
        done = {"elapsed_s": np.where(is_cut, np.nan, end_s), "reward": np.where(is_cut, np.nan, 1.0)}
        logs = Logs(pd.DataFrame({"trajectory": np.arange(num), "stage": 1, "action": "A"} | done), pd.DataFrame(one))
        found.append([(change.p_value, change.since_low) for change in changes_in(logs, FixedSequence(("A",)))])
    assert found[0]
    assert found[0] == found[1]
