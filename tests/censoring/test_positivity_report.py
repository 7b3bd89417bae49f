"""What weights are worth, and what is said of a log in which some have none."""

import numpy as np
import pytest

from halfseen.censoring import (
    KaplanMeier,
    censoring_weights,
    positivity_report,
    warn_if_few,
    weight_diagnostics,
)
from halfseen.errors import ArgumentError, HalfseenWarning


def drawn(n=400, seed=0, scale=3.0):
    rng = np.random.default_rng(seed)
    own, cut = rng.integers(1, 30, n).astype(float), np.ceil(rng.exponential(10.0 * scale, n))
    return np.minimum(own, cut), own <= cut


def thin():
    """Fifty trajectories finish early; fifty are cut before the last ten finish, eight of them just before the last."""
    time = np.concatenate([np.linspace(1.0, 2.0, 50), np.full(50, 3.0), np.arange(4.0, 14.0)])
    time[50:58] = 12.5
    return time, np.repeat([True, False, True], [50, 50, 10])


SHORT = KaplanMeier().fit([1.0, 2.0, 5.0], [True, False, False])
CASES = {
    "sound": drawn(),
    "few": drawn(n=12),
    "thin": thin(),
    "not identified": ([1.0, 3.0, 6.0], [True] * 3, SHORT),
    "incomplete": (np.arange(1.0, 41.0), np.arange(40) < 20),
    "all cut": ([1.0, 2.0], [False, False]),
    "the only one cut": ([1.0], [False]),
    "none cut": (np.arange(1.0, 51.0), np.ones(50, dtype=bool)),
    "one trajectory": ([1.0], [True]),
}


def test_counts_and_worth_are_those_of_the_weights_and_the_tail_is_the_last_quarter_of_the_finishes():
    time, is_finished = drawn()
    weights, report = censoring_weights(time, is_finished), positivity_report(time, is_finished)
    assert (report.num_trajectories, report.num_finished) == (400, is_finished.sum())
    assert report.overall == weight_diagnostics(weights)
    assert report.mean_weight == pytest.approx(weights.mean())
    np.testing.assert_array_equal(report.weights, weights[is_finished])
    np.testing.assert_array_equal(report.cut_s, time[~is_finished])
    in_tail = time[is_finished] >= report.tail_from_s
    assert in_tail.sum() >= is_finished.sum() / 4 > (time[is_finished] > report.tail_from_s).sum()
    tail = weight_diagnostics(weights[is_finished][in_tail])
    assert report.tail.effective_sample_size == pytest.approx(tail.effective_sample_size)
    even = positivity_report(np.arange(1.0, 102.0), np.ones(101, dtype=bool))
    assert (even.tail_from_s, even.tail.num_seen) == (76.0, 26)


def test_heaviest_trajectories_are_named_with_time_and_weight():
    time, is_finished = [1.0, 2.0, 2.0, 3.0, 4.0], [True, False, True, False, True]
    report = positivity_report(time, is_finished, trajectory_ids=["a", "b", "c", "d", "e"])
    found = [(heavy.trajectory, heavy.time_s, pytest.approx(heavy.weight)) for heavy in report.heaviest]
    assert found == [("e", 4.0, 3.0), ("a", 1.0, 1.0), ("c", 2.0, 1.0)]
    assert len(positivity_report(*drawn()).heaviest) == 5


def test_trajectories_without_a_weight_are_named_and_the_bound_gives_them_one():
    ends = [1.0, 3.0, 6.0, 7.0], [True] * 4, SHORT
    report, bounded = positivity_report(*ends), positivity_report(*ends, truncate_at=10)
    unidentified = [(trajectory.trajectory, trajectory.time_s, trajectory.weight) for trajectory in report.unidentified]
    assert unidentified == [(2, 6.0, np.inf), (3, 7.0, np.inf)]
    assert report.identified_until_s == 5.0
    assert all(row.truncate_at is not None and np.isfinite(row.mean) for row in report.truncations)
    assert str(report).startswith(
        "Not identified: 2 trajectories finished where no trajectory is left uncut (Ĝ = 0), first trajectory 2"
    )
    assert "Shorten the horizon so that it ends before 5 s" in str(report)
    assert "90.9%" not in str(report)
    assert bounded.overall == weight_diagnostics([1.0, 2.0, 10.0, 10.0], 10)
    assert "Not identified" not in str(bounded)
    assert "87.0% of the weight is truncated" in str(bounded)


def test_truncation_moves_from_the_weighted_mean_to_the_plain_one():
    time, is_finished = drawn(scale=1.0)
    weights, rows = censoring_weights(time, is_finished), positivity_report(time, is_finished).truncations
    first, last = rows[0], rows[-1]
    assert (first.truncate_at, first.share_removed, last.truncate_at) == (None, 0.0, 1.0)
    assert first.mean == pytest.approx(np.average(time, weights=weights))
    assert last.mean == pytest.approx(time[is_finished].mean())
    assert last.effective_sample_size == pytest.approx(is_finished.sum())
    for row in rows[1:]:
        bounded = censoring_weights(time, is_finished, truncate_at=row.truncate_at)
        assert row.mean == pytest.approx(np.average(time, weights=bounded))
        assert row.share_removed == pytest.approx(1 - bounded.sum() / weights.sum())
        assert row.effective_sample_size == pytest.approx(weight_diagnostics(bounded).effective_sample_size)
    assert np.all(np.diff([row.effective_sample_size for row in rows]) > 0)


def test_the_mean_may_be_of_another_quantity():
    time, is_finished = drawn()
    target = np.where(is_finished, (time <= 10).astype(float), np.nan)
    report = positivity_report(time, is_finished, target=target, target_name="finished by 10 s [share]")
    weights = censoring_weights(time, is_finished)
    assert report.truncations[0].mean == pytest.approx(weights[time <= 10].sum() / weights.sum())
    assert "mean finished by 10 s [share]" in str(report)


@pytest.mark.parametrize(
    ("case", "is_sound", "begins", "remedy"),
    [
        ("sound", True, "Sound: ", ""),
        ("few", False, "Too little: ", "Record more trajectories, shorten the horizon to before"),
        ("thin", False, "Thin at the end: ", ""),
        (
            "incomplete",
            False,
            "Incomplete: 20 finishes have an effective sample size of 20.0, but stand for 50%",
            "finish after 40 s: restrict times",
        ),
        ("all cut", False, "No weights: all 2 trajectories were cut.\nRecord until some", ""),
        ("the only one cut", False, "No weights: the only trajectory was cut.", ""),
        ("none cut", True, "Sound: 50 finishes have an", ""),
        ("one trajectory", False, "Too little: ", "the weights are not the cause"),
    ],
)
def test_verdicts(case, is_sound, begins, remedy):
    report = positivity_report(*CASES[case])
    assert report.is_sound == is_sound
    assert str(report).startswith(begins)
    assert remedy in str(report)
    if case == "thin":
        assert report.overall.effective_sample_size > 10 > report.tail.effective_sample_size
    if case == "incomplete":
        assert report.mean_weight == pytest.approx(0.5)
        assert report.is_off


class TooWary:
    """Takes half of all trajectories to be cut at once."""

    def fit(self, time, is_finished, covariates=None):
        return self

    def survival(self, u, covariates=None):
        return np.full(np.shape(u), 0.5)


LATE = KaplanMeier().fit([1.0, 2.0, 3.0], [False, True, True])


@pytest.mark.parametrize(
    ("time", "is_finished", "model", "mean_weight", "message"),
    [
        ([1.0, 2.0, 3.0, 4.0], [True] * 4, LATE, 1.375, "1 trajectory finished later"),
        (np.arange(1.0, 41.0), [True] * 40, TooWary(), 2.0, "overestimates the probability of cuts"),
        (
            [1.0, 2.0, 3.0, 4.0],
            [True, True, True, False],
            "kaplan-meier",
            0.75,
            "The mean weight is 0.750, so about 25.0% of trajectories finish later than that.",
        ),
    ],
)
def test_a_mean_weight_other_than_one_is_reported(time, is_finished, model, mean_weight, message):
    report = positivity_report(time, is_finished, model)
    assert report.mean_weight == pytest.approx(mean_weight)
    assert message in str(report)
    assert report.ends_in_cut == (not is_finished[-1])


@pytest.mark.slow
@pytest.mark.parametrize("case", ["sound", "thin", "not identified", "all cut", "none cut", "one trajectory"])
def test_the_figure_says_the_verdict_and_shows_every_trajectory(case):
    report = positivity_report(*CASES[case])
    figure = report.plot()
    figure.draw_without_rendering()
    assert figure.get_suptitle() == str(report).splitlines()[0]
    shown = {line.get_label(): len(line.get_xdata()) for line in figure.axes[0].lines}
    assert shown.get("cut", 0) == len(report.cut_s)
    gone = shown.get("finished, no weight", 0)
    assert shown.get("finished, at its weight", 0) + gone == report.num_finished
    if report.truncations:
        assert all(axes.get_xlabel() and axes.get_ylabel() and axes.get_title("left") for axes in figure.axes)
        drawn_means = figure.axes[1].lines[-1].get_ydata()
        np.testing.assert_array_equal(drawn_means, [row.mean for row in report.truncations])


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"target": [1.0]}, "target has 1 rows for 2 trajectories"),
        ({"target": [np.nan, 1.0]}, "target, row 0: nan, but the trajectory finished"),
        ({"truncate_at": 0.5}, "weights are at least 1"),
        ({"trajectory_ids": [1]}, "trajectory_ids has shape"),
    ],
)
def test_refuses_what_does_not_match(options, message):
    with pytest.raises(ArgumentError, match=message):
        positivity_report([1.0, 2.0], [True, False], **options)


def test_few_effective_weights_warn_with_a_remedy_and_enough_do_not():
    with pytest.warns(HalfseenWarning, match=r"effective sample size of 9.0.*record more trajectories.*truncate_at"):
        warn_if_few(weight_diagnostics(np.ones(9)))
    with pytest.warns(HalfseenWarning, match="None of 3 weights is above 0"):
        warn_if_few(weight_diagnostics(np.zeros(3)))
    warn_if_few(weight_diagnostics(np.ones(10)))


def test_equal_weights_are_worth_their_number_and_one_heavy_weight_leaves_little():
    worth = weight_diagnostics([2.0, 2.0, 0.0, 2.0])
    assert worth.effective_sample_size == pytest.approx(3.0)
    assert (worth.num_weights, worth.num_seen, worth.largest_weight, worth.largest_at) == (4, 3, 2.0, (0,))
    assert worth.share_truncated == 0.0
    worth = weight_diagnostics([[1.0, 1.0], [98.0, 0.0]])
    assert worth.effective_sample_size == pytest.approx(100**2 / (98**2 + 2))
    assert worth.largest_at == (1, 0)


@pytest.mark.parametrize(
    ("weights", "bound", "share"),
    [([1.0, 3.0, 4.0], 4, 0.5), ([1.0, 1.0 / (1.0 / 49.0)], 49.0, 0.98), ([1.0, 3.0], 4, 0.0)],
)
def test_weights_at_the_bound_count_as_truncated(weights, bound, share):
    assert weight_diagnostics(weights, truncate_at=bound).share_truncated == pytest.approx(share)


@pytest.mark.parametrize("weights", [[0.0, 0.0], [], np.zeros((2, 0))])
def test_nothing_seen_is_worth_nothing(weights):
    worth = weight_diagnostics(weights)
    assert (worth.num_seen, worth.effective_sample_size, worth.largest_at) == (0, 0.0, None)
    assert str(worth) == f"None of {np.size(weights)} weights is above 0."


@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf])
def test_refuses_what_is_no_weight(value):
    with pytest.raises(ArgumentError, match=rf"weights\[0, 1\] is {value}"):
        weight_diagnostics([[1.0, value]])
