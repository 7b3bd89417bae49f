"""What is said of planners, where they win, lose or neither."""

import pytest
from example_planning import example_pieces, example_times

from halfseen.study.planning_table import figure2, figure3, planning_frames
from halfseen.study.planning_words import figure2_title, figure3_title, horizon_sentence, planning_sentence, policy_name


def tables(**example):
    frames = planning_frames(example_pieces(**example))
    return figure2(frames, example_times()), figure3(frames, example_times(), 256)


@pytest.mark.parametrize(
    ("policy", "name"),
    [
        ("pomdp-1", "POMDP, 1 step ahead"),
        ("pomdp-6", "POMDP, 6 steps ahead"),
        ("search-5000", "search, 5000 simulations"),
        ("history", "greedy with history"),
        ("cql", "learned policy"),
    ],
)
def test_every_policy_has_a_name(policy, name):
    assert policy_name(policy) == name


@pytest.mark.parametrize(
    ("lead", "noise", "sentence", "title"),
    [
        (
            1.0,
            0.3,
            "is seen to earn more than the learned policy: the fastest",
            "The fastest planner seen to earn more",
        ),
        (0.0, 4.0, "a difference within noise", "no planner is seen to earn more than the learned policy"),
        (-2.0, 0.1, "At every decision budget planners", "every planner earns less than the learned policy"),
    ],
)
def test_planners_win_lose_or_neither(lead, noise, sentence, title):
    table, _ = tables(lead=lead, noise=noise)
    assert sentence in planning_sentence(table)
    assert title in figure2_title(table)
    assert "decides in 0.02 ms" in planning_sentence(table)


def test_the_fastest_planner_that_wins_and_the_strongest_are_named_with_their_times():
    table, _ = tables(lead=1.0)
    sentence = planning_sentence(table)
    assert "(search, 16 simulations, 0.4 ms a decision) earns 1." in sentence
    assert "the strongest" not in sentence
    table.loc[table["policy"] == "search-5000", "mean_reward"] = 99.0
    assert "the strongest (search, 5000 simulations, 76 ms a decision) 0." in planning_sentence(table)


def test_intervals_run_upwards_whatever_the_sign():
    for lead in (1.0, -1.0):
        sentence = planning_sentence(tables(lead=lead)[0])
        low, high = sentence.split("(")[2].split(")")[0].split(" to ")
        assert 0.0 < float(low) < float(high)


def test_a_strongest_planner_that_loses_is_not_called_noise():
    table, _ = tables(lead=-0.5, noise=0.1)
    table.loc[table["policy"] == "pomdp-1", "over_high"] = 0.3
    assert "less than what was learned" in planning_sentence(table)


def test_horizons_that_hurt_are_named():
    _, table = tables(hurts_at=4)
    assert "costs reward somewhere: at 4 steps it costs 1." in horizon_sentence(table)
    assert figure3_title(table).startswith(
        "A longer planning horizon costs reward at 4 steps; 6 steps in place of 1 cost"
    )


def test_horizons_that_neither_hurt_nor_help():
    _, table = tables()
    assert "costs no reward beyond noise" in horizon_sentence(table)
    assert figure3_title(table).startswith(
        "A longer planning horizon costs no reward beyond noise; 6 steps in place of 1"
    )


def test_horizons_that_help_are_named():
    _, table = tables()
    row = table["planning_horizon"] == 2
    table.loc[row, ["over_previous", "over_previous_low", "over_previous_high"]] = 0.5, 0.2, 0.8
    table.loc[5, ["over_first", "over_first_low", "over_first_high"]] = 0.6, 0.4, 0.8
    sentence = horizon_sentence(table)
    assert "at 2 steps it adds 0.50 (0.20 to 0.80)" in sentence
    assert "6 steps in place of 1 add 0.60 (0.40 to 0.80)" in sentence
