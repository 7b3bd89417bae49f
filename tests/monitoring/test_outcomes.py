"""What trajectories add under cuts: by hand, by the past alone, unbiased, and bounds that hold under cuts."""

import numpy as np
import pytest

from halfseen.censoring import KaplanMeier, StageClocks
from halfseen.errors import ArgumentError
from halfseen.monitoring.outcomes import FEWEST, BettingBounds, CensoredOutcomes


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


def test_what_no_trajectory_can_bring_is_refused():
    with pytest.raises(ArgumentError, match=r"add up to 2, outside of 0 to 1"):
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
