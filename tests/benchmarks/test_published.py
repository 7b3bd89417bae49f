"""Published worlds: their dynamics against exact answers and other ways, and the peers against scikit-learn."""

import json
from itertools import product
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from peers.side_by_side import stored
from peers.staged_survival import dwsurv_rules, forest_rules, stage_times
from peers.weighted_survival import blip
from published import cho, dwsurv, goldberg_kosorok
from sklearn.linear_model import LinearRegression, LogisticRegression

from halfseen.logs import Logs

TRIAL = cho.WORLDS["d = 2, trial"]


def test_the_trial_of_goldberg_and_kosorok_is_worth_what_was_derived():
    plain = goldberg_kosorok.plain()
    for name, years in {"optimum": 1.478, "B B B": 1.223, "random": 1.07}.items():
        assert plain[name] / 12.0 == pytest.approx(years, abs=0.0025), name


def years_of(wellness, actions):
    """One patient, in plain arithmetic."""
    years, alive, lived = 0.0, 1.0, 0.0
    for stage, action in enumerate(actions):
        well, tumour = wellness - (0.5, 0.25)[action], (0.1, 0.2)[action] / wellness
        if well < 0.25 - 1e-12:
            break
        rate, until = 20.0 * tumour / (3.0 * (well + 2.0)), (1.0 / tumour - 1.0) * 0.75
        length = min(until, 3.0 - lived) if stage < 2 else 3.0 - lived
        years += alive * (1.0 - np.exp(-rate * length)) / rate
        alive, lived = alive * np.exp(-rate * length), lived + length
        if lived >= 3.0:
            break
        wellness = well + (1.0 - well) * (1.0 - 2.0 ** (-until / 2.0))
    return years


def test_no_sequence_of_treatments_is_better_than_the_optimum_of_goldberg_and_kosorok():
    some = goldberg_kosorok.GRID[25::50]
    best = [max(years_of(wellness, actions) for actions in product((0, 1), repeat=3)) for wellness in some]
    assert goldberg_kosorok.plain()["optimum"] / 12.0 == pytest.approx(np.mean(best), abs=0.003)


def test_randomised_patients_of_goldberg_and_kosorok_live_as_long_as_chance_is_worth_and_a_share_is_cut():
    lived = goldberg_kosorok.log(4000, 0.0, 3).stages.groupby("trajectory")["reward"].sum()
    assert 12.0 * lived.mean() == pytest.approx(goldberg_kosorok.plain()["random"], abs=4.0 * 12.0 * lived.sem())
    assert goldberg_kosorok.log(4000, 0.3, 3).cut_share == pytest.approx(0.3, abs=0.03)


def test_the_value_of_a_policy_of_cho_is_how_long_uncut_patients_live():
    uncut = TRIAL._replace(cuts=np.where(np.arange(4) == 0, -50.0, 0.0 * TRIAL.cuts))
    logs = cho.log(uncut, 800, 5)
    lived = logs.stages.groupby("trajectory")["reward"].sum()
    years, five = cho.values(uncut, uncut.logging, 800, 6)
    assert logs.cut_share == 0.0
    assert years == pytest.approx(lived.mean(), abs=5.0 * lived.sem())
    assert five == pytest.approx(np.mean(lived > 5.0), abs=5.0 * np.sqrt(0.25 / 800))


@pytest.mark.parametrize("seed", [0, 1])
def test_no_patient_of_cho_lives_for_more_than_ten_years_and_the_same_seed_gives_the_same_log(seed):
    logs, again = (cho.log(TRIAL, 60, seed) for _ in range(2))
    assert logs.stages["elapsed_s"].max() <= cho.YEARS + 1e-9
    pd.testing.assert_frame_equal(logs.stages, again.stages)


def test_cuts_of_simoneau_are_as_many_as_the_indicators_say():
    shares = {"independent, 30": 0.4, "independent, 60": 0.6, "on X₁, 30": 0.288, "on X₁, 60": 0.591}
    for cell, share in shares.items():
        is_seen = dwsurv.patients(cell, 3000, 1).is_seen
        assert 1.0 - is_seen.mean() == pytest.approx(share, abs=4.0 * np.sqrt(0.25 / 3000)), cell


def test_dwsurv_is_weighted_least_squares():
    rng = np.random.default_rng(0)
    x, one = rng.normal(size=(300, 1)), np.ones((300, 1))
    treated, is_seen = (rng.random(300) < 1.0 / (1.0 + np.exp(-x[:, 0]))).astype(float), rng.random(300) < 0.6
    log_time = x[:, 0] + treated * (0.3 - x[:, 0]) + rng.normal(size=300)
    design = np.hstack([one, x])
    psi = blip(log_time, treated, is_seen, design, design, design, design)
    chances = [LogisticRegression(C=1e8, tol=1e-10).fit(x, y).predict_proba(x)[:, 1] for y in (treated, is_seen)]
    weight = (np.abs(treated - chances[0]) / chances[1])[is_seen]
    columns = np.column_stack([x, treated, treated * x[:, 0]])[is_seen]
    found = LinearRegression().fit(columns, log_time[is_seen], sample_weight=weight)
    np.testing.assert_allclose(psi, found.coef_[1:], atol=1e-4)


@pytest.mark.parametrize("learn", [dwsurv_rules, forest_rules], ids=["dwsurv", "forest"])
def test_peers_learn_which_treatment_suits_whom(learn):
    rng = np.random.default_rng(0)
    x, treated = rng.uniform(-1.0, 1.0, 400), rng.integers(0, 2, 400)
    time = np.exp(1.0 + x * (2 * treated - 1) + 0.3 * rng.normal(size=400))
    cut = rng.exponential(10.0, 400)
    is_seen = time <= cut
    stages = {"trajectory": np.arange(400), "stage": 1, "action": np.array(["-1", "+1"])[treated], "x": x}
    seen = {"elapsed_s": np.where(is_seen, time, np.nan), "reward": np.where(is_seen, time, np.nan)}
    ends = {
        "trajectory": np.arange(400),
        "end_s": np.minimum(time, cut),
        "ending": np.where(is_seen, "finished", "cut"),
    }
    logs = Logs(pd.DataFrame(stages | seen), pd.DataFrame(ends))
    (rule,) = learn(stage_times(logs, ["x"], "+1"))
    assert rule(np.array([[-0.8], [-0.5], [0.5], [0.8]])).tolist() == [False, False, True, True]


@pytest.mark.parametrize("module", [cho, dwsurv, goldberg_kosorok], ids=lambda module: module.__name__)
def test_kept_results_make_tables(module):
    name = module.__name__.removeprefix("published.")
    printed = module.tables(stored(name))
    assert printed.count("\n") > 10
    assert "nan" not in printed


def is_within(values, expected, errors=4.0):
    values = np.array(values)
    return abs(values.mean() - expected) < errors * values.std(ddof=1) / np.sqrt(len(values))


@pytest.mark.slow
def test_linear_eq_3_earns_what_was_derived_and_the_default_more():
    values = goldberg_kosorok.measured(1000, 0.3, 10)["values"]
    assert is_within(values["eq. 3, linear"], 12.0 * goldberg_kosorok.DERIVED[0.3])
    assert np.mean(values["default"]) > np.mean(values["eq. 3, linear"])


@pytest.mark.slow
def test_dwsurv_has_its_published_spread_and_its_published_share_right_where_its_models_are_wrong():
    cell, repetitions = "independent, 30", 60
    trials = [dwsurv.patients(cell, 500, 1000 + seed) for seed in range(repetitions)]
    of_right, of_wrong = ([dwsurv.dwsurv(trial, cell, wrong) for trial in trials] for wrong in (False, True))
    psi = np.array([np.concatenate(each.psi) for each in of_right])
    mean, spread, _ = dwsurv.PUBLISHED[cell]
    assert all(is_within(psi[:, k], mean[k]) for k in range(4))
    np.testing.assert_allclose(psi.std(axis=0, ddof=1), spread, rtol=4.0 / np.sqrt(2 * repetitions))
    right = [100.0 * each.right[0] for each in of_wrong]
    assert is_within(right, dwsurv.PUBLISHED_WRONG[cell][0])


@pytest.mark.slow
def test_weights_treat_right_where_the_models_of_dwsurv_are_wrong():
    trials = [dwsurv.patients("independent, 30", 500, 1000 + seed) for seed in range(20)]
    weighted = [dwsurv.learned(trial, censoring="cox", stages="separate").right[0] for trial in trials]
    assert np.mean(weighted) >= 0.95


@pytest.mark.slow
def test_no_peer_is_beyond_noise_ahead_of_the_default_in_the_world_of_cho():
    row = cho.measured("d = 2, observed", 300, 20)
    values = {name: np.array(found["years"]) for name, found in row["values"].items()}
    for name, of_peer in values.items():
        if name == cho.SIMPLER:
            continue
        gain = values["default"] - of_peer
        assert gain.mean() >= -2.0 * gain.std(ddof=1) / np.sqrt(len(gain)), name


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ("cho", "--cells", "d = 2, trial", "--sizes", "100"),
        ("dwsurv", "--cells", "on X₁, 30", "--sizes", "200"),
        ("goldberg_kosorok", "--sizes", "60", "--shares", "0.1"),
    ],
    ids=lambda words: words[0],
)
def test_a_benchmark_stores_and_prints_what_it_found(words, tmp_path, monkeypatch, capsys):
    name, *options = words
    out = tmp_path / "found.json"
    monkeypatch.setattr("sys.argv", [name, "--out", str(out), "--repetitions", "2", *options])
    module = {"cho": cho, "dwsurv": dwsurv, "goldberg_kosorok": goldberg_kosorok}[name]
    module.main()
    found = json.loads(out.read_text(encoding="utf-8"))
    assert (len(found["rows"]), found["repetitions"]) == (1, 2)
    assert capsys.readouterr().out == module.tables(found) + "\n"


def test_the_page_counts_cells_of_cho_as_the_results_do():
    page = (Path(__file__).parents[2] / "docs" / "guide" / "published.md").read_text(encoding="utf-8")
    leads = {name: [cho.lead(row, name) for row in stored("cho")["rows"]] for name in cho.CRITERIA}
    behind = {name: sum(mean < -2.0 * error for mean, error in each) for name, each in leads.items()}
    assert behind == {"years": 1, "five": 1}
    assert sum(mean > 2.0 * error for mean, error in leads["years"]) == 10
    assert "in 10 of 16 cells" in page
    for mean, error in (each for each in leads["years"] if each[0] < -2.0 * each[1]):
        assert f"by {-mean:.3f} ± {error:.3f}".replace(" 0.", " .") in page


def test_the_page_tells_how_many_outlive_their_own_time_and_how_precise_weights_are():
    rows = stored("dwsurv")["rows"]
    assert (round(4 * min(row["outlives"] for row in rows)), round(5 * max(row["outlives"] for row in rows))) == (1, 2)
    spreads = [np.divide(row["methods"]["weighted"]["sd"], row["methods"]["DWSurv"]["sd"]) for row in rows]
    assert (np.min(spreads).round(1), np.max(spreads).round(1)) == (0.8, 1.2)


@pytest.mark.slow
def test_the_first_log_of_kept_results_comes_out_again():
    kept = next(row for row in stored("cho")["rows"] if (row["cell"], row["size"]) == ("d = 2, trial", 300))
    again = cho.measured("d = 2, trial", 300, 1)["values"]
    for name, found in again.items():
        assert found["years"][0] == pytest.approx(kept["values"][name]["years"][0], abs=0.02), name
    kept = next(row for row in stored("goldberg_kosorok")["rows"] if (row["size"], row["share"]) == (200, 0.3))
    for name, found in goldberg_kosorok.measured(200, 0.3, 1)["values"].items():
        assert found[0] == pytest.approx(kept["values"][name][0], abs=0.02), name
