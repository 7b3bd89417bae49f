"""Models on physical attempts: splits that share no table, errors beside naive loops, and sentences that follow."""

import json
import pickle
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.stats import t

from attempt_logs import TRUTH, attempt_log
from examples import attempt_pieces
from halfseen.cell.calibration.fits import fit_grasping
from halfseen.study.compare import holm
from halfseen.study.experiment import Pieces
from halfseen.study.experiments.attempts import Attempts, frame_of, mean_of
from halfseen.study.experiments.attempts_models import MODELS, SEEN, assumed_share, of_one_kind, predicted, sets_of
from halfseen.study.runner import as_json
from halfseen.study.setting import Setting
from halfseen.tables.grasp_attempts import can_hold_out, checked_attempts

TINY = Attempts(num_tables=(6, 12), num_folds=2)


@pytest.fixture(scope="module")
def setting(tmp_path_factory):
    folder = tmp_path_factory.mktemp("law")
    attempt_log(30, truth=np.array([1.5, *TRUTH[1:]])).write(folder / "attempts")
    return Setting((), repetitions=4, seed=5, law=folder)


def repeated(design, setting, prepared, index):
    return json.loads(as_json(design.repeat(setting, prepared, index)))


@pytest.fixture(scope="module")
def pieces(setting):
    prepared = json.loads(as_json(TINY.prepare(setting)))
    return Pieces(prepared, {}, [repeated(TINY, setting, prepared, k) for k in range(4)])


@pytest.fixture(scope="module")
def tables(setting, pieces):
    return TINY.tabulate(setting, pieces)


@pytest.fixture(scope="module")
def tried(pieces):
    return frame_of(pieces.prepared["completed"])


def test_no_table_is_both_learned_from_and_held_out_and_every_repetition_has_its_sizes():
    design, tables = Attempts(num_folds=4), np.arange(7, 60)
    for first in (0, 4, 8):
        splits = [design.split(tables, 3, index) for index in range(first, first + 4)]
        for split in splits:
            assert not set(split.learned) & set(split.held_out)
            assert set(split.learned) | set(split.held_out) == set(tables)
        assert sorted(np.concatenate([split.held_out for split in splits])) == sorted(tables)
    again = design.split(tables[::-1], 3, 8)
    np.testing.assert_array_equal(again.learned, splits[0].learned)
    assert list(design.split(tables, 4, 8).learned) != list(again.learned)
    design = Attempts(num_tables=(10, 30, 50), num_folds=4)
    for num in (40, 41, 43, 67):
        least = min(len(design.split(np.arange(num), 0, index).learned) for index in range(4))
        assert design.sizes(num) == tuple(size for size in (10, 30, 50) if size <= least)
    assert design.sizes(8) == (6,)


@pytest.mark.slow
def test_scores_are_those_of_attempts_that_were_held_out(pieces, tried):
    split, piece = TINY.split(np.unique(tried["trajectory"]), 5, 1), pieces.repetitions[1]
    learned = tried[tried["trajectory"].isin(list(split.learned[:12]))]
    held_out = tried[tried["trajectory"].isin(list(split.held_out))]
    weight = dict(zip(held_out.index[held_out["is_finished"]], checked_attempts(held_out).weight, strict=True))
    sums = dict.fromkeys(split.held_out.tolist(), 0.0)
    for said, (number, row) in zip(predicted("svm-facts", learned, held_out), held_out.iterrows(), strict=True):
        if row["is_finished"]:
            sums[row["trajectory"]] -= weight[number] * np.log(said if row["succeeded"] else 1.0 - said)
    (found,) = (row for row in piece["rows"] if (row["model"], row["num_tables"]) == ("svm-facts", 12))
    np.testing.assert_allclose(found["log_loss"], list(sums.values()), rtol=1e-9)
    assert piece["attempts"] == list(weight)


@pytest.mark.slow
def test_one_rate_stands_in_where_an_svm_cannot_be_fitted(tried):
    outcome = tried["succeeded"].astype("boolean")
    few = pd.concat([tried[outcome.fillna(False)], tried[(~outcome).fillna(False)].head(1)])
    assert not can_hold_out(few)
    assert can_hold_out(tried)
    np.testing.assert_array_equal(predicted("svm", few, tried), predicted("rate", few, tried))
    assert predicted("rate", few, tried)[0] > 0.95


@pytest.mark.slow
def test_an_attempt_is_the_set_of_itself_and_of_those_before_it_at_the_same_object(tried):
    order = np.random.default_rng(0).permutation(len(tried))
    sets, rows = sets_of(tried.iloc[order], np.zeros(4), np.ones(4)), tried.to_dict("records")
    for place, number in enumerate(order):
        now = rows[number]
        past = [row for row in rows if row["object"] == now["object"] and row["stage"] < now["stage"]]
        expected = [[1, 0, 0, *(now[name] for name in SEEN)]]
        expected += [[0, row["succeeded"], not row["succeeded"], *(row[name] for name in SEEN)] for row in past]
        np.testing.assert_array_equal(sets[place], np.array(expected, dtype=float))


def test_elements_of_two_kinds_have_nothing_in_common():
    kinds, values = np.eye(3)[[0, 1, 2, 1]], np.random.default_rng(0).normal(size=(4, 2))
    gram = of_one_kind(*[np.column_stack([kinds, values])] * 2)
    for i in range(4):
        for j in range(4):
            x, z = values[i], values[j]
            alike = 1.0 + x @ z + np.exp(-np.sum((x - z) ** 2) / 2.0)
            assert gram[i, j] == pytest.approx(alike if (kinds[i] == kinds[j]).all() else 0.0)


def naive_mean(sums, weights):
    theta = sums.sum() / weights.sum()
    parts = {"table": {}, "repetition": {}, "both": {}}
    for i in range(sums.shape[0]):
        for r in range(sums.shape[1]):
            if weights[i, r] > 0:
                residual = sums[i, r] - theta * weights[i, r]
                for name, key in (("table", i), ("repetition", r), ("both", (i, r))):
                    parts[name][key] = parts[name].get(key, 0.0) + residual
    squares = {name: len(of) / (len(of) - 1) * sum(e**2 for e in of.values()) for name, of in parts.items()}
    variance = squares["table"] + squares["repetition"] - squares["both"]
    variance = max(variance, squares["table"], squares["repetition"])
    return theta, np.sqrt(variance) / weights.sum(), min(len(parts["table"]), len(parts["repetition"])) - 1


@pytest.mark.parametrize("seed", range(4))
def test_errors_are_clustered_by_table_and_by_repetition(seed):
    rng = np.random.default_rng(seed)
    weights = rng.uniform(1, 5, (30, 8)) * (np.arange(30)[:, None] % 4 == np.arange(8) % 4)
    weights[:2] = 0.0
    drift = rng.normal(0, 1, (30, 1)) * (seed % 2) + rng.normal(0, 1, (1, 8)) * (seed // 2)
    sums = weights * (0.3 + drift + rng.normal(0, 1, (30, 8)))
    mean, (theta, error, freedom) = mean_of(sums, weights), naive_mean(sums, weights)
    assert (mean.value, mean.standard_error) == pytest.approx((theta, error))
    assert mean.high - mean.value == pytest.approx(t.ppf(0.975, freedom) * error)


@pytest.mark.slow
def test_intervals_hold_the_truth_where_tables_and_what_was_learned_vary():
    rng, inside = np.random.default_rng(0), []
    is_held_out = np.arange(200)[:, None] % 4 == np.arange(20) % 4
    for _ in range(500):
        drift = rng.normal(0, 1, (200, 1)) + rng.normal(0, 0.2, (1, 20))
        mean = mean_of(is_held_out * (drift + rng.normal(0, 0.5, (200, 20))), is_held_out.astype(float))
        inside.append(mean.low < 0 < mean.high)
    print("held the truth:", np.mean(inside))
    assert np.mean(inside) > 0.93


@pytest.mark.slow
def test_tables_hold_every_model_and_size_and_an_attempt_that_was_held_out_twice_counts_once(pieces, tables):
    assert len(tables["attempts_scores"]) == len(MODELS) * 2
    for _, pair in tables["attempts_tests"].groupby(["model", "rival"]):
        np.testing.assert_allclose(pair["p_holm"], holm(pair["p_value"].to_numpy()))
        assert len(pair) == 4
    calibration = tables["attempts_calibration"]
    rows = calibration.query("by == 'occlusion' and model == 'law'")
    decided = sum(pieces.prepared["completed"]["is_finished"])
    assert rows["attempts"].sum() == tables["attempts_held"]["attempts"].sum() == decided
    assert rows["share_of_attempts"].sum() == pytest.approx(1.0)
    law, fit = tables["attempts_law"].set_index("parameter"), fit_grasping(frame_of(pieces.prepared["completed"]))
    assert law.loc["occlusion", "estimate"] == fit.estimate[1]
    assert law.loc["occlusion", "high"] == pytest.approx(fit.estimate[1] + 1.959964 * fit.standard_error[1])
    said = {}
    for piece in pieces.repetitions:
        for row, value in zip(piece["attempts"], piece["said"]["beta"], strict=True):
            said.setdefault(row, []).append(value)
    assert {len(each) for each in said.values()} == {2}
    rows = calibration.query("by == 'prediction' and model == 'beta'")
    means = np.array([np.mean(each) for each in said.values()])
    assert rows["attempts"].sum() == len(means)
    assert rows["bin_from"].min() == pytest.approx(means.min())


def test_the_default_world_has_the_share_that_drawing_from_it_has():
    rng = np.random.default_rng(0)
    grasp_s = np.exp(0.6 + 2.2 * 0.5 - rng.normal(size=400_000)) * rng.exponential(size=400_000)
    assert assumed_share(np.array([0.5]))[0] == pytest.approx((grasp_s <= 6.0).mean(), abs=0.003)


def test_without_a_law_it_says_that_there_are_no_attempts():
    setting = Setting((), repetitions=2)
    pieces = Pieces(TINY.prepare(setting), {}, [TINY.repeat(setting, {}, k) for k in range(2)])
    section = TINY.section(setting, TINY.tabulate(setting, pieces))
    assert (len(section.sentences), section.num_leading, section.drawings, section.listings) == (1, 0, (), ())
    assert section.sentences[0].startswith("There are no attempts of a cell on which to test an SVM")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gain", "message"),
    [
        (0.01, "better than the Beta mean at every size, from 25 to 600 tables"),
        (0.0, "neither clearly better nor worse than the Beta mean at any size, from 25 to 600 tables"),
        (-0.01, "worse than the Beta mean at every size, from 25 to 600 tables"),
    ],
)
def test_the_answer_is_reported_either_way(gain, message):
    setting, design = Setting(()), Attempts()
    section = design.section(setting, design.tabulate(setting, attempt_pieces(gain)))
    assert section.sentences[0].startswith("On physical attempts (")
    assert f"the SVM predicts success {message} (" in section.sentences[0]
    assert section.drawings[0].title == f"On physical attempts, the SVM predicts {message}"
    assert "1 of 144 fits" in section.drawings[0].caption
    assert "the assumed laws have" in section.sentences[2]
    assert section.num_leading == 3


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bytes(setting, pieces):
    again, other = (pickle.loads(pickle.dumps(each)) for each in (TINY, setting))
    np.random.seed(1)  # noqa: NPY002 - nothing may depend on it
    assert repeated(again, other, pieces.prepared, 2) == pieces.repetitions[2]
    small = replace(TINY, num_tables=(6,))
    one, another = (repeated(small, replace(setting, seed=seed), pieces.prepared, 2) for seed in (5, 6))
    assert one != another
