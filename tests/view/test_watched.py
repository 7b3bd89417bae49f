"""What is shown of clouds, logs and recordings, and the page that shows it; shadows beside lines of sight."""

from dataclasses import replace

import numpy as np
import pytest
from watched_runs import EYE_M, SIGNS, run, stage_view

from halfseen.errors import ArgumentError, CloudError
from halfseen.learning import CensoredQLearner
from halfseen.logs import Logs
from halfseen.perception import perceive, read_cloud, write_pcd
from halfseen.policies import Decision
from halfseen.scene import table_paths
from halfseen.tables.present import first_state
from halfseen.view.recording import read_recording, write_recording
from halfseen.view.shapes import convex_mesh, is_behind, revealed_by, shadow
from halfseen.view.stage_view import stage_html
from halfseen.view.stages import coloured_points, watched_cloud, watched_logs
from small_logs import kept, table_log


def box(middle_m, half_m):
    return convex_mesh(np.asarray(middle_m) + SIGNS * half_m)


def in_box(points_m, middle_m, half_m):
    return (np.abs(points_m - np.asarray(middle_m)) <= half_m).all(axis=-1)


BOX_M = np.array([0.02, 0.0, 0.06]), np.array([0.04, 0.03, 0.06])
"""Middle and half sizes."""


def followed(points_m, middle_m, half_m):
    """Which lines of sight meet a box, by a thousand steps along each."""
    steps = np.linspace(0.0, 1.0, 1001)[:, None, None]
    return in_box(points_m + steps * (EYE_M - points_m), middle_m, half_m).any(axis=0)


def test_a_mesh_of_points_faces_outward_and_has_their_volume():
    mesh = box([0.1, 0.2, 0.3], [0.1, 0.2, 0.3])
    a, b, c = (mesh.vertices_m[mesh.faces[:, k]] for k in range(3))
    assert np.einsum("fd,fd->f", a, np.cross(b, c)).sum() / 6 == pytest.approx(8 * 0.1 * 0.2 * 0.3)
    assert len(mesh.vertices_m) == 8


def test_what_is_behind_a_box_is_what_lines_of_sight_say():
    points_m = np.random.default_rng(3).uniform([-0.1, -0.1, 0.0], [0.12, 0.3, 0.15], (2000, 3))
    behind, slowly = is_behind(points_m, box(*BOX_M), EYE_M), followed(points_m, *BOX_M)
    assert 100 < slowly.sum() < 1900
    # Steps may jump over an edge that the line of sight just touches.
    assert not (slowly & ~behind).any()
    assert (behind != slowly).sum() <= 4


def test_a_shadow_is_the_box_and_all_between_it_and_the_table_that_it_hides():
    dark = shadow(box(*BOX_M), EYE_M)
    points_m = np.random.default_rng(5).uniform([-0.2, -0.1, 0.001], [0.2, 0.5, 0.2], (4000, 3))
    a, b, c = (dark.vertices_m[dark.faces[:, k]] for k in range(3))
    outward = np.cross(b - a, c - a)
    is_inside = (np.einsum("nfd,fd->nf", points_m[:, None] - a, outward) <= 1e-12).all(axis=1)
    assert is_inside.sum() > 100
    assert (is_inside == is_behind(points_m, box(*BOX_M), EYE_M)).all()
    assert dark.vertices_m[:, 2].min() == pytest.approx(0.0, abs=1e-12)


def test_a_lift_reveals_what_only_it_hides():
    front, back, aside = (box([x, y, 0.05], [0.04, 0.03, 0.05]) for x, y in ((0, 0), (0, 0.1), (0.5, 0)))
    revealed_m = revealed_by(0, [front, back, aside], EYE_M)
    assert len(revealed_m) > 20
    assert in_box(revealed_m, [0, 0.1, 0.05], np.array([0.04, 0.03, 0.05]) + 1e-9).all()
    assert is_behind(revealed_m, front, EYE_M).all()
    assert len(revealed_by(2, [front, back, aside], EYE_M)) == 0
    again = box([0, -0.1, 0.15], [0.05, 0.03, 0.15])  # before the first: a lift of one alone shows less
    assert len(revealed_by(0, [front, back, aside, again], EYE_M)) < len(revealed_m)


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


def test_places_are_those_of_the_table_and_what_is_hidden_most_is_revealed_by_what_hides_it(view):
    (stage,) = watched_cloud(CLOUD, view, None, None, 0).stages
    assert abs(np.median(stage.points_m[:, 2])) < 0.02 or np.percentile(np.abs(stage.points_m[:, 2]), 25) < 0.01
    assert stage.eye_m[2] == pytest.approx(view.table.normal @ CLOUD.eye_m - view.table.offset_m, abs=1e-6)
    for shown, seen in zip(stage.objects, view.objects, strict=True):
        on_table = np.linalg.inv(view.cloud_from_table) @ [*seen.centroid_m, 1.0]
        assert shown.middle_m == pytest.approx(on_table[:3], abs=1e-9)
        assert shown.solid.vertices_m[:, 2].min() > -0.02
        assert shown.shadow.vertices_m[:, 2].min() > -0.02
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


@pytest.fixture(scope="module")
def in_folder(view, tmp_path_factory):
    """Logs of a table, each of whose stages names its cloud."""
    folder = tmp_path_factory.mktemp("clouds")
    logs = table_log(num_trajectories=4, num_objects=len(view.objects), hides=view.hides, seed=1)
    write_pcd(CLOUD, folder / "look.pcd")
    return Logs(logs.stages.assign(cloud="look.pcd"), logs.trajectories, logs.objects), folder


@pytest.mark.slow
def test_each_stage_shows_its_cloud_and_what_the_log_knew(in_folder):
    logs, folder = in_folder
    watched = watched_logs(logs, folder, 2)
    trajectory = logs.select(logs.trajectory_ids[1:2])
    assert len(watched.stages) == trajectory.horizon
    for t, stage in enumerate(watched.stages):
        rows = trajectory.objects[trajectory.objects["stage"] == t + 1]
        chances = 1 / (1 + np.exp(-rows["log_odds"].to_numpy(float)))
        assert [shown.is_dirty for shown in stage.objects] == pytest.approx(chances)
        done = trajectory.stages.iloc[t]
        assert stage.action.startswith(str(done["action"]))
        assert len(stage.events) >= t
    assert watched.stages[-1].events[-1].startswith("the trajectory ")


@pytest.mark.slow
def test_a_policy_is_asked_at_each_stage(in_folder, tmp_path):
    logs, folder = in_folder
    stored = kept(CensoredQLearner.for_table(3, reg=0.1), logs, tmp_path / "policy")
    watched = watched_logs(logs, folder, 1, stored)
    for stage in watched.stages:
        assert stage.options
        assert all(option.low < option.high and 0 <= option.chance_best <= 1 for option in stage.options)
        assert stage.action in stage.reason


def test_what_is_not_there_is_reported(in_folder):
    logs, folder = in_folder

    def of_stages(stages):
        return Logs(stages, logs.trajectories, logs.objects)

    for given, error, words in (
        ((logs, folder, 9), ArgumentError, "--trajectory is 9, but the log has 4 trajectories"),
        ((of_stages(logs.stages.drop(columns="cloud")), folder, 1), ArgumentError, "no column 'cloud'"),
        ((logs, folder / "elsewhere", 1), CloudError, "no such file"),
        ((of_stages(logs.stages.assign(cloud="../look.pcd")), folder, 1), ArgumentError, "is not in"),
        ((of_stages(logs.stages.assign(cloud=str(folder.parent / "look.pcd"))), folder, 1), ArgumentError, "is not in"),
        ((of_stages(logs.stages.assign(cloud=None)), folder, 1), ArgumentError, "no cloud is stored"),
    ):
        with pytest.raises(error, match=words):
            watched_logs(*given)


def same(one, other):
    if isinstance(one, np.ndarray):
        return one.shape == other.shape and np.allclose(one, other, atol=1e-6)
    if isinstance(one, tuple):
        return len(one) == len(other) and all(same(a, b) for a, b in zip(one, other, strict=True))
    if hasattr(one, "__dataclass_fields__"):
        return all(same(getattr(one, name), getattr(other, name)) for name in one.__dataclass_fields__)
    return one == other


def test_a_recording_comes_back_as_it_was_and_is_replaced_only_where_that_is_asked_for(tmp_path):
    watched = run()
    for name in ("one", "two"):
        write_recording(watched, tmp_path / name)
    assert same(watched, read_recording(tmp_path / "one"))
    assert not same(watched, run(2))
    one, two = ({file.name: file.read_bytes() for file in (tmp_path / name).iterdir()} for name in ("one", "two"))
    assert one == two
    with pytest.raises(ArgumentError, match="--overwrite"):
        write_recording(run(2), tmp_path / "one")
    write_recording(run(2), tmp_path / "one", overwrite=True)
    assert len(read_recording(tmp_path / "one").stages) == 2


@pytest.mark.parametrize(
    ("file", "harm"),
    [
        ("stage-0002.npz", lambda file: file.write_bytes(file.read_bytes()[:500])),
        ("stage-0003.npz", lambda file: file.unlink()),
        ("stage-0001.npz", lambda file: np.savez(file, points_m=np.zeros((3, 3)))),
        ("stage-0001.npz", lambda file: np.savez(file, words=np.array([{"a": 1}], dtype=object))),
    ],
    ids=["cut", "missing", "arrays missing", "code"],
)
def test_a_broken_recording_is_reported(tmp_path, file, harm):
    write_recording(run(), tmp_path / "run")
    harm(tmp_path / "run" / file)
    with pytest.raises(ArgumentError, match=r"run: not a complete recording .*; record it again"):
        read_recording(tmp_path / "run")


def test_a_stage_says_what_is_done_why_and_what_else_there_was_and_none_of_it_is_taken_for_html():
    html = stage_html(stage_view(2))
    for words in ("stage 2 of 3", "+2.50", "+1.00 to +4.00", "80%", "it may be doubted", "tried: 2", "(out of view)"):
        assert words in html
    assert "<strong>LIFT 0</strong>" in html
    assert "<strong>FINISH</strong>" not in html
    html = stage_html(replace(stage_view(1), reason="<script>alert(1)</script>", events=("<img src=x>",)))
    assert "<script>" not in html
    assert "<img" not in html
