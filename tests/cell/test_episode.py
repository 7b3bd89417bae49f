"""One table in physics: what is earned is what the truth says, and the log tells all that the robot saw."""

from dataclasses import replace

import numpy as np
import pytest

from halfseen.arrays import record
from halfseen.cell.campaign import RUN_FILE, Campaign, Conditions, logs_of, table_name, working_folder
from halfseen.cell.clearing import NOTHING_SEEN
from halfseen.cell.episode import play
from halfseen.cell.facts import Facts
from halfseen.cell.memory import MORE_IN_VIEW, Glance, Known, Memory
from halfseen.cell.stops import Stops
from halfseen.cell.summary import scenes_of, summarised
from halfseen.cell.table_state import MOST_OBJECTS, Belief, no_grip, state_of
from halfseen.cell.trying import LiftAtRandom
from halfseen.cell.workcell import Workcell
from halfseen.errors import ArgumentError, LogError, SceneError
from halfseen.logs import LogRecorder, read_logs
from halfseen.planners.heuristics import GreedyPolicy
from halfseen.policies.history import present_state
from halfseen.scene.camera import look_at
from halfseen.scene.cups import Cup
from halfseen.scene.poses import Pose
from halfseen.scene.stains import Stain, Surface
from halfseen.scene.table import TABLE_TOP_M, Table
from halfseen.scene.xtion import xtion_at
from halfseen.workers import Workers
from halfseen.world import ActionSpace, Scene, Verb, WorldConfig, random
from halfseen.world.logs import states_of
from halfseen.world.policy import surely
from halfseen.world.seeing import PersistentSeeing
from halfseen.world.state import attempt_counts

CAMERA = xtion_at(look_at(np.array([0.0, -0.78, 1.24]), np.array([0.0, 0.0, TABLE_TOP_M])))
CUPS = (Cup(0.10, 0.040, 0.034), Cup(0.09, 0.042, 0.036))
POSES = (Pose((0.0, -0.02, TABLE_TOP_M)), Pose((0.02, 0.10, TABLE_TOP_M)))
WHITE, BROWN = (238, 236, 230), (98, 62, 30)
# The first cup has a stain that faces the camera, the second none.
FACING = Stain(-0.5 * np.pi, 0.05, 0.014, False, BROWN)
SURFACES = (Surface(CUPS[0], WHITE, (FACING,)), Surface(CUPS[1], WHITE))
IS_DIRTY = np.array([True, False])
BELIEF = Belief(WorldConfig(), no_grip)
ACTIONS = ActionSpace(MOST_OBJECTS)


@record
class Scripted:
    """Takes actions in turn."""

    actions: np.ndarray

    def decide(self, state, key):
        return surely(self.actions[state.horizon - state.steps_to_go])


def scripted(*steps):
    """A policy of verbs and objects, in turn."""
    actions = [int(ACTIONS.encode(verb, target)) for verb, target in steps]
    return Scripted(np.array([*actions, *[0] * (10 - len(actions))], dtype=np.int32))


def played(folder, policy, stops=None, *, is_dirty=IS_DIRTY):
    cell = Workcell(Table(CUPS, POSES, CAMERA), np.random.default_rng(0), SURFACES, stops=stops)
    with LogRecorder(folder) as recorder:
        path = recorder.begin_path(0, dirty_share=0.6)
        run = play(cell, is_dirty, policy, BELIEF, path, random.key_of(0), tells_truth=True)
    return run, read_logs(folder), cell


@pytest.fixture(scope="module")
def numbers():
    """Which number in a robot's memory is which cup."""
    cell = Workcell(Table(CUPS, POSES, CAMERA), np.random.default_rng(0), SURFACES)
    cell.look()
    places_m = np.array([pose.position_m for pose in POSES])
    return [
        int(np.argmin([np.linalg.norm(known.middle_m - place) for known in cell.memory.objects])) for place in places_m
    ]


def test_washing_the_dirty_cup_and_finishing_earns_five(tmp_path, numbers):
    run, logs, cell = played(tmp_path / "logs", scripted((Verb.WASH, numbers[0]), (Verb.FINISH, 0)))
    assert run.reward == 5.0
    assert (run.num_racked, run.num_washed, run.num_dirty, run.num_toppled, run.num_fallen) == (1, 1, 1, 0, 0)
    assert run.verbs == {"WASH": 1, "FINISH": 1}
    assert logs.stages["reward"].tolist() == [5.0, 0.0]
    assert logs.is_finished.all()
    assert 10.0 < run.seconds < 40.0
    # The label of the stain that faces the camera was right, and the log says what was told and what was true.
    first = logs.objects[logs.objects["stage"] == 1]
    assert [list(each) for each in first["glance_dirty"]] == [[number == numbers[0]] for number in range(2)]
    assert first["is_dirty"].tolist() == [number == numbers[0] for number in range(2)]
    assert logs.objects["location"].tolist()[-2:].count("DISHWASHER") == 1
    # Where it was seen last is where it stood, on the table.
    places_m, stood_m = (first.sort_values("object")[["x_m", "y_m", "z_m"]].to_numpy(), [POSES[0], POSES[1]])
    apart_m = np.linalg.norm(places_m[numbers[1]] - places_m[numbers[0]])
    between_m = np.subtract(stood_m[1].position_m, stood_m[0].position_m)
    assert apart_m == pytest.approx(np.linalg.norm(between_m), abs=0.02)
    assert places_m[:, 2] == pytest.approx([0.05, 0.045], abs=0.02)
    # What is in the log is the state that was decided in.
    state = state_of(cell.memory, BELIEF, 8)
    last = states_of(logs, 10)
    np.testing.assert_allclose(np.asarray(last.log_odds)[0, 1], np.asarray(state.log_odds)[:2], atol=1e-5)
    assert np.asarray(last.is_on_table)[0, 1].tolist() == np.asarray(state.is_on_table)[:2].tolist()


def test_a_lift_costs_its_time_and_shows_all_sides(tmp_path, numbers):
    run, logs, _ = played(tmp_path / "logs", scripted((Verb.LIFT, numbers[0]), (Verb.FINISH, 0)))
    lifted = logs.stages.iloc[0]
    assert lifted["reward"] == pytest.approx(-0.1 * lifted["elapsed_s"], abs=0.06)
    assert run.reward == pytest.approx(lifted["reward"] - 5.0)
    after = logs.objects[(logs.objects["stage"] == 2) & (logs.objects["object"] == numbers[0])].iloc[0]
    assert after["lifts"] == 1
    assert list(after["glance_held"]) == [False, True]
    assert list(after["glance_dirty"]) == [True, True]
    assert len(after["attempt_s"]) == 1


def test_what_stops_a_cell_is_the_cause_of_a_cut(tmp_path, numbers):
    run, logs, _ = played(tmp_path / "logs", scripted((Verb.WASH, numbers[0])), Stops(limit_s=3.0))
    assert run.cause == "time-out"
    assert logs.paths["cause"].tolist() == ["time-out"]
    assert logs.stages["reward"].isna().tolist() == [True]
    assert 3.0 < logs.end_s[0] < 5.0


def test_what_a_cell_recorded_is_a_history_to_go_on_from(tmp_path, numbers):
    _, logs, _ = played(tmp_path / "logs", scripted((Verb.WASH, numbers[0])), Stops(limit_s=3.0))
    view = Workcell(Table(CUPS, POSES, CAMERA), np.random.default_rng(1), SURFACES).look()
    places_m = np.array([seen.solid.middle_m for seen in view.objects])
    turned = Scene(view.hides[::-1, ::-1])
    now = [
        present_state(scene, 10, logs, dirty_share=0.6, places_m=seen_m)
        for scene, seen_m in ((view.scene(), places_m), (turned, places_m[::-1]))
    ]
    assert [each.notes for each in now] == [(), ()]
    np.testing.assert_array_equal(now[0].state.log_odds, now[1].state.log_odds[::-1])
    is_tried = np.asarray(attempt_counts(now[0].state)).sum(axis=0).tolist()
    dirty = int(np.argmax(np.asarray(now[0].state.log_odds)))
    assert is_tried == [int(number == dirty) for number in range(2)]
    assert now[0].stage == 2


def test_a_table_that_is_believed_empty_is_finished_and_what_is_left_is_paid_for(tmp_path, numbers, monkeypatch):
    looks, look = [], Workcell.look

    def losing(cell):
        looks.append(look(cell))
        for known in cell.memory.objects:
            known.is_lost = len(looks) > 1

    monkeypatch.setattr(Workcell, "look", losing)
    _, logs, _ = played(tmp_path / "logs", scripted((Verb.LIFT, numbers[0]), (Verb.FINISH, 0)))
    assert logs.stages["action"].tolist() == ["LIFT", "FINISH"]
    assert logs.stages["reward"].iloc[-1] == -5.0
    assert logs.objects["location"].tolist() == ["TABLE", "TABLE", "LOST", "LOST"]
    assert not np.asarray(states_of(logs, 10).is_on_table)[0, 1].any()


def test_a_label_that_cannot_be_news_changes_nothing():
    seeing = PersistentSeeing(0.3, (0.3, 1.0), (0.5, 0.9), (0.1, 0.2))
    known = Known(np.zeros(3), None, Facts(False, 0.08, 0.05))
    memory = Memory()
    memory.objects, memory.hides = [known], np.zeros((1, 1))
    odds = []
    for glances in ([Glance(0.5, False, True)], [Glance(0.5, False, True), Glance(0.2, False, True)]):
        known.glances = glances
        state = state_of(memory, Belief(WorldConfig(seeing=seeing), no_grip), 10)
        odds.append((float(state.log_odds[0]), float(state.seen[0])))
    assert odds[0] == odds[1] == (pytest.approx(np.log(1.5) + np.log(0.25 / 0.05)), 1.0)


def quits():
    """A rule that finishes at once, as nothing is worth a wash."""
    config = WorldConfig(reward_wash_dirty=-1.0)
    return GreedyPolicy(config), Belief(config, no_grip)


def test_a_campaign_goes_on_where_it_was_killed_and_reads_back_what_is_over(tmp_path):
    campaign = Campaign(*quits(), Conditions(stops=None), 3)
    first = campaign.run(0, tmp_path)
    torn = tmp_path / table_name(0) / RUN_FILE
    assert campaign.run(0, tmp_path) == first
    # Killed before the end: the recording is there, what came of it is not.
    torn.unlink()
    assert campaign.run(0, tmp_path) == first
    logs = logs_of(tmp_path, [0])
    assert logs.stages["action"].tolist() == ["FINISH"]
    assert first.reward == -5.0 * first.num_dirty
    (scene,) = scenes_of(logs)
    assert scene.num_objects <= first.num_cups
    assert scene.hides.max() > 0.0


def test_two_campaigns_into_one_folder_are_refused(tmp_path):
    with (
        working_folder(tmp_path / "logs", "seed 1"),
        pytest.raises(ArgumentError, match="recorder"),
        working_folder(tmp_path / "logs", "seed 1"),
    ):
        pass
    assert not (tmp_path / "logs.running").exists()


def test_what_was_stopped_of_another_run_is_neither_mixed_in_nor_lost(tmp_path):
    def stopped():
        with working_folder(tmp_path / "logs", "seed 1") as folder:
            (folder / "kept").touch()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stopped()
    with pytest.raises(ArgumentError, match=r"seed 1.*this is seed 2"), working_folder(tmp_path / "logs", "seed 2"):
        pass
    with working_folder(tmp_path / "logs", "seed 1") as folder:
        assert (folder / "kept").exists()


@pytest.mark.slow
def test_any_number_of_processes_gives_the_same_bytes(tmp_path):
    campaign = Campaign(LiftAtRandom(), Belief(WorldConfig(horizon=2), no_grip), Conditions(), 5, tells_truth=True)
    tables = {}
    for workers in (Workers(1), Workers(2), Workers(2, "dask")):
        folder = tmp_path / f"{workers.num}-{workers.engine}"
        with workers.ready() as pool:
            runs = [run for _, run in campaign.runs(range(3), folder, pool)]
        tables[workers] = runs, logs_of(folder, range(3)).tables
    for runs, of_tables in tables.values():
        assert runs == tables[Workers(1)][0]
        for name, table in tables[Workers(1)][1].items():
            assert table.equals(of_tables[name])
    runs = tables[Workers(1)][0]
    summary = summarised(runs, logs_of(folder, range(3)), LiftAtRandom(), WorldConfig(horizon=2), 0)
    assert summary.counts["num_cups"] == sum(run.num_cups for run in runs)
    assert summary.verbs["LIFT"] <= 6


def test_a_table_of_which_nothing_is_seen_is_no_path(tmp_path):
    """A camera that is lost before the first look, or that sees none of the cups, stops no campaign."""
    campaign = Campaign(*quits(), Conditions(stops=None), 3)
    campaign.run(0, tmp_path)
    blind = replace(campaign, conditions=Conditions(stops=Stops(camera_lost_per_s=1e6)))
    lost = blind.run(1, tmp_path)
    assert (lost.cause, lost.is_seen, lost.verbs) == ("sensor-lost", False, {})
    logs = logs_of(tmp_path, [0, 1])
    assert logs.path_ids.tolist() == [0]
    with pytest.raises(LogError, match=r"all 1 tables were cut \(sensor-lost\) before anything was decided"):
        logs_of(tmp_path, [1])


@pytest.mark.parametrize("place_m", [(0.0, 5.0, TABLE_TOP_M), (0.0, 0.0, 3.0), (0.6, 0.0, TABLE_TOP_M)])
def test_a_cup_that_is_not_on_the_table_is_refused(place_m):
    table = Table(CUPS, (POSES[0], Pose(place_m)), CAMERA, "table 7")
    with pytest.raises(SceneError, match=r"table 7: the middle of cup 1 is at .* off the table, .*; put it there"):
        Workcell(table, np.random.default_rng(0))


@pytest.mark.parametrize("poses", [(), (Pose((-0.42, -0.28, TABLE_TOP_M)),)], ids=["no cup", "a hidden cup"])
def test_a_table_that_shows_no_cup_is_cut(tmp_path, poses):
    num = len(poses)
    cell = Workcell(Table(CUPS[:num], poses, CAMERA), np.random.default_rng(0))
    with LogRecorder(tmp_path / "logs") as recorder:
        run = play(cell, IS_DIRTY[:num], *quits(), recorder.begin_path(0), random.key_of(0))
    assert (run.cause, run.is_seen, run.num_cups) == (NOTHING_SEEN, False, num)
    assert run.seconds < 1.0


def test_washing_a_clean_cup_costs_ten_and_a_dirty_one_left_five(tmp_path, numbers):
    run, _, _ = played(tmp_path / "logs", scripted((Verb.WASH, numbers[1]), (Verb.FINISH, 0)))
    assert run.reward == -10.0 - 5.0


def test_only_looks_that_show_more_are_news():
    known = Known(np.zeros(3), None, Facts(is_lying=False, width_m=0.08, room_m=0.05))
    for occlusion, says_dirty in ((0.5, False), (0.5 - 0.5 * MORE_IN_VIEW, True), (0.3, False), (0.4, True)):
        known.label(occlusion, says_dirty, is_held=False)
    assert [glance.occlusion for glance in known.glances] == [0.5, 0.3]
    known.label(0.0, True, is_held=True)
    known.label(0.0, False, is_held=False)
    assert [glance.is_held for glance in known.glances] == [False, False, True]
