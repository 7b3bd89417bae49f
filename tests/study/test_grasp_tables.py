"""Tables and sentences of the grasp ablation, from made-up pieces."""

import numpy as np
import pytest
from example_results import example_results

from halfseen.study.grasp import LaplaceGrasp, scored
from halfseen.study.grasp_tables import calibration, grasp_frame
from halfseen.study.grasp_words import figure5_title, grasp_sentence
from halfseen.study.results import GRASP_MEASURES, GRASP_NAMES


def test_scores_are_those_of_the_definition():
    chance, succeeded = np.array([0.05, 0.8, 0.85, 1.0]), np.array([False, True, False, True])
    found = scored(chance, succeeded)

    assert found["log_loss"] == pytest.approx(-np.mean(np.log([0.95, 0.8, 0.15, 1.0])))
    assert found["brier"] == pytest.approx(np.mean([0.05**2, 0.2**2, 0.85**2, 0.0]))
    assert found["bins"]["attempts"] == [1, 0, 0, 0, 0, 0, 0, 0, 2, 1]
    assert found["bins"]["successes"] == [0, 0, 0, 0, 0, 0, 0, 0, 1, 1]
    np.testing.assert_allclose(np.array(found["bins"]["chances"])[[0, 8, 9]], [0.05, 1.65, 1.0])


def test_laplaces_rule():
    frame = {"occlusion": [0.9, 0.1, 0.0], "successes": [0, 2, 0], "failures": [0, 0, 4]}
    np.testing.assert_allclose(LaplaceGrasp().predict_proba(frame)[:, 1], [1 / 2, 3 / 4, 1 / 6])


def test_every_model_at_every_size_has_means_and_paired_differences():
    results = example_results(svm_lead=0.02)
    grasp = results.grasp.set_index(["model", "num_paths"])

    assert set(grasp.index) == {(model, size) for model in GRASP_NAMES for size in (50, 200, 800)}
    for measure in GRASP_MEASURES:
        assert (grasp.loc["oracle", f"{measure}_over_oracle"] == 0).all()
    # What all models share in a repetition cancels in the difference: its error is far smaller than that of the mean.
    svm = grasp.loc[("svm", 200)]
    assert svm["log_loss_over_oracle"] == pytest.approx(-0.01, abs=0.001)
    assert svm["log_loss_over_oracle_se"] < svm["log_loss_se"] / 3


def test_tests_find_who_is_better_and_are_adjusted_together():
    better = example_results(svm_lead=0.02).grasp_tests.set_index(["measure", "num_paths"])
    assert better.loc["log_loss", "supported"].all()
    assert better.loc["brier", "supported"].all()
    assert (better["p_holm"] >= better["p_value"]).all()
    assert better.loc[("log_loss", 50), "effect"] == pytest.approx(-0.02, abs=0.001)

    worse = example_results(svm_lead=-0.02).grasp_tests.set_index(["measure", "num_paths"])
    assert not worse.loc["log_loss", "supported"].any()
    assert (worse.loc["log_loss", "p_value"] > 0.99).all()


def test_calibration_is_the_share_in_each_bin_with_an_error_over_repetitions():
    def piece(repetition, attempts, chances, successes):
        nine = [0] * 9
        bins = {"attempts": [attempts, *nine], "chances": [chances, *nine], "successes": [successes, *nine]}
        row = dict.fromkeys(GRASP_MEASURES, 0.0) | {"model": "beta", "num_paths": 50, "bins": bins}
        return {"repetition": repetition, "grasp": [row]}

    table = calibration(grasp_frame([piece(0, 10, 0.5, 1), piece(1, 30, 2.5, 6)]))
    assert len(table) == 1
    row = table.iloc[0]
    assert (row["attempts"], row["mean_chance"], row["share_succeeded"]) == (40, 3 / 40, 7 / 40)
    residual = np.array([1 - 0.5 - 0.1 * 10, 6 - 2.5 - 0.1 * 30])
    assert row["se"] == pytest.approx(np.sqrt(2 * np.sum(residual**2)) / 40)


@pytest.mark.parametrize(
    ("svm_lead", "verdict", "title", "side"),
    [
        (0.02, "Beta holds here:", "The SVM tells the chance", "below"),
        (0.0, "Beta does not hold here:", "The SVM does not tell", ""),
        (-0.02, "Beta does not hold here:", "The SVM does not tell", "above"),
    ],
)
def test_the_claim_is_said_to_hold_only_where_it_does(svm_lead, verdict, title, side):
    results = example_results(svm_lead=svm_lead)
    sentence = grasp_sentence(results.grasp_tests, results.design)
    assert verdict in sentence
    assert side in sentence
    assert "p = >" not in sentence
    assert "from 800 logged paths of which about half were cut" in sentence
    assert figure5_title(results.grasp_tests).startswith(title)


def test_a_claim_that_holds_at_some_sizes_names_them():
    tests = example_results(svm_lead=0.02).grasp_tests
    tests.loc[(tests["measure"] == "log_loss") & (tests["num_paths"] == 50), "supported"] = False
    assert "holds here from 200 and 800 logged paths alone" in grasp_sentence(tests, example_results().design)
    assert figure5_title(tests).endswith("from 200 and 800 paths alone")


def test_intervals_run_upwards_whatever_the_sign():
    for svm_lead in (0.02, -0.02):
        sentence = grasp_sentence(example_results(svm_lead=svm_lead).grasp_tests, example_results().design)
        low, high = sentence.split("95 % interval ")[1].split(";")[0].split(" to ")
        assert float(low) < 0.02 < float(high)
