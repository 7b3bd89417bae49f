from typing import Any

import numpy as np
import pytest
from example_map import WORLD, example_pieces, example_table
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from halfseen.study.experiments.clutter import Clutter
from halfseen.study.experiments.clutter.table import (
    ENOUGH,
    LEARN,
    NO_SCALE,
    UNDECIDED,
    GainShare,
    gain_share,
    table_of,
    verdict,
)

COLUMNS = (
    "num_objects occlusion labels reward_wash_clean grip_offset_std is_assumed num_paths cut_share repetitions "
    "censored_q best_heuristic heuristic_reward finish_reward gain gain_se gain_share gain_share_low gain_share_high "
    "verdict"
)


def shares(*values):
    """Shares of 10 that are gained, repetition by repetition."""
    return gain_share(10.0 * np.array(values), np.full(len(values), 10.0), 1.0)


def test_the_table_has_a_row_for_each_place_and_its_numbers_fit_together():
    table = example_table(lambda place: 0.2 if place.num_objects == 3 else 0.0)
    assert list(table.columns) == COLUMNS.split()
    assert len(table) == 99
    assert (table["best_heuristic"] == "history-penalty").all()
    assert (table["finish_reward"] == -3.0 * table["num_objects"]).all()
    np.testing.assert_allclose(table["gain"], table["censored_q"] - table["heuristic_reward"])
    np.testing.assert_allclose(
        table["gain_share"], table["gain"] / (table["heuristic_reward"] - table["finish_reward"])
    )
    assert (table["gain_share_low"] < table["gain_share"]).all()
    assert (table["gain_share"] < table["gain_share_high"]).all()
    assert set(table.loc[table["num_objects"] == 3, "verdict"]) == {LEARN}
    assert set(table.loc[table["num_objects"] != 3, "verdict"]) == {ENOUGH}


def test_a_constant_scale_gives_the_paired_t_interval():
    found = shares(0.01, 0.03, 0.08, 0.02)
    low, high = stats.ttest_1samp([0.01, 0.03, 0.08, 0.02], 0.0).confidence_interval()
    assert found == pytest.approx((0.035, low, high))


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 10_000), st.integers(3, 20))
def test_at_the_ends_of_the_interval_the_paired_test_is_at_its_level(seed, repetitions):
    rng = np.random.default_rng(seed)
    earned = 10.0 + rng.normal(size=repetitions)
    gain = rng.normal(1.0, 2.0, size=repetitions) - 0.5 * earned
    found = gain_share(gain, earned, 0.0)
    assert found.low < found.share < found.high
    for end in (found.low, found.high):
        test: Any = stats.ttest_1samp(gain - end * earned, 0.0)
        assert test.pvalue == pytest.approx(0.05, abs=1e-6)


@pytest.mark.parametrize(
    ("low", "high", "expected"),
    [
        (0.06, 0.2, LEARN),
        (-0.2, 0.04, ENOUGH),
        (0.04, 0.06, UNDECIDED),
        (0.05, 0.05, UNDECIDED),
        (0.05, 0.1, UNDECIDED),
        (0.0, 0.05, UNDECIDED),
        (np.nan, np.nan, NO_SCALE),
    ],
)
def test_the_verdict_is_where_the_interval_lies(low, high, expected):
    assert verdict(GainShare((low + high) / 2, low, high), 0.05) == expected


def test_what_earns_next_to_nothing_is_no_scale():
    gain = np.array([1.0, 2.0, 1.5])
    assert np.isnan(gain_share(gain, np.array([0.1, 0.1, 0.1]), 0.5)).all()
    assert np.isnan(gain_share(gain, np.array([-2.0, -3.0, -2.5]), 0.5)).all()
    # Far above on average, but not told from nothing.
    assert np.isnan(gain_share(gain, np.array([9.0, -3.0, 4.0]), 0.5)).all()
    assert np.isfinite(gain_share(gain, np.array([3.0, 3.2, 2.9]), 0.5)).all()


def test_a_place_without_a_scale_says_so_and_keeps_the_gain():
    pieces = example_pieces(lambda place: 0.0)
    for piece in pieces:
        row = piece["map"][0]
        row["rewards"] = dict.fromkeys(row["rewards"], -3.0 * row["num_objects"] + 0.1) | {"censored_q": 4.0}
    first = table_of(Clutter(), WORLD, pieces).iloc[0]
    assert first["verdict"] == NO_SCALE
    assert np.isnan(first[["gain_share", "gain_share_low", "gain_share_high"]].to_numpy(dtype=float)).all()
    assert first["gain"] == pytest.approx(4.0 + 9.0 - 0.1)


def test_the_best_heuristic_is_the_best_on_average_in_its_place():
    pieces = example_pieces(lambda place: 0.0, repetitions=2)
    for piece, greedy in zip(pieces, (100.0, -50.0), strict=True):
        piece["map"][4]["rewards"]["greedy"] = greedy
    table = table_of(Clutter(), WORLD, pieces)
    assert table["best_heuristic"].tolist().count("greedy") == 1
    assert table["best_heuristic"][4] == "greedy"
