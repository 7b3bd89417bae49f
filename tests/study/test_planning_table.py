"""Tables of the planners, from made-up pieces."""

import numpy as np
import pytest
from example_planning import NUM_REPETITIONS, OWN_REWARD, TIMES_MS, example_pieces, example_times
from scipy import stats

from halfseen.errors import ArgumentError
from halfseen.study.planning_table import (
    TABLE1_COLUMNS,
    figure2,
    figure3,
    planner_rows,
    planning_frames,
    strongest_within,
)
from halfseen.study.results import MEASURES

BUDGETS_MS = {"100 ms": 100.0, "1 s": 1000.0}


def tables(slower=1.0, **example):
    frames, times_ms = planning_frames(example_pieces(**example)), example_times(slower)
    return frames, times_ms, figure2(frames, times_ms)


def test_one_repetition_has_no_errors():
    with pytest.raises(ArgumentError, match="1 repetition of the planners"):
        planning_frames(example_pieces()[:1])


def test_every_policy_has_its_time_kind_and_episodes():
    table = tables()[2].set_index("policy")
    assert set(table.index) == set(TIMES_MS)
    assert table["decision_ms"].to_dict() == pytest.approx(TIMES_MS)
    assert table["kind"].value_counts().to_dict() == {"planner": 10, "heuristic": 4, "learned": 1}
    assert table["simulations"].dropna().to_dict() == {f"search-{n}": n for n in (16, 400, 5000, 50000)}
    assert table.loc[["cql", "search-5000", "search-50000"], "episodes"].tolist() == [20, 10, 2]
    assert (table["repetitions"] == NUM_REPETITIONS).all()


def test_what_few_episodes_share_with_the_learned_policy_drops_out():
    pieces = example_pieces(lead=0.5, noise=0.0)
    table = figure2(planning_frames(pieces), example_times()).set_index("policy")

    played = [row for piece in pieces for row in piece["played"] if row["policy"] == "search-50000"]
    luck = abs(np.mean([row["reward"] for row in played]) - OWN_REWARD - 0.5)
    assert luck > 0.2
    np.testing.assert_allclose(table.loc["search-50000", "over_cql"], 0.5, atol=1e-9)
    np.testing.assert_allclose(table.loc["search-50000", "se_over"], 0.0, atol=1e-9)
    own = table.loc["cql"]
    assert table.loc["search-50000", "mean_reward"] == pytest.approx(own["mean_reward"] + 0.5)
    assert (own["over_cql"], own["se_over"]) == (0.0, 0.0)


def test_errors_are_over_block_means_and_wider_where_blocks_are_small():
    pieces = example_pieces()
    table = figure2(planning_frames(pieces), example_times()).set_index("policy")
    by_name = [{row["policy"]: row for row in piece["played"]} for piece in pieces]
    over = [np.mean(of["pomdp-2"]["reward"]) - np.mean(of["cql"]["reward"]) for of in by_name]
    error = np.std(over, ddof=1) / np.sqrt(NUM_REPETITIONS)
    row = table.loc["pomdp-2"]

    assert (row["over_cql"], row["se_over"]) == pytest.approx((np.mean(over), error))
    reach = stats.t.ppf(0.975, NUM_REPETITIONS - 1) * error
    assert (row["over_low"], row["over_high"]) == pytest.approx((np.mean(over) - reach, np.mean(over) + reach))
    assert table.loc["search-50000", "se_over"] > 1.5 * table.loc["search-16", "se_over"]


def test_horizons_are_paired_with_the_next_shorter_and_the_shortest():
    frames, times_ms, _ = tables(hurts_at=4)
    table = figure3(frames, times_ms, 256).set_index("planning_horizon")

    assert list(table.index) == [1, 2, 3, 4, 5, 6]
    assert table["simulations"].isna().tolist() == [True] + 5 * [False]
    assert table.loc[1, ["over_previous", "se_over_previous", "over_first", "over_first_high"]].isna().all()
    np.testing.assert_allclose(table["over_previous"][1:], [0.0, 0.0, -1.0, 0.0, 0.0], atol=0.2)
    np.testing.assert_allclose(table["over_first"][1:], [0.0, 0.0, -1.0, -1.0, -1.0], atol=0.2)
    np.testing.assert_allclose(table["over_previous"][1:].cumsum(), table["over_first"][1:])
    # What all meet cancels in the differences.
    assert (table["se_over_previous"][1:] < table["se"][1:] / 5).all()


def test_the_strongest_planner_is_within_its_budget():
    table = tables(lead=0.5)[2].set_index("policy", drop=False)
    table.loc["search-50000", "mean_reward"] = 99.0
    table.loc["history", "mean_reward"] = 100.0
    assert strongest_within(table, 1000.0) == "search-50000"
    assert strongest_within(table, 810.0 / 1.25) == "search-50000"
    assert strongest_within(table, 809.0 / 1.25) != "search-50000"
    assert strongest_within(table, 0.07) == "pomdp-1"
    assert strongest_within(table, 0.01) is None


def test_rows_of_table_1_hold_the_learned_policy_against_them():
    frames, times_ms, table = tables(lead=-0.5)
    rows = planner_rows(frames, table, times_ms, BUDGETS_MS)

    assert list(rows.columns) == TABLE1_COLUMNS
    assert rows["measure"].tolist() == 2 * list(MEASURES)
    assert "100 ms" in rows["baseline"].iloc[0]
    reward = rows[rows["measure"] == "reward"].iloc[0]
    row = table.set_index("policy").loc[strongest_within(table, 100.0)]
    assert reward["effect"] == pytest.approx(-row["over_cql"])
    assert reward["effect_low"] == pytest.approx(-row["over_high"])
    assert reward["cql"] - reward["other"] == pytest.approx(reward["effect"])
    assert reward["p_value"] < 0.05
    decision = rows[rows["measure"] == "decision_ms"].iloc[0]
    assert decision["cql"] == pytest.approx(0.02)
    assert decision["p_value"] < 0.01
    assert (rows.loc[rows["measure"] == "robot_s", "p_value"] == 1.0).all()


def test_times_are_paired_on_the_states_that_both_decided():
    frames, times_ms, table = tables()
    table.loc[table["policy"] == "search-50000", "mean_reward"] = 99.0
    rows = planner_rows(frames, table, times_ms, {"1 s": 1000.0})
    decision = rows[rows["measure"] == "decision_ms"].iloc[0]
    assert decision["cql"] == pytest.approx(np.mean(times_ms["cql"][:4]))
    assert decision["other"] == pytest.approx(810.0)


def test_a_machine_on_which_no_planner_is_within_a_budget_has_no_row():
    frames, times_ms, table = tables(slower=2000.0)
    assert planner_rows(frames, table, times_ms, BUDGETS_MS)["baseline"].nunique() == 1
