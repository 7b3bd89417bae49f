"""Two arms clear a table in physics: cups in their racks, no collision, and a log that a team learns from."""

from dataclasses import replace

import numpy as np
import pytest
from cells import FULL_CAMERA, two_arm_cell

from halfseen.arrays import record
from halfseen.cell.episode import PAUSE_S, TeamRun, play
from halfseen.cell.fetching import ObservedAttempt
from halfseen.cell.live_cell import SENSOR_LOST, Rest, Stops
from halfseen.cell.memory import Trial
from halfseen.cell.model import PAIR
from halfseen.cell.rewards import EpisodeStatistics, luck_of_washing
from halfseen.cell.table_state import Belief, CellState, no_grip
from halfseen.cell.workcell import Workcell
from halfseen.learning import CensoredQLearner
from halfseen.logs import LogRecorder, read_logs
from halfseen.planners import PLANNER, named_policy
from halfseen.planners.heuristics import GreedyPolicy, TeamOfRules
from halfseen.planners.myopic import MyopicPolicy
from halfseen.tables.agent_logs import agent_view
from halfseen.tables.features import NUM_TEAM_FEATURES
from halfseen.tables.policy import LinearTeamPolicy
from halfseen.world import random
from halfseen.world.actions import FINISH, VERB_NAMES, WAIT, ActionSpace, Verb, possible_actions, wait_of
from halfseen.world.config import WorldConfig
from halfseen.world.logs import states_of
from halfseen.world.policy import Policy, UniformPolicy, surely
from picked import picked

CONFIG = WorldConfig(horizon=6, dirty_share=0.8)
PAIR_CONFIG = replace(CONFIG, speed=(1.0, 1.0))
BELIEF = Belief(CONFIG, no_grip)
TEAM = TeamOfRules(GreedyPolicy(CONFIG, uses_history=True, counts_penalty=True))
TOO_FAR = ObservedAttempt(False, 0.0, None, "no grasp is within reach", is_too_far=True)
PLACES_M = ((-0.26, 0.0), (-0.12, 0.12), (0.26, 0.0), (0.12, 0.12))
THREE_M = ((-0.26, 0.0), (0.26, 0.0), (0.0, 0.1))
LEFT_DIRTY = float(CONFIG.reward_dirty_left)


def played(cell, folder, policy: Policy = TEAM, on_decision=lambda _: None):
    """What came of a table, and its log."""
    is_dirty = np.ones(cell.table.num_cups, dtype=bool)
    with LogRecorder(folder / "log") as recorder:
        trajectory = recorder.begin_trajectory(0)
        run = play(cell, is_dirty, policy, BELIEF, trajectory, random.key_of(0), on_decision=on_decision)
    return run, read_logs(folder / "log")


@pytest.fixture(scope="module")
def cleared(tmp_path_factory):
    cell, moments = two_arm_cell(*PLACES_M), []
    return cell, *played(cell, tmp_path_factory.mktemp("team"), on_decision=moments.append), moments


def test_each_arm_fills_its_own_rack_none_touches_the_other_and_each_can_learn_from_its_own_part(cleared):
    cell, run, logs, _ = cleared
    assert run.num_racked == run.num_washed == 4
    assert (run.num_collisions, run.num_fallen, run.num_deadlocks) == (0, 0, 0)
    for arm, station in enumerate(PAIR):
        assert sum(station.rack.holds(np.array(cell.cell.cup(k).position_m)) for k in range(4)) == 2
        np.testing.assert_allclose(cell.cell.angles_rad(station.robot), station.robot.home_rad, atol=0.02)
        own = agent_view(logs, arm)
        attempts = own.stages[own.stages["action"] == "WASH"]
        assert attempts["reward"].tolist() == [CONFIG.reward_wash_dirty] * 2
        assert own.is_finished.all()
        assert own.stages["elapsed_s"].iloc[-1] <= run.seconds
        # What the other arm alone reaches is not on its table.
        assert set(own.objects["object"]) < set(logs.objects["object"])
        CensoredQLearner.for_table(CONFIG.horizon, reg=1.0).fit(own)


def test_the_log_says_which_arm_decided_what_the_other_was_at_and_in_which_states(cleared):
    _, run, logs, moments = cleared
    stages = logs.stages
    assert stages["robot"].tolist() == [moment.arm for moment in moments]
    assert stages["0_does"].iloc[0] == stages["1_does"].iloc[0] == "FREE"
    assert stages["0_does"].iloc[1] == f"WASH {stages['object'].iloc[0]}"
    elapsed_s = stages["elapsed_s"].to_numpy()
    # Both are free at first: the decision of the one takes no time from the other's.
    assert elapsed_s[0] == pytest.approx(PAUSE_S)
    assert (np.diff(elapsed_s) >= 0).all()
    assert elapsed_s[-1] == pytest.approx(run.seconds)
    assert stages["reward"].sum() == pytest.approx(run.reward)
    assert run.reward == pytest.approx(4 * CONFIG.reward_wash_dirty)
    states = states_of(logs, 2 * CONFIG.horizon)
    for stage, moment in enumerate(moments):
        state, space = picked(states, (0, stage)), ActionSpace(moment.state.num_objects)
        num, verb, target = state.num_objects, int(space.verb(moment.action)), int(space.target(moment.action))
        np.testing.assert_allclose(state.hides, moment.state.hides[:num, :num], atol=1e-6)
        assert int(state.decider) == moment.arm
        chosen = 1 + 2 * num if verb == WAIT else int(ActionSpace(num).encode(verb, target)) if verb else 0
        assert bool(possible_actions(state)[chosen])


@record
class Parking:
    """Everyone parks at its first decision, but for arm 0 if it is to lift object 0 before."""

    is_to_lift: bool = False

    def decide(self, state, key):
        actions, is_new = ActionSpace(state.num_objects), state.attempt_object[0] < 0
        is_lift = self.is_to_lift & is_new & (state.decider == 0)
        return surely(np.where(is_lift, actions.encode(Verb.LIFT, 0), FINISH).astype(np.int32))


@pytest.mark.slow
def test_who_parks_has_left_what_is_dirty_in_its_own_reach(tmp_path):
    """Two cups for the left arm alone, one that both reach, one for the right arm alone."""
    cell = two_arm_cell((-0.30, 0.0), (-0.30, 0.15), (0.0, 0.1), (0.30, 0.0))
    run, logs = played(cell, tmp_path, Parking())
    stages = logs.stages
    assert stages["action"].tolist() == ["FINISH", "FINISH"]
    assert run.reward == stages["reward"].sum() == 4 * LEFT_DIRTY
    shares = [3 * LEFT_DIRTY, 2 * LEFT_DIRTY]
    assert [stages[f"{arm}_reward"].sum() for arm in (0, 1)] == shares
    assert [agent_view(logs, arm).stages["reward"].tolist() for arm in (0, 1)] == [[share] for share in shares]


@pytest.mark.slow
def test_a_lift_costs_an_arm_of_two_what_it_costs_one_that_is_agent_view(tmp_path):
    """Its time until it is home; the look afterwards is nobody's."""
    run, logs = played(two_arm_cell((-0.26, 0.0)), tmp_path, Parking(is_to_lift=True))
    assert logs.stages["action"].tolist() == ["LIFT", "FINISH", "FINISH"]
    cost = CONFIG.reward_lift_per_s * (run.busy_s[0] - PAUSE_S)
    # It ends in the stage in which the other arm has decided to park, and is its own share there.
    assert logs.stages["0_reward"].tolist() == pytest.approx([0.0, cost, LEFT_DIRTY])
    assert logs.stages["1_reward"].tolist() == [0.0, 0.0, 0.0]


def test_reward_and_luck_are_booked_together_when_a_stage_is_completed(monkeypatch):
    account = EpisodeStatistics(TeamRun(), two_arm_cell((-0.26, 0.0), (0.26, 0.0)), np.ones(2, dtype=bool), CONFIG)
    account.end(ObservedAttempt(False, 1.0, "rim", "the hand closed on nothing"), Verb.WASH, 0.5, 1.0, 0)
    assert (account.run.reward, account.run.luck) == (0.0, 0.0)
    monkeypatch.setattr(account.truth, "newly_racked", lambda *_: [True])
    account.end(ObservedAttempt(True, 1.0, "rim"), Verb.WASH, 0.5, 1.0, 1)
    assert (account.run.reward, account.run.luck) == (0.0, 0.0)
    paid = account.pay(is_over=False)
    assert paid == (CONFIG.reward_wash_failed + CONFIG.reward_wash_dirty, [-1.0, 5.0])
    assert account.run.reward == paid[0]
    assert account.run.luck == pytest.approx(luck_of_washing([True], 0.5, CONFIG))
    assert account.pay(is_over=False) == (0.0, [0.0, 0.0])


@pytest.mark.slow
def test_an_arm_that_found_nothing_in_reach_is_asked_again_when_the_other_has_been_there(tmp_path, monkeypatch):
    washing = Workcell.washing

    def too_far_for_the_left(cell, number, arm):
        if arm == 0:
            yield Rest(0.1)
            return TOO_FAR
        return (yield from washing(cell, number, arm))

    monkeypatch.setattr(Workcell, "washing", too_far_for_the_left)
    _, logs = played(two_arm_cell((-0.02, 0.0), (0.30, 0.0)), tmp_path)
    middle = logs.stages["object"].iloc[0]
    assert logs.stages["1_does"].tolist() == ["FREE", "FREE", "WASH 0" if middle else "WASH 1", "FREE"]
    reached_by = logs.objects[logs.objects["object"] == middle]["reached_by"]
    # Its try has ended by the third decision, the wash of the other arm by the fourth.
    assert [list(each) for each in reached_by] == [[0, 1], [0, 1], [1], [0, 1]]


@record
class Passing:
    """Arm 0 lifts object 0 and waits, then takes object 1, which arm 1 has put back; anyone who is left parks."""

    def decide(self, state, key):
        actions, num_tried = ActionSpace(state.num_objects), int((state.attempt_object >= 0).sum())
        is_other_at_it = bool(state.robots.is_busy[1 - int(state.decider)])
        if state.decider == 1:
            action = actions.encode(Verb.LIFT, 1) if num_tried == 0 else FINISH
        elif num_tried == 0 or not is_other_at_it:
            action = actions.encode(Verb.LIFT, min(num_tried, 1))
        else:
            action = wait_of(state.num_objects)
        return surely(np.int32(action))


@pytest.mark.slow
def test_what_one_arm_has_put_back_the_other_takes_at_the_same_clock(tmp_path, monkeypatch):
    def lifting(cell, number, arm):
        yield Rest(0.1 + arm)
        cell.memory.objects[number].trials.append(Trial(0.0, False, 0.1, arm))
        return ObservedAttempt(False, 0.1, "rim", "the hand closed on nothing")

    monkeypatch.setattr(Workcell, "lifting", lifting)
    _, logs = played(two_arm_cell((-0.05, 0.0), (0.05, 0.15)), tmp_path, Passing())
    stages = logs.stages
    assert stages["action"].tolist()[:5] == ["LIFT", "LIFT", "WAIT", "LIFT", "FINISH"]
    assert stages["robot"].tolist()[:5] == [0, 1, 0, 0, 1]
    assert stages["object"].iloc[1] == stages["object"].iloc[3] == 1
    assert stages["elapsed_s"].iloc[2] == stages["elapsed_s"].iloc[3]


@pytest.mark.slow
def test_what_cuts_a_cell_cuts_the_table_of_a_team(tmp_path):
    run, logs = played(two_arm_cell(*PLACES_M, stops=Stops(1e9, 1e9, camera_lost_per_s=0.2)), tmp_path)
    assert run.cause == SENSOR_LOST
    assert logs.summary().num_cut == 1


def test_places_tell_who_reaches_an_object_and_which_are_too_near_and_trying_tells_more():
    places = (-0.30, 0.0), (-0.02, 0.0), (0.30, 0.0), (0.24, 0.09)
    cell = two_arm_cell(*places)
    cell.look()
    table, known = CellState(cell, BELIEF), cell.memory.objects
    middles_m = np.array([each.middle_m for each in known])
    left, middle, right, beside = (int(np.linalg.norm(middles_m[:, :2] - at, axis=1).argmin()) for at in places)
    usual, near = table.is_in_reach(), table.is_near()
    assert usual[:, [left, middle, right]].T.tolist() == [[True, False], [True, True], [False, True]]
    assert near[right, beside]
    assert near[beside, right]
    assert not near[left, middle]
    assert near.diagonal().all()
    # What an arm found to be too far it does not reach, as long as that stays there.
    table.learn(0, middle, TOO_FAR)
    assert table.is_in_reach()[:, middle].tolist() == [False, True]
    known[middle].middle_m = middles_m[middle] + [0.05, 0.0, 0.0]
    assert table.is_in_reach()[:, middle].tolist() == [True, True]
    known[middle].middle_m = middles_m[middle]
    # It is tried again when an arm has left the table. Who found nothing in reach never left home: two such arms do not
    # free one another for ever.
    table.learn(1, right, TOO_FAR)
    table.learn(1, middle, ObservedAttempt(False, 0.0, None, "another arm was in the way of every grasp"))
    assert not table.is_in_reach()[0, middle]
    table.learn(1, middle, ObservedAttempt(True, 5.0, "around"))
    np.testing.assert_array_equal(table.is_in_reach(), usual)


@pytest.mark.slow
def test_the_same_seed_gives_the_same_bits(cleared, tmp_path):
    cell, run, _, _ = cleared
    again = two_arm_cell(*PLACES_M)
    assert played(again, tmp_path)[0] == run
    np.testing.assert_array_equal(again.cell.data.qpos, cell.cell.data.qpos)


@pytest.mark.slow
def test_arms_that_do_anything_at_all_do_not_collide(tmp_path):
    run, _ = played(two_arm_cell(*PLACES_M, seed=3, camera=FULL_CAMERA), tmp_path, UniformPolicy())
    assert {"WASH", "LIFT"} & set(run.verbs)
    assert (run.num_collisions, run.cause) == (0, None)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["learned", "one step ahead"])
def test_in_the_cell_a_team_does_what_it_would_do_in_the_states_of_its_log(tmp_path, kind):
    # A learned policy, as far as anybody can tell who does not know what it learned.
    shape = (PAIR_CONFIG.num_stages, 1, NUM_TEAM_FEATURES + 1)
    any_policy = LinearTeamPolicy(np.random.default_rng(1).normal(size=shape).astype(np.float32), num_robots=2)
    policy = any_policy if kind == "learned" else MyopicPolicy(PAIR_CONFIG)
    _, logs = played(two_arm_cell(*THREE_M, camera=FULL_CAMERA), tmp_path, policy)
    assert len(logs.stages) >= 4
    states = states_of(logs, PAIR_CONFIG.num_stages)
    for step, (action, target) in enumerate(zip(logs.stages["action"], logs.stages["object"], strict=True)):
        # It draws what it drew in the cell.
        state = picked(states, (0, step))
        actions = ActionSpace(state.num_objects)
        decided = int(policy.decide(state, random.fold_in(random.key_of(0), step)).action)
        verb = int(actions.verb(decided))
        assert VERB_NAMES[verb] == action
        assert verb not in (1, 2) or int(actions.target(decided)) == target


@pytest.mark.slow
def test_the_planner_of_a_team_clears_the_table(tmp_path):
    run, _ = played(two_arm_cell(*THREE_M), tmp_path, named_policy(PLANNER, PAIR_CONFIG))
    assert (run.num_washed, run.num_collisions, run.cause) == (3, 0, None)
