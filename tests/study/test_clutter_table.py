"""The map of tables and costs: its places, its numbers beside paired tests, its verdicts and words."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from examples import map_pieces, map_section, map_table, table_of
from fitted_laws import GRASPING, SEEING
from halfseen.errors import ArgumentError
from halfseen.study.experiments.clutter import ENOUGH, LEARN, NO_SCALE, UNDECIDED, Clutter, GainShare, levels, verdict
from halfseen.study.experiments.clutter_places import random_tables
from halfseen.study.setting import Setting
from halfseen.world.config import WorldConfig

COLUMNS = (
    "num_objects occlusion labels reward_wash_clean grip_offset_std is_assumed num_trajectories cut_share repetitions "
    "censored_q best_heuristic heuristic_reward finish_reward gain gain_se gain_share gain_share_low gain_share_high "
    "verdict"
)
HEURISTICS = ["greedy", "history", "greedy-penalty", "history-penalty"]
SHARE = ["gain_share", "gain_share_low", "gain_share_high"]


@pytest.fixture(scope="module")
def of_three():
    """A map in which learning pays on tables of three objects."""
    return map_table(lambda place: 0.3 if place.num_objects == 3 else 0.0)


def test_the_table_has_a_row_for_each_place_and_its_numbers_fit_together(of_three):
    table = of_three
    assert list(table.columns) == COLUMNS.split()
    assert len(table) == 99
    assert (table["best_heuristic"] == "history-penalty").all()
    assert (table["finish_reward"] == -3.0 * table["num_objects"]).all()
    np.testing.assert_allclose(table["gain"], table["censored_q"] - table["heuristic_reward"])
    scale = table["heuristic_reward"] - table["finish_reward"]
    np.testing.assert_allclose(table["gain_share"], table["gain"] / scale)
    assert ((table["gain_share_low"] < table["gain_share"]) & (table["gain_share"] < table["gain_share_high"])).all()
    assert set(table.loc[table["num_objects"] == 3, "verdict"]) == {LEARN}
    assert set(table.loc[table["num_objects"] != 3, "verdict"]) == {ENOUGH}


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


def test_a_place_without_a_scale_keeps_the_gain_and_the_best_heuristic_is_the_best_on_average_in_its_place():
    pieces = map_pieces(lambda place: 0.0, repetitions=2)
    for piece, greedy in zip(pieces, (100.0, -50.0), strict=True):
        row = piece["rows"][0]
        row |= dict.fromkeys(HEURISTICS, -3.0 * row["num_objects"] + 0.1) | {"censored_q": 4.0}
        piece["rows"][4]["greedy"] = greedy
    table = table_of(pieces)
    assert table["verdict"][0] == NO_SCALE
    assert table.loc[0, SHARE].isna().all()
    assert table["gain"][0] == pytest.approx(4.0 + 9.0 - 0.1)
    assert table["best_heuristic"][1:].tolist().count("greedy") == 1
    assert table["best_heuristic"][4] == "greedy"


def test_the_factor_that_decides_is_named_with_its_count_and_no_factor_is_blamed_for_another():
    # Learning pays where washing a clean cup is dear.
    of_dear = map_table(lambda place: 0.3 if place.reward_wash_clean == -20 else 0.0)
    section = map_section(of_dear)
    title, (sentence,) = section.drawings[0].title, section.sentences
    dear = "washing a clean cup costs 4 times what a dirty one earns"
    assert title.startswith(
        f"Learning pays in 27 of 99 places, most often where {dear} (27 of 27); the best heuristic is good enough in "
    )
    assert sentence.startswith(
        f"{title}. It pays where the policy learned from 200 logged trajectories, of which about half "
    )
    assert "gains more than 5 % of what the best heuristic earns above finishing at once" in sentence
    # What is dear is learned; spreads were varied where it is not dear, and so tell nothing apart.
    counts = {"grip_offset_std": [], "labels": []}
    for level in levels(of_dear, LEARN).itertuples():
        counts.get(level.factor, []).append((level.num_places, level.num_verdicts))
    assert counts == {"grip_offset_std": [(9, 0)] * 3, "labels": [(27, 9)] * 3}


@pytest.mark.parametrize(
    ("factor", "value", "words"),
    [
        ("num_objects", 9, "9 objects stand on the table"),
        ("occlusion", 0.3, "30 % of an object is hidden on average"),
        ("labels", 0.15, "a label in full view is right 65 % of the time"),
        ("reward_wash_clean", -5.0, "washing a clean cup costs as much as a dirty one earns"),
        ("grip_offset_std", 1.5, "grip offsets spread by 1.5"),
    ],
)
def test_levels_in_words(factor, value, words):
    table = map_table(lambda place: 0.3 if getattr(place, factor) == value else 0.0)
    assert f"most often where {words} (" in map_section(table).drawings[0].title


def test_the_assumed_laws_are_counted_apart(of_three):
    beside = of_three.head(9).assign(is_assumed=True)
    alone, both = (map_section(each).drawings[0].title for each in (of_three, pd.concat([of_three, beside])))
    num = int((beside["verdict"] == LEARN).sum())
    assert 0 < num < 9
    assert both == f"{alone}; under the assumed laws, these are {num} and {9 - num} of 9"


def tables(num_objects, occlusion, num, seed=0, *grips):
    return random_tables(num_objects, occlusion, num, np.random.default_rng(seed), *grips)


@settings(max_examples=30, deadline=None)
@given(st.integers(2, 12), st.floats(0.0, 0.99), st.integers(0, 1000))
def test_every_table_has_the_wanted_mean_occlusion(num_objects, share_of_largest, seed):
    occlusion = share_of_largest * (num_objects - 1) / num_objects
    made = tables(num_objects, occlusion, 3, seed)
    assert [table.num_objects for table in made] == [num_objects] * 3
    assert [table.occlusion.mean() for table in made] == pytest.approx([occlusion] * 3, abs=1e-9)


def test_nearer_objects_hide_farther_ones_alone_and_a_seed_gives_the_same_tables_denser_or_looser():
    for table in tables(6, 0.4, 20):
        assert not np.any((table.hides > 0) & (table.hides.T > 0))
        assert sorted(np.count_nonzero(table.hides, axis=1)) == [0, 1, 2, 3, 4, 5]
    loose, dense, again = (tables(5, each, 4, 7) for each in (0.2, 0.5, 0.5))
    for thin, thick, same in zip(loose, dense, again, strict=True):
        assert np.array_equal(thick.hides, same.hides)
        assert np.all((thick.hides > thin.hides) == (thin.hides > 0))
    assert not np.array_equal(dense[0].hides, dense[1].hides)
    # Grips are drawn from those of the cell, and change nothing else.
    scenes, without = tables(4, 0.3, 50, 0, (-2.0, 0.5)), tables(4, 0.3, 50)
    assert set(np.array([scene.grip for scene in scenes]).ravel()) == {-2.0, 0.5}
    assert all(np.array_equal(one.hides, other.hides) for one, other in zip(scenes, without, strict=True))
    assert not any(scene.grip.any() for scene in without)


@pytest.mark.parametrize(("num_objects", "occlusion"), [(1, 0.1), (2, 0.5), (3, 0.7), (3, -0.1), (0, 0.0), (3, np.nan)])
def test_a_clutter_that_no_table_has_is_refused(num_objects, occlusion):
    with pytest.raises(ArgumentError, match="nearest is in full view"):
        tables(num_objects, occlusion, 1)
    with pytest.raises(ArgumentError, match="nearest is in full view"):
        Clutter(num_objects=(5, num_objects), occlusions=(0.0, occlusion))


def test_labels_and_costs_are_crossed_and_spreads_vary_the_worlds_own():
    places = Clutter().places(Setting(()))
    assert len(places) == len(set(places)) == 9 * (3 * 3 + 2)
    pairs = {True: set(), False: set()}
    for place in places:
        pairs[place.grip_offset_std == 1.0].add((place.labels, place.reward_wash_clean))
    assert pairs[True] == {(gain, reward) for gain in (0.15, 0.3, 0.45) for reward in (-5.0, -10.0, -20.0)}
    assert pairs[False] == {(0.3, -10.0)}
    assert len({(place.num_objects, place.occlusion) for place in places}) == 9


def test_under_a_law_of_a_cell_the_assumed_laws_are_one_more_row(tmp_path):
    grasping, design = replace(GRASPING, offset_std=3.5961921927952466), Clutter()
    setting = Setting((), world=WorldConfig(grasping=grasping, seeing=SEEING, transport_s=4.0), law=tmp_path)
    places = design.places(setting)
    assert len(places) == len(set(places)) == 9 * (3 * 3 + 2 + 1)
    assert [len(column) for column in design.panels(setting)] == [3, 3, 3, 4]
    shown = {place.labels for place in places if not place.is_assumed}
    assert sorted(shown) == pytest.approx([0.5 * SEEING.facing, SEEING.facing, min(1.5 * SEEING.facing, 1.0)])
    assert places[-1].is_assumed
    assert places[-1].world(setting.world) == WorldConfig()
    assert replace(places[0].world(setting.world), reward_wash_clean=-10.0).grasping == grasping
