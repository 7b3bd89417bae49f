"""Two arms clear a table in physics: cups in their racks, no collision, and a log that a team learns from."""

import numpy as np
import pytest

from halfseen.arrays import record
from halfseen.cell.account import Account
from halfseen.cell.clearing import PAUSE_S
from halfseen.cell.commands import Rest
from halfseen.cell.luck import luck_of_washing
from halfseen.cell.several.pair import PAIR
from halfseen.cell.several.team_episode import TeamRun, play_team
from halfseen.cell.several.team_table import TeamTable
from halfseen.cell.stops import SENSOR_LOST, Stops
from halfseen.cell.table_state import Belief, no_grip
from halfseen.cell.workcell import Attempt, Workcell
from halfseen.learning import CensoredQLearner
from halfseen.logs import LogRecorder, read_logs
from halfseen.planners.heuristics import GreedyPolicy
from halfseen.planners.rules import TeamOfRules
from halfseen.scene.camera import look_at
from halfseen.scene.cups import Cup
from halfseen.scene.poses import Pose
from halfseen.scene.table import TABLE_TOP_M, Table
from halfseen.scene.xtion import xtion_at
from halfseen.tables.agent_logs import agent_view
from halfseen.world import random
from halfseen.world.actions import FINISH, WAIT, ActionSpace, Verb, possible_actions
from halfseen.world.config import WorldConfig
from halfseen.world.logs import states_of
from halfseen.world.policy import Policy, UniformPolicy, surely
from picked import picked

CAMERA = xtion_at(look_at(np.array([0.0, -0.78, 1.24]), np.array([0.0, 0.0, TABLE_TOP_M])))
CONFIG = WorldConfig(horizon=6, dirty_share=0.8)
BELIEF = Belief(CONFIG, no_grip)
TEAM = TeamOfRules(GreedyPolicy(CONFIG, uses_history=True, counts_penalty=True))
TOO_FAR = Attempt(False, 0.0, None, "no grasp is within reach", is_too_far=True)
PLACES_M = ((-0.26, 0.0), (-0.12, 0.12), (0.26, 0.0), (0.12, 0.12))


def workcell(places_m=PLACES_M, seed=0, **options):
    cups = tuple(Cup(0.10, 0.036, 0.032) for _ in places_m)
    poses = tuple(Pose((x_m, y_m, TABLE_TOP_M)) for x_m, y_m in places_m)
    return Workcell(Table(cups, poses, CAMERA), np.random.default_rng(seed), stations=PAIR, **options)


def played(cell, folder, policy: Policy = TEAM, on_decision=lambda _: None):
    is_dirty = np.ones(cell.table.num_cups, dtype=bool)
    with LogRecorder(folder) as recorder:
        path = recorder.begin_path(0)
        return play_team(cell, is_dirty, policy, BELIEF, path, random.key_of(0), on_decision=on_decision)


@pytest.fixture(scope="module")
def cleared(tmp_path_factory):
    folder, cell, moments = tmp_path_factory.mktemp("team") / "log", workcell(), []
    return cell, played(cell, folder, on_decision=moments.append), read_logs(folder), moments


def test_each_arm_fills_its_own_rack_and_none_touches_the_other(cleared):
    cell, run, _, _ = cleared
    assert run.num_racked == run.num_washed == 4
    assert (run.num_collisions, run.num_fallen, run.num_deadlocks) == (0, 0, 0)
    for station in PAIR:
        held = [station.rack.holds(np.array(cell.cell.cup(k).position_m)) for k in range(4)]
        assert sum(held) == 2
    for station in PAIR:
        np.testing.assert_allclose(cell.cell.angles_rad(station.robot), station.robot.home_rad, atol=0.02)


def test_the_log_says_which_arm_decided_and_what_the_other_was_at(cleared):
    _, run, logs, moments = cleared
    stages = logs.stages
    assert stages["robot"].tolist() == [moment.arm for moment in moments]
    assert stages["0_does"].iloc[0] == stages["1_does"].iloc[0] == "FREE"
    assert stages["0_does"].iloc[1] == f"WASH {stages['object'].iloc[0]}"
    assert (np.diff(stages["elapsed_s"]) > 0).all()
    assert stages["elapsed_s"].iloc[-1] == pytest.approx(run.seconds)
    assert stages["reward"].sum() == pytest.approx(run.reward)
    assert run.reward == pytest.approx(4 * CONFIG.reward_wash_dirty)


def test_the_log_gives_back_the_states_that_the_team_decided_in(cleared):
    _, _, logs, moments = cleared
    states = states_of(logs, 2 * CONFIG.horizon)
    for stage, moment in enumerate(moments):
        state = picked(states, (0, stage))
        num_objects = state.num_objects
        np.testing.assert_allclose(state.hides, moment.state.hides[:num_objects, :num_objects], atol=1e-6)
        assert int(state.decider) == moment.arm
        verb = int(ActionSpace(moment.state.num_objects).verb(moment.action))
        target = int(ActionSpace(moment.state.num_objects).target(moment.action))
        actions = ActionSpace(num_objects)
        chosen = 1 + 2 * num_objects if verb == WAIT else int(actions.encode(verb, target)) if verb else 0
        assert bool(possible_actions(state)[chosen])


def test_each_arm_can_learn_from_its_own_part_of_the_log(cleared):
    _, run, logs, _ = cleared
    for arm in (0, 1):
        own = agent_view(logs, arm)
        attempts = own.stages[own.stages["action"] == "WASH"]
        assert attempts["reward"].tolist() == [CONFIG.reward_wash_dirty] * 2
        assert own.is_finished.all()
        assert own.stages["elapsed_s"].iloc[-1] <= run.seconds
        # What the other arm alone reaches is not on its table.
        assert set(own.objects["object"]) < set(logs.objects["object"])
        CensoredQLearner.for_table(CONFIG.horizon, reg=1.0).fit(own)


@record
class Parking:
    """Everyone parks at its first decision, but for arm 0 if it is to lift object 0 before."""

    is_to_lift: bool = False

    def decide(self, state, key):
        actions, is_new = ActionSpace(state.num_objects), state.attempt_object[0] < 0
        is_lift = self.is_to_lift & is_new & (state.decider == 0)
        return surely(np.where(is_lift, actions.encode(Verb.LIFT, 0), FINISH).astype(np.int32))


def test_who_parks_has_left_what_is_dirty_in_its_own_reach(tmp_path):
    """Two cups for the left arm alone, one that both reach, one for the right arm alone."""
    cell = workcell(((-0.30, 0.0), (-0.30, 0.15), (0.0, 0.1), (0.30, 0.0)))
    run = played(cell, tmp_path / "log", Parking())
    logs, left = read_logs(tmp_path / "log"), float(CONFIG.reward_dirty_left)
    stages = logs.stages
    assert stages["action"].tolist() == ["FINISH", "FINISH"]
    assert run.reward == stages["reward"].sum() == 4 * left
    assert stages["0_reward"].sum() == 3 * left
    assert stages["1_reward"].sum() == 2 * left
    assert [agent_view(logs, arm).stages["reward"].tolist() for arm in (0, 1)] == [[3 * left], [2 * left]]


def test_reward_and_luck_are_booked_together_when_a_stage_is_completed(monkeypatch):
    cell = workcell(((-0.26, 0.0), (0.26, 0.0)))
    account = Account(TeamRun(), cell, np.ones(2, dtype=bool), CONFIG)
    account.end(Attempt(False, 1.0, "rim", "the hand closed on nothing"), Verb.WASH, 0.5, 1.0, 0)
    assert (account.run.reward, account.run.luck) == (0.0, 0.0)
    monkeypatch.setattr(account.truth, "newly_racked", lambda *_: [True])
    account.end(Attempt(True, 1.0, "rim"), Verb.WASH, 0.5, 1.0, 1)
    assert (account.run.reward, account.run.luck) == (0.0, 0.0)
    paid = account.pay(is_over=False)
    assert paid == (CONFIG.reward_wash_failed + CONFIG.reward_wash_dirty, [-1.0, 5.0])
    assert account.run.reward == paid.reward
    assert account.run.luck == pytest.approx(luck_of_washing([True], 0.5, CONFIG))
    assert account.pay(is_over=False) == (0.0, [0.0, 0.0])


def test_an_arm_that_found_nothing_in_reach_is_asked_again_when_the_other_has_been_there(tmp_path, monkeypatch):
    washing, cell = Workcell.washing, workcell(((-0.02, 0.0), (0.30, 0.0)))

    def too_far_for_the_left(cell, number, arm):
        if arm == 0:
            yield Rest(0.1)
            return TOO_FAR
        return (yield from washing(cell, number, arm))

    monkeypatch.setattr(Workcell, "washing", too_far_for_the_left)
    played(cell, tmp_path / "log")
    logs = read_logs(tmp_path / "log")
    middle = logs.stages["object"].iloc[0]
    assert logs.stages["1_does"].tolist() == ["FREE", "FREE", "WASH 0" if middle else "WASH 1", "FREE"]
    reached_by = logs.objects[logs.objects["object"] == middle]["reached_by"]
    # Its try has ended by the third decision, the wash of the other arm by the fourth.
    assert [list(each) for each in reached_by] == [[0, 1], [0, 1], [1], [0, 1]]


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bits(cleared, tmp_path):
    cell, run, _, _ = cleared
    again = workcell()
    assert played(again, tmp_path / "log") == run
    np.testing.assert_array_equal(again.cell.data.qpos, cell.cell.data.qpos)


@pytest.mark.slow
def test_arms_that_do_anything_at_all_do_not_collide(tmp_path):
    run = played(workcell(seed=3), tmp_path / "log", UniformPolicy())
    assert {"WASH", "LIFT"} & set(run.verbs)
    assert run.num_collisions == 0
    assert run.cause is None


def test_what_cuts_a_cell_cuts_the_table_of_a_team(tmp_path):
    cell = workcell(stops=Stops(1e9, 1e9, camera_lost_per_s=0.2))
    run = played(cell, tmp_path / "log")
    assert run.cause == SENSOR_LOST
    assert read_logs(tmp_path / "log").summary().num_cut == 1


def test_places_tell_who_reaches_an_object_and_which_are_too_near():
    cell = workcell(((-0.30, 0.0), (-0.02, 0.0), (0.30, 0.0), (0.24, 0.09)))
    cell.look()
    table = TeamTable(cell, BELIEF)
    middles_m = np.array([known.middle_m for known in cell.memory.objects])
    left, middle, right, beside = (
        int(np.linalg.norm(middles_m[:, :2] - place, axis=1).argmin())
        for place in ((-0.30, 0.0), (-0.02, 0.0), (0.30, 0.0), (0.24, 0.09))
    )
    reached, near = table.is_in_reach(), table.is_near()
    assert reached[:, left].tolist() == [True, False]
    assert reached[:, middle].tolist() == [True, True]
    assert reached[:, right].tolist() == [False, True]
    assert near[right, beside]
    assert near[beside, right]
    assert not near[left, middle]
    assert near.diagonal().all()
    # What an arm found to be too far it does not reach, as long as that stays there.
    table.learn(0, middle, TOO_FAR)
    assert table.is_in_reach()[:, middle].tolist() == [False, True]
    cell.memory.objects[middle].middle_m = middles_m[middle] + [0.05, 0.0, 0.0]
    assert table.is_in_reach()[:, middle].tolist() == [True, True]


def test_what_was_too_far_is_tried_again_when_an_arm_has_left_the_table():
    cell = workcell()
    cell.look()
    table = TeamTable(cell, BELIEF)
    usual = table.is_in_reach()
    number = int(np.flatnonzero(usual[0])[0])
    table.learn(0, number, TOO_FAR)
    # Who found nothing in reach never left home: two such arms do not free one another for ever.
    table.learn(1, int(np.flatnonzero(usual[1])[0]), TOO_FAR)
    table.learn(1, number, Attempt(False, 0.0, None, "another arm was in the way of every grasp"))
    assert not table.is_in_reach()[0, number]
    table.learn(1, number, Attempt(True, 5.0, "around"))
    np.testing.assert_array_equal(table.is_in_reach(), usual)


def test_a_lift_costs_an_arm_of_two_what_it_costs_one_that_is_agent_view(tmp_path):
    """Its time until it is home; the look afterwards is nobody's."""
    cell = workcell(((-0.26, 0.0),))
    run = played(cell, tmp_path / "log", Parking(is_to_lift=True))
    stages = read_logs(tmp_path / "log").stages
    assert stages["action"].tolist() == ["LIFT", "FINISH", "FINISH"]
    cost = CONFIG.reward_lift_per_s * (run.busy_s[0] - PAUSE_S)
    # It ends in the stage in which the other arm has decided to park, and is its own share there.
    assert stages["0_reward"].tolist() == pytest.approx([0.0, cost, CONFIG.reward_dirty_left])
    assert stages["1_reward"].tolist() == [0.0, 0.0, 0.0]
