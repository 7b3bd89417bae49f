from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from fitted_laws import GRASPING, SEEING
from halfseen.errors import ArgumentError
from halfseen.study.experiment import Setting
from halfseen.study.experiments.clutter.places import ClutterDesign, random_tables
from halfseen.world.config import WorldConfig


@settings(max_examples=30, deadline=None)
@given(st.integers(2, 12), st.floats(0.0, 0.99), st.integers(0, 1000))
def test_every_table_has_the_wanted_mean_occlusion(num_objects, share_of_largest, seed):
    occlusion = share_of_largest * (num_objects - 1) / num_objects
    tables = random_tables(num_objects, occlusion, 3, np.random.default_rng(seed))

    assert [table.num_objects for table in tables] == [num_objects] * 3
    for table in tables:
        assert table.occlusion.mean() == pytest.approx(occlusion, abs=1e-9)


def test_nearer_objects_hide_farther_ones_alone():
    for table in random_tables(6, 0.4, 20, np.random.default_rng(0)):
        assert not np.any((table.hides > 0) & (table.hides.T > 0))
        assert sorted(np.count_nonzero(table.hides, axis=1)) == [0, 1, 2, 3, 4, 5]


def test_the_same_seed_gives_the_same_tables_denser_or_looser():
    loose, dense, again = (random_tables(5, each, 4, np.random.default_rng(7)) for each in (0.2, 0.5, 0.5))
    for thin, thick, same in zip(loose, dense, again, strict=True):
        assert np.array_equal(thick.hides, same.hides)
        assert np.all((thick.hides > thin.hides) == (thin.hides > 0))
    assert not np.array_equal(dense[0].hides, dense[1].hides)


@pytest.mark.parametrize(("num_objects", "occlusion"), [(1, 0.1), (2, 0.5), (3, 0.7), (3, -0.1), (0, 0.0), (3, np.nan)])
def test_a_clutter_that_no_table_has_is_refused(num_objects, occlusion):
    with pytest.raises(ArgumentError, match="nearest is in full view"):
        random_tables(num_objects, occlusion, 1, np.random.default_rng(0))
    with pytest.raises(ArgumentError, match="nearest is in full view"):
        ClutterDesign(num_objects=(5, num_objects), occlusions=(0.0, occlusion))


def test_labels_and_costs_are_crossed_and_spreads_vary_the_worlds_own():
    places = ClutterDesign().places(Setting(()))
    assert len(places) == len(set(places)) == 9 * (3 * 3 + 2)
    crossed = {(place.labels, place.reward_wash_clean) for place in places if place.grip_offset_std == 1.0}
    assert crossed == {(gain, reward) for gain in (0.15, 0.3, 0.45) for reward in (-5.0, -10.0, -20.0)}
    assert {(place.labels, place.reward_wash_clean) for place in places if place.grip_offset_std != 1.0} == {
        (0.3, -10.0)
    }
    assert len({(place.num_objects, place.occlusion) for place in places}) == 9


def test_under_a_law_of_a_cell_the_assumed_laws_are_one_more_row(tmp_path):
    grasping = replace(GRASPING, offset_std=3.5961921927952466)
    setting = Setting((), world=WorldConfig(grasping=grasping, seeing=SEEING, transport_s=4.0), law=tmp_path)
    design = ClutterDesign()
    places = design.places(setting)
    assert len(places) == len(set(places)) == 9 * (3 * 3 + 2 + 1)
    assert [len(column) for column in design.panels(setting)] == [3, 3, 3, 4]
    shown = {place.labels for place in places if not place.is_assumed}
    assert sorted(shown) == pytest.approx([0.5 * SEEING.facing, SEEING.facing, min(1.5 * SEEING.facing, 1.0)])
    last = places[-1]
    assert last.is_assumed
    assert last.world(setting.world) == WorldConfig()
    assert replace(places[0].world(setting.world), reward_wash_clean=-10.0).grasping == grasping


def test_grips_of_random_tables_are_drawn_from_those_of_the_cell():
    rng = np.random.default_rng(0)
    scenes = random_tables(4, 0.3, 50, rng, (-2.0, 0.5))
    grips = np.array([scene.grip for scene in scenes])
    assert set(grips.ravel()) == {-2.0, 0.5}
    without = random_tables(4, 0.3, 50, np.random.default_rng(0))
    assert all(np.array_equal(one.hides, other.hides) for one, other in zip(scenes, without, strict=True))
    assert not any(scene.grip.any() for scene in without)
