import pytest
from example_results import example_results

from halfseen.errors import ArgumentError
from halfseen.study.findings import sufficient_paths
from halfseen.study.sentences import figure1_title, figure4_title, plain_sentences
from halfseen.study.wording import amount, difference, interval, listed, measured, p_value, share

RIVALS = ("planner-1s", "history-penalty")


def test_a_better_policy_is_called_better():
    first, second, third = example_results(lead=1.2, gain=0.4).sentences
    assert (
        "3.95 more than the best heuristic (history, counting the penalty, 6.40), a lead that the test supports"
        in first
    )
    assert "1.20 more than the best planner" in first
    assert "not supported" not in first
    assert "25 logged paths, the smallest log that was tried, suffice at every share of cut paths, up to half" in second
    assert "under independent cuts 0.35 (0.18 to 0.53) over using completed stages without weights" in third


def test_a_worse_policy_is_called_worse():
    results = example_results(lead=-4.0, gain=-0.4)
    first, second, third = results.sentences
    assert "1.25 less than the best heuristic" in first
    assert "4.00 less than the best planner, which knows the true model (strongest planner within 1 s, 9.15)" in first
    assert first.count("a lead is not supported") == 2
    assert second == (
        "No log that was tried (25 to 800 paths) suffices to beat the best heuristic with both 95 % bands apart, "
        "at any share of cut paths."
    )
    assert "a loss of 0.75 (0.57 to 0.93) against dropping cut paths" in third
    assert "does not clearly beat" in figure1_title(results.figure1, results.table1, results.design, RIVALS)
    assert "lose to no weights, dropping and counting failures" in figure4_title(results.figure4, results.design)


def test_noise_is_called_noise():
    results = example_results(lead=0.05, gain=0.0)
    first, _, third = results.sentences
    assert "0.05 more than the best planner" in first
    assert "a difference within noise, so that a lead is not supported" in first
    assert third.count("nothing beyond noise over any other treatment of the cut paths") == 2
    title = figure4_title(results.figure4, results.design)
    assert (
        title == "From 800 paths, weights buy nothing beyond noise, under independent cuts or under the operator's hand"
    )
    assert "is not told apart from" in figure1_title(results.figure1, results.table1, results.design, RIVALS)


def test_kinds_of_cuts_stay_together_however_the_rows_come():
    results = example_results()
    shuffled = results.figure4.sample(frac=1.0, random_state=0)
    *_, third = plain_sentences(results.figure1, results.table1, shuffled, results.design, *RIVALS)
    assert third.count("under independent cuts") == third.count("under the operator's hand") == 1


def test_a_clear_gap_that_the_test_does_not_support():
    results = example_results(lead=1.2)
    table1 = results.table1.assign(supported=False)
    first, *_ = plain_sentences(results.figure1, table1, results.figure4, results.design, *RIVALS)
    assert first.count("a lead that the test does not support") == 2


def test_what_was_not_tested_is_said_so():
    results = example_results()
    table1 = results.table1.iloc[:0]
    first, *_ = plain_sentences(results.figure1, table1, results.figure4, results.design, *RIVALS)
    assert first.count("which was not tested") == 2


def test_sizes_that_suffice_are_grouped():
    _, second, _ = example_results().sentences
    assert "50 logged paths suffice if none, a sixth or a third of them are cut" in second
    assert "and 100 logged paths suffice if half of them are cut" in second
    assert (
        "suffice if none or a sixth of them are cut and even 800 logged paths do not suffice if a third"
        in example_results(lead=-2.6).sentences[1]
    )


def test_a_size_suffices_only_if_all_larger_ones_do():
    figure1 = example_results(lead=1.2).figure1
    assert sufficient_paths(figure1, 1 / 2, "history-penalty") == 25
    figure1.loc[(figure1["policy"] == "cql") & (figure1["num_paths"] == 200), "mean_reward"] = 6.0
    assert sufficient_paths(figure1, 1 / 2, "history-penalty") == 400
    figure1.loc[(figure1["policy"] == "cql") & (figure1["num_paths"] == 800), "mean_reward"] = float("nan")
    assert sufficient_paths(figure1, 1 / 2, "history-penalty") is None


def test_what_the_study_lacks_is_named():
    results = example_results()
    with pytest.raises(ArgumentError, match=r"'oracle'.*greedy"):
        plain_sentences(results.figure1, results.table1, results.figure4, results.design, "oracle", "greedy")


def test_numbers_are_written_for_people():
    assert [share(value) for value in (0.0, 1 / 6, 1 / 3, 0.5, 0.37, 0.333)] == [
        "none",
        "1/6",
        "1/3",
        "1/2",
        "37 %",
        "33.3 %",
    ]
    assert [amount(value) for value in (-0.125, -0.001, float("nan"))] == ["−0.12", "0.00", "–"]
    assert [p_value(p) for p in (0.27, 0.0031, 4.757e-7, 1.0, 0.0, float("nan"))] == [
        "0.27",
        "0.0031",
        "4.8 × 10⁻⁷",
        "> 0.99",
        "< 10⁻³⁰⁰",
        "–",
    ]
    assert [measured(value, "decision_ms") for value in (0.0213, 130.4, 0.0)] == ["0.0213", "130", "0.000"]
    assert interval(-0.5, 1.0) == "−0.50 to 1.00"
    assert difference(-2.25, -3.9, -0.6, "robot_s") == ("−2.2", "−3.9 to −0.6")
    assert [listed(parts) for parts in ([], ["a"], ["a", "b"], ["a", "b", "c"])] == ["", "a", "a and b", "a, b and c"]
