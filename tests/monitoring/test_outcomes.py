"""What trajectories add under cuts, and bounds at all times: by hand and loops, and as often right as they say."""

import math

import numpy as np
import pytest

from halfseen.censoring import KaplanMeier, StageClocks
from halfseen.errors import ArgumentError
from halfseen.monitoring import changes_in, monitored
from halfseen.monitoring.outcomes import FEWEST, MOST_BET, BettingBounds, CensoredOutcomes
from refusals import refused_type


def ends_as_clocks(end_s, is_finished):
    """Trajectories of which nothing is known but their ends, as one stage each."""
    ends, finished = np.atleast_1d(np.asarray(end_s, dtype=float)), np.atleast_1d(np.asarray(is_finished, dtype=bool))
    return StageClocks.of_ends(ends, finished)._replace(elapsed_s=np.where(finished, ends, np.nan)[:, None])


def drawn(num, rng):
    """Success depends on how long it took, cuts do not; a quarter is cut. The mean is .5."""
    end_s = rng.exponential(10.0, size=num)
    success = rng.random(num) < np.where(end_s < 10.0 * np.log(2.0), 0.7, 0.3)
    cut_s = rng.exponential(30.0, size=num)
    return np.minimum(end_s, cut_s), end_s <= cut_s, success.astype(float)


def test_each_outcome_is_the_forecast_and_the_weighted_rest_by_the_past_alone():
    end_s, finished, total = drawn(60, np.random.default_rng(1))
    found = CensoredOutcomes(0.0, 1.0).add(ends_as_clocks(end_s, finished), total)
    assert found.is_weighed.tolist() == [k >= FEWEST for k in range(60)]
    weight, weighted, model_of, reach = 0.0, 0.0, {}, {}
    fitted_at = [20, 30, 45]
    for k in range(FEWEST, 60):
        at = max(each for each in fitted_at if each <= k)
        if at not in model_of:
            model_of[at] = KaplanMeier().fit(end_s[:at], finished[:at])
            reach[at] = min(4.0, max(1.0 / model_of[at].survival(end_s[:at][finished[:at]])))
        w = min(1.0 / max(model_of[at].survival(end_s[k : k + 1])[0], 1e-9), reach[at]) if finished[k] else 0.0
        forecast = (weighted + 0.5) / (weight + 1.0)
        assert found.values[k] == pytest.approx(forecast + w * ((total[k] if finished[k] else 0.0) - forecast))
        assert found.lows[k] == pytest.approx(forecast - reach[at] * forecast)
        assert found.highs[k] == pytest.approx(forecast + reach[at] * (1.0 - forecast))
        weight, weighted = weight + w, weighted + w * total[k]


def test_batches_change_nothing_and_nothing_is_weighed_without_a_past():
    end_s, finished, total = drawn(80, np.random.default_rng(2))
    at_once = CensoredOutcomes(0.0, 1.0).add(ends_as_clocks(end_s, finished), total)
    outcomes, values = CensoredOutcomes(0.0, 1.0), []
    for k in range(80):
        values.append(outcomes.add(ends_as_clocks(end_s[k], finished[k]), total[k]).values[0])
    np.testing.assert_allclose(values, at_once.values)


@pytest.mark.parametrize(("cut_after_s", "is_too_cut"), [(20.0, False), (3.0, True)])
def test_where_weights_cannot_make_up_for_the_cuts_nothing_counts(cut_after_s, is_too_cut):
    """Failures end soon, so that of many cuts they are most of what finishes."""
    rng = np.random.default_rng(3)
    succeeds = rng.random(400) < 0.6
    end_s, cut_s = (
        np.where(succeeds, rng.gamma(4.0, 2.0, 400), rng.gamma(2.0, 0.5, 400)),
        rng.exponential(cut_after_s, 400),
    )
    outcomes = CensoredOutcomes(0.0, 1.0)
    found = outcomes.add(ends_as_clocks(np.minimum(end_s, cut_s), end_s <= cut_s), succeeds.astype(float))
    assert (outcomes.num_too_cut > 350) == is_too_cut
    assert found.is_weighed.sum() == 400 - FEWEST - outcomes.num_too_cut
    if not is_too_cut:
        assert outcomes.num_too_cut == 0
        assert found.values[FEWEST:].mean() == pytest.approx(0.6, abs=0.06)


def test_what_no_trajectory_can_bring_is_refused():
    with pytest.raises(ArgumentError, match=r"add up to 2, outside 0 to 1"):
        CensoredOutcomes(0.0, 1.0).add(ends_as_clocks([1.0], [True]), [2.0])


@pytest.mark.slow
def test_bounds_hold_under_cuts():
    rng, num, alpha, truth = np.random.default_rng(7), 200, 0.1, 0.5
    missed, values = 0, []
    for _ in range(num):
        end_s, finished, total = drawn(1500, rng)
        found = CensoredOutcomes(0.0, 1.0).add(ends_as_clocks(end_s, finished), total)
        is_in = found.is_weighed
        lows, highs = np.minimum(found.lows[is_in], 0.0), np.maximum(found.highs[is_in], 1.0)
        course = BettingBounds(0.0, 1.0, alpha, num_points=101).add(found.values[is_in], lows, highs)
        missed += bool((course.lower > truth).any() or (course.upper < truth).any())
        values.append(np.nanmean(found.values))
    assert np.mean(values) == pytest.approx(truth, abs=0.005)
    assert missed <= alpha * num + 2.0 * np.sqrt(num * alpha * (1 - alpha))


def naive_betting(values, alpha, grid):
    """Bounds on [0, 1], one candidate and one outcome after another."""
    need, lower, upper = 2.0 / alpha, [], []
    capital = {float(m): [1.0, 1.0] for m in grid}
    sums, squares, mean, out_low, out_high = 0.5, 0.25, 0.5, 0.0, 1.0
    for t, x in enumerate(values, start=1):
        bet = math.sqrt(2.0 * math.log(2.0 / alpha) / (squares / t * t * math.log(1 + t)))
        for m, (up, down) in capital.items():
            most_up, most_down = MOST_BET / m if m > 0 else math.inf, MOST_BET / (1.0 - m) if m < 1 else math.inf
            capital[m] = [up * (1.0 + min(bet, most_up) * (x - m)), down * (1.0 - min(bet, most_down) * (x - m))]
        sums += x
        mean = sums / (t + 1)
        squares += (x - mean) ** 2
        rejected = []
        for m in grid:
            if capital[float(m)][0] < need:
                break
            rejected.append(m)
        out_low = max([out_low, *rejected])
        rejected = []
        for m in grid[::-1]:
            if capital[float(m)][1] < need:
                break
            rejected.append(m)
        out_high = min([out_high, *rejected])
        lower.append(out_low)
        upper.append(out_high)
    return np.array(lower), np.array(upper)


def test_betting_is_what_a_loop_over_candidates_finds():
    values = np.random.default_rng(3).beta(2.0, 5.0, size=120)
    bounds = BettingBounds(0.0, 1.0, 0.1, num_points=51)
    course = bounds.add(values)
    lower, upper = naive_betting(values, 0.1, bounds.grid)
    np.testing.assert_allclose(course.lower, lower)
    np.testing.assert_allclose(course.upper, upper)
    assert 0.1 < course.lower[-1] < values.mean() < course.upper[-1] < 0.5


def test_another_scale_and_one_by_one_change_nothing():
    values = np.random.default_rng(0).random(200)
    at_once = BettingBounds(0.0, 1.0).add(values)
    scaled = BettingBounds(-3.0, 7.0).add(10.0 * values - 3.0)
    np.testing.assert_allclose(scaled.lower, 10.0 * at_once.lower - 3.0, atol=1e-9)
    bounds = BettingBounds(0.0, 1.0)
    np.testing.assert_allclose([float(bounds.add(value).upper[0]) for value in values], at_once.upper, atol=1e-9)
    assert bounds.num == 200


def test_what_lies_outside_is_refused():
    with pytest.raises(ArgumentError, match=r"outcome 3 is 1\.5 in a range of 0\.0 to 1\.0"):
        BettingBounds(0.0, 1.0).add([0.1, 0.2, 1.5])
    with pytest.raises(ArgumentError, match="outcome 1 is nan"):
        BettingBounds(0.0, 1.0).add(np.nan)
    with pytest.raises(ArgumentError, match="the lower first"):
        BettingBounds(1.0, 0.0)
    with pytest.raises(ArgumentError, match="alpha is 0"):
        BettingBounds(0.0, 1.0, 0.0)


@pytest.mark.parametrize(
    ("asks", "message"),
    [
        (lambda: BettingBounds("0", 1.0), "low is '0' and high 1.0; give two finite numbers"),
        (lambda: BettingBounds(0.0, 1.0, "5 %"), "alpha is '5 %'; give a number between 0 and 1"),
        (lambda: BettingBounds(0.0, 1.0, num_points=1), "num_points is 1; give a whole number of at least 2"),
        (lambda: BettingBounds(0.0, 1.0).add(np.ma.masked_array([0.1, 0.2], [False, True])), "values, row 1: masked"),
        (
            lambda: CensoredOutcomes(0.0, 1.0).add(StageClocks.of_ends(np.ones(3), np.ones(3, bool)), [1.0]),
            "totals has 1 rows for 3 trajectories; give one each",
        ),
        (lambda: CensoredOutcomes(0.0, 1.0, "cox"), "censoring is 'cox'; give CensoringSpec"),
        (lambda: CensoredOutcomes(0.0, np.inf), "low is 0.0 and high inf; give two finite numbers"),
        (lambda: monitored("folder", None), "stored is a str; give a StoredPolicy, as read_policy returns"),
        (lambda: changes_in("logs"), "logs is a str; give Logs, as read_logs returns"),
    ],
)
def test_what_is_no_number_no_policy_and_no_log_is_refused_in_a_line(asks, message):
    with refused_type(message):
        asks()


@pytest.mark.slow
def test_the_mean_is_ever_outside_no_more_often_than_said():
    # Skewed outcomes, whose range also changes from one to the next.
    rng, num, alpha = np.random.default_rng(5), 200, 0.1
    missed = 0
    for _ in range(num):
        heavy = np.where(rng.random(2000) < 0.5, 5.0, 1.25)
        values = np.where(rng.random(2000) < 0.1 / heavy, heavy, 0.0)
        course = BettingBounds(0.0, 1.0, alpha).add(values, 0.0, heavy)
        missed += bool((course.lower > 0.1 + 1e-9).any() or (course.upper < 0.1 - 1e-9).any())
    assert missed <= alpha * num + 2.0 * np.sqrt(num * alpha * (1 - alpha))
