"""One cloud, as it is shown."""

from dataclasses import replace

import numpy as np
import pytest

from halfseen.perception import perceive, read_cloud
from halfseen.policies import Decision
from halfseen.scene import table_paths
from halfseen.tables.present import first_state
from halfseen.view.stages import coloured_points, watched_cloud

CLOUD = read_cloud(table_paths()[7])


@pytest.fixture(scope="module")
def view():
    return perceive(CLOUD)


def test_a_cloud_with_a_decision_is_one_stage(view):
    now = first_state(view.scene(), 10, 0.6)
    q = {"FINISH": -1.0, "LIFT 1": None, "WASH 3": 2.0, "WASH 0": 0.5}
    (stage,) = watched_cloud(CLOUD, view, now, Decision("WASH 3", q, "because", ("doubt",)), 10).stages
    assert (stage.title, stage.action, stage.reason, stage.notes) == ("stage 1 of 10", "WASH 3", "because", ("doubt",))
    assert [(each.name, each.value) for each in stage.options] == [("WASH 3", 2.0), ("WASH 0", 0.5), ("FINISH", -1.0)]
    assert stage.target == 3
    assert [shown.is_dirty for shown in stage.objects] == pytest.approx([0.6] * len(view.objects))
    assert len(stage.points_m) == CLOUD.num_returns == len(stage.colours)
    assert (stage.hides == view.hides).all()


def test_places_are_those_of_the_table(view):
    (stage,) = watched_cloud(CLOUD, view, None, None, 0).stages
    assert abs(np.median(stage.points_m[:, 2])) < 0.02 or np.percentile(np.abs(stage.points_m[:, 2]), 25) < 0.01
    assert stage.eye_m[2] == pytest.approx(view.table.normal @ CLOUD.eye_m - view.table.offset_m, abs=1e-6)
    for shown, seen in zip(stage.objects, view.objects, strict=True):
        on_table = np.linalg.inv(view.cloud_from_table) @ [*seen.centroid_m, 1.0]
        assert shown.middle_m == pytest.approx(on_table[:3], abs=1e-9)
        assert shown.solid.vertices_m[:, 2].min() > -0.02
        assert shown.shadow.vertices_m[:, 2].min() > -0.02


def test_what_is_hidden_most_is_revealed_by_what_hides_it(view):
    (stage,) = watched_cloud(CLOUD, view, None, None, 0).stages
    hidden, hider = np.unravel_index(np.argmax(view.hides), view.hides.shape)
    revealed_m = stage.objects[hider].revealed_m
    assert len(revealed_m) > 0
    apart_m = [np.linalg.norm(revealed_m.mean(axis=0) - shown.middle_m) for shown in stage.objects]
    assert int(np.argmin(apart_m)) == hidden


def test_points_keep_their_colours_and_others_are_grey():
    grey = coloured_points(CLOUD, np.eye(4))[1]
    assert (grey == grey[:, :1]).all()
    assert len(np.unique(grey)) > 20
    painted = np.tile(np.array([10, 20, 30], dtype=np.uint8), (len(CLOUD.points_m), 1))
    points_m, colours = coloured_points(replace(CLOUD, colours=painted), np.eye(4))
    assert (colours == [10, 20, 30]).all()
    assert len(points_m) == CLOUD.num_returns
