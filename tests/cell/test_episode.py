"""One table in physics: attempts and stops, what is earned and what the log tells, and campaigns of many tables."""

from dataclasses import replace

import numpy as np
import pytest
from cells import CAMERA, TWO_CUPS, TWO_POSES, one_arm_cell, standing

from halfseen.arrays import record
from halfseen.cell.camera import PoseErrors
from halfseen.cell.campaign import RUN_FILE, Campaign, Conditions, LiftAtRandom, logs_of, table_name, working_folder
from halfseen.cell.episode import NOTHING_SEEN, play
from halfseen.cell.facts import Facts
from halfseen.cell.live_cell import Stops
from halfseen.cell.memory import MORE_IN_VIEW, Glance, KnownObject, Memory
from halfseen.cell.summary import scenes_of, summarised
from halfseen.cell.table_state import MOST_OBJECTS, Belief, no_grip, state_of
from halfseen.cell.workcell import Workcell
from halfseen.errors import ArgumentError, LogError, SceneError
from halfseen.logs import LogRecorder, read_logs
from halfseen.planners.heuristics import GreedyPolicy
from halfseen.policies.history import present_state
from halfseen.scene import random_table
from halfseen.scene.cups import Stain, Surface
from halfseen.scene.poses import Pose
from halfseen.scene.table import TABLE_TOP_M, Table
from halfseen.workers import Workers
from halfseen.world import ActionSpace, Scene, Verb, WorldConfig, random
from halfseen.world.logs import states_of
from halfseen.world.policy import surely
from halfseen.world.seeing import PersistentSeeing
from halfseen.world.state import attempt_counts

WHITE, BROWN = (238, 236, 230), (98, 62, 30)
# The first cup has a stain that faces the camera, the second none.
FACING = Stain(-0.5 * np.pi, 0.05, 0.014, False, BROWN)
SURFACES = (Surface(TWO_CUPS[0], WHITE, (FACING,)), Surface(TWO_CUPS[1], WHITE))
IS_DIRTY = np.array([True, False])
CONFIG = WorldConfig()
BELIEF = Belief(CONFIG, no_grip)
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


def played(folder, policy, stops=None):
    cell = one_arm_cell(surfaces=SURFACES, stops=stops)
    with LogRecorder(folder) as recorder:
        trajectory = recorder.begin_trajectory(0, dirty_share=0.6)
        run = play(cell, IS_DIRTY, policy, BELIEF, trajectory, random.key_of(0), tells_truth=True)
    return run, read_logs(folder), cell


@pytest.fixture(scope="module")
def numbers():
    """Which number in a robot's memory is which cup."""
    cell = one_arm_cell(surfaces=SURFACES)
    cell.look()
    middles_m = np.array([known.middle_m for known in cell.memory.objects])
    return [int(np.linalg.norm(middles_m - pose.position_m, axis=1).argmin()) for pose in TWO_POSES]


def test_washing_the_dirty_cup_and_finishing_earns_five_and_the_log_tells_all(tmp_path, numbers):
    dirty, clean = numbers
    run, logs, cell = played(tmp_path / "logs", scripted((Verb.WASH, dirty), (Verb.FINISH, 0)))
    assert run.reward == 5.0
    assert (run.num_racked, run.num_washed, run.num_dirty, run.num_toppled, run.num_fallen) == (1, 1, 1, 0, 0)
    assert run.verbs == {"WASH": 1, "FINISH": 1}
    assert logs.stages["reward"].tolist() == [5.0, 0.0]
    assert logs.is_finished.all()
    assert 10.0 < run.seconds < 40.0
    # The label of the stain that faces the camera was right, and the log says what was said and what was true.
    first = logs.objects[logs.objects["stage"] == 1].sort_values("object")
    assert [list(each) for each in first["glance_dirty"]] == [[number == dirty] for number in range(2)]
    assert first["is_dirty"].tolist() == [number == dirty for number in range(2)]
    assert logs.objects["location"].tolist()[-2:].count("DISHWASHER") == 1
    # Where it was seen last is where it stood, on the table.
    places_m = first[["x_m", "y_m", "z_m"]].to_numpy()
    between_m = np.subtract(TWO_POSES[1].position_m, TWO_POSES[0].position_m)
    apart_m = np.linalg.norm(places_m[clean] - places_m[dirty])
    assert apart_m == pytest.approx(np.linalg.norm(between_m), abs=0.02)
    assert places_m[:, 2] == pytest.approx([0.05, 0.045], abs=0.02)
    # What is in the log is the state that was decided in.
    state, last = state_of(cell.memory, BELIEF, 8), states_of(logs, 10)
    np.testing.assert_allclose(np.asarray(last.log_odds)[0, 1], np.asarray(state.log_odds)[:2], atol=1e-5)
    assert np.asarray(last.is_on_table)[0, 1].tolist() == np.asarray(state.is_on_table)[:2].tolist()


@pytest.mark.slow
def test_a_lift_costs_its_time_and_shows_all_sides_and_a_wash_of_a_clean_cup_costs_ten(tmp_path, numbers):
    dirty, clean = numbers
    run, logs, _ = played(tmp_path / "logs", scripted((Verb.LIFT, dirty), (Verb.WASH, clean), (Verb.FINISH, 0)))
    lift, *others = logs.stages["reward"]
    assert lift == pytest.approx(-0.1 * logs.stages["elapsed_s"].iloc[0], abs=0.06)
    assert others == [-10.0, -5.0]
    assert run.reward == pytest.approx(lift - 10.0 - 5.0)
    after = logs.objects[(logs.objects["stage"] == 2) & (logs.objects["object"] == dirty)].iloc[0]
    assert (after["lifts"], len(after["attempt_s"])) == (1, 1)
    assert (list(after["glance_held"]), list(after["glance_dirty"])) == ([False, True], [True, True])


@pytest.mark.slow
def test_what_stops_a_cell_is_the_cause_of_a_cut_and_its_record_a_history_to_go_on_from(tmp_path, numbers):
    run, logs, _ = played(tmp_path / "logs", scripted((Verb.WASH, numbers[0])), Stops(limit_s=3.0))
    assert run.cause == "time-out"
    assert logs.trajectories["cause"].tolist() == ["time-out"]
    assert logs.stages["reward"].isna().tolist() == [True]
    assert 3.0 < logs.end_s[0] < 5.0
    view = one_arm_cell(seed=1, surfaces=SURFACES).look()
    places_m = np.array([seen.solid.middle_m for seen in view.objects])
    now, turned = (
        present_state(scene, 10, logs, dirty_share=0.6, places_m=seen_m)
        for scene, seen_m in ((view.scene(), places_m), (Scene(view.hides[::-1, ::-1]), places_m[::-1]))
    )
    assert (now.notes, turned.notes, now.stage) == ((), (), 2)
    np.testing.assert_array_equal(now.state.log_odds, turned.state.log_odds[::-1])
    dirty = int(np.argmax(np.asarray(now.state.log_odds)))
    is_tried = np.asarray(attempt_counts(now.state)).sum(axis=0).tolist()
    assert is_tried == [int(number == dirty) for number in range(2)]


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_lift_shows_what_stands_behind_and_the_cup_stands_where_it_was_then_goes_into_the_rack(numbers):
    front, behind = numbers
    cell = one_arm_cell(surfaces=SURFACES)
    assert len(cell.look().objects) == 2
    assert front == int(np.argmin([known.seen.occlusion for known in cell.memory.objects]))
    before, hidden = cell.cell.cup(0).position_m, cell.memory.occlusion(behind)
    assert hidden > 2.0 * MORE_IN_VIEW
    lifted = cell.lift(front)
    assert (lifted.is_held, lifted.kind) == (True, "around")
    assert 4.0 < lifted.duration_s < 12.0
    np.testing.assert_allclose(cell.cell.cup(0).position_m, before, atol=0.01)
    assert cell.memory.objects[behind].glances == [Glance(hidden, False, False), Glance(0.0, False, False)]
    # What hides it is known as before: it stands there again.
    assert cell.memory.occlusion(behind) == hidden
    cell.look()
    assert [cell.memory.objects[number].lifts for number in (front, behind)] == [1, 0]
    assert cell.wash(front).is_held
    assert [cell.rack.holds(np.array(cell.cell.cup(k).position_m)) for k in range(2)] == [True, False]
    # It stays forgotten.
    assert len(cell.look().objects) == 1
    assert cell.memory.objects[behind].seen.occlusion < 0.02
    assert cell.memory.objects[front].is_gone


@pytest.mark.slow
@pytest.mark.parametrize("grasping", ["completed", "visible-only"])
def test_most_attempts_on_a_random_table_hold_and_completed_shapes_no_less(grasping):
    held = []
    cell = Workcell(random_table(60), np.random.default_rng(60), grasping=grasping)
    cell.look()
    for number in range(len(cell.memory.objects)):
        held.append(cell.memory.objects[number].seen is not None and cell.lift(number).is_held)
        cell.look()
    print(f"{grasping}: {np.mean(held):.2f} of {len(held)} held")
    assert np.mean(held) > {"completed": 0.85, "visible-only": 0.6}[grasping]


@pytest.mark.slow
def test_washing_until_nothing_is_left_fills_the_rack():
    table = random_table(70)
    cell = Workcell(table, np.random.default_rng(70), errors=PoseErrors())
    for _ in range(2 * table.num_cups):
        cell.look()
        there = [k for k, known in enumerate(cell.memory.objects) if known.seen is not None]
        if not there:
            break
        cell.wash(min(there, key=lambda k: (len(cell.memory.objects[k].failed), k)))
    num_racked = sum(cell.rack.holds(np.array(cell.cell.cup(k).position_m)) for k in range(table.num_cups))
    print(f"{num_racked} of {table.num_cups} cups in the rack")
    assert num_racked >= 0.9 * table.num_cups


def test_a_label_that_cannot_be_news_changes_nothing_and_only_looks_that_show_more_are_news():
    seeing = PersistentSeeing(0.3, (0.3, 1.0), (0.5, 0.9), (0.1, 0.2))
    known, memory, odds = KnownObject(np.zeros(3), None, Facts(is_lying=False, width_m=0.08, room_m=0.05)), Memory(), []
    memory.objects, memory.hides = [known], np.zeros((1, 1))
    for glances in ([Glance(0.5, False, True)], [Glance(0.5, False, True), Glance(0.2, False, True)]):
        known.glances = glances
        state = state_of(memory, Belief(WorldConfig(seeing=seeing), no_grip), 10)
        odds.append((float(state.log_odds[0]), float(state.seen[0])))
    assert odds[0] == odds[1] == (pytest.approx(np.log(1.5) + np.log(0.25 / 0.05)), 1.0)
    known.glances = []
    for occlusion, says_dirty in ((0.5, False), (0.5 - 0.5 * MORE_IN_VIEW, True), (0.3, False), (0.4, True)):
        known.label(occlusion, says_dirty, is_held=False)
    assert [glance.occlusion for glance in known.glances] == [0.5, 0.3]
    known.label(0.0, True, is_held=True)
    known.label(0.0, False, is_held=False)
    assert [glance.is_held for glance in known.glances] == [False, False, True]


@pytest.mark.parametrize("place_m", [(0.0, 5.0, TABLE_TOP_M), (0.0, 0.0, 3.0), (0.6, 0.0, TABLE_TOP_M)])
def test_a_cup_that_is_not_on_the_table_is_refused(place_m):
    table = Table(TWO_CUPS, (TWO_POSES[0], Pose(place_m)), CAMERA, "table 7")
    with pytest.raises(
        SceneError, match=r"table 7: the middle of cup 1 is at .* off the table, .*; move it onto the table"
    ):
        Workcell(table, np.random.default_rng(0))


# A rule that finishes at once, as nothing is worth a wash.
QUITS = GreedyPolicy(WorldConfig(reward_wash_dirty=-1.0)), Belief(WorldConfig(reward_wash_dirty=-1.0), no_grip)


@pytest.mark.parametrize("poses", [(), standing((-0.42, -0.28))], ids=["no cup", "a hidden cup"])
def test_a_table_that_shows_no_cup_is_cut(tmp_path, poses):
    num = len(poses)
    with LogRecorder(tmp_path / "logs") as recorder:
        trajectory, cell = recorder.begin_trajectory(0), one_arm_cell(cups=TWO_CUPS[:num], poses=poses)
        run = play(cell, IS_DIRTY[:num], *QUITS, trajectory, random.key_of(0))
    assert (run.cause, run.is_seen, run.num_cups) == (NOTHING_SEEN, False, num)
    assert run.seconds < 1.0


@pytest.mark.slow
def test_a_campaign_goes_on_where_it_was_killed_and_reads_back_what_is_over(tmp_path, monkeypatch):
    table = Table(TWO_CUPS, TWO_POSES, CAMERA)
    monkeypatch.setattr("halfseen.cell.campaign.random_table", lambda seed: replace(table, name=f"random_{seed}"))
    campaign = Campaign(*QUITS, Conditions(stops=None), 3)
    first = campaign.run(0, tmp_path)
    assert campaign.run(0, tmp_path) == first
    # Killed before the end: the recording is there, what came of it is not.
    (tmp_path / table_name(0) / RUN_FILE).unlink()
    assert campaign.run(0, tmp_path) == first
    logs = logs_of(tmp_path, [0])
    assert logs.stages["action"].tolist() == ["FINISH"]
    assert first.reward == -5.0 * first.num_dirty
    (scene,) = scenes_of(logs)
    assert scene.num_objects <= first.num_cups
    assert scene.hides.max() > 0.0
    # A camera that is lost before the first look, or that sees none of the cups, stops no campaign.
    blind = replace(campaign, conditions=Conditions(stops=Stops(camera_lost_per_s=1e6)))
    lost = blind.run(1, tmp_path)
    assert (lost.cause, lost.is_seen, lost.verbs) == ("sensor-lost", False, {})
    assert logs_of(tmp_path, [0, 1]).trajectory_ids.tolist() == [0]
    with pytest.raises(LogError, match=r"all 1 tables were cut \(sensor-lost\) before anything was decided"):
        logs_of(tmp_path, [1])


def test_a_folder_is_of_one_campaign_which_loses_nothing_when_it_is_stopped(tmp_path):
    def stopped():
        with working_folder(tmp_path / "logs", "seed 1") as folder:
            (folder / "kept").touch()
            with pytest.raises(ArgumentError, match="recorder"), working_folder(tmp_path / "logs", "seed 1"):
                pass
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stopped()
    with pytest.raises(ArgumentError, match=r"seed 1.*this run is seed 2"), working_folder(tmp_path / "logs", "seed 2"):
        pass
    with working_folder(tmp_path / "logs", "seed 1") as folder:
        assert (folder / "kept").exists()
        (folder / "kept").unlink()
    assert not (tmp_path / "logs.running").exists()


@pytest.mark.slow
def test_any_number_of_processes_gives_the_same_bytes(tmp_path):
    config = WorldConfig(horizon=2)
    campaign = Campaign(LiftAtRandom(), Belief(config, no_grip), Conditions(), 5, tells_truth=True)
    made = []
    for workers in (Workers(1), Workers(2)):
        with workers.ready() as pool:
            runs = [run for _, run in campaign.runs(range(2), tmp_path / str(workers.num), pool)]
        made.append((runs, logs_of(tmp_path / str(workers.num), range(2))))
    (first, logs), (again, logs_again) = made
    assert again == first
    assert all(table.equals(logs_again.tables[name]) for name, table in logs.tables.items())
    found = summarised(first, logs, LiftAtRandom(), config, 0)
    assert found.counts["num_cups"] == sum(run.num_cups for run in first)
    assert found.verbs["LIFT"] <= 4
