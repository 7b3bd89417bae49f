"""What one robot of a team did is a log of one robot, from which the ordinary learner learns."""

import numpy as np
import pandas as pd
import pytest

from halfseen.errors import ArgumentError, LogError
from halfseen.learning import CensoredQLearner
from halfseen.logs import Logs
from halfseen.tables import agent_view, attempts
from halfseen.tables.agent_logs import SPENT
from halfseen.world import WorldConfig
from played_teams import SureGrasping, logged, played, team_of

HALF = np.array([[True, True, True, False], [False, True, True, True]])


def test_of_one_robot_it_is_the_log_itself():
    logs = logged(played(team_of(1, reward_per_s=-0.1), 60), 0.5)
    own = agent_view(logs, 0)
    names = ["trajectory", "stage", "elapsed_s", "action", "object", "probability"]
    pd.testing.assert_frame_equal(own.stages[names], logs.stages[names], rtol=1e-12)
    np.testing.assert_allclose(own.stages["reward"], logs.stages["reward"], rtol=1e-5, atol=1e-6)
    pd.testing.assert_frame_equal(own.trajectories, logs.trajectories)
    pd.testing.assert_frame_equal(own.objects, logs.objects[own.objects.columns])


@pytest.fixture(scope="module")
def team_logs():
    team = team_of(2, horizon=5, drop_out_rate=(0.02, 0.005), reward_per_s=-0.05)
    return logged(played(team, 150, reach=HALF), 0.4)


@pytest.fixture(scope="module", params=[0, 1])
def viewed(request, team_logs):
    return request.param, agent_view(team_logs, request.param)


@pytest.mark.slow
def test_its_stages_are_its_decisions_but_for_waits(team_logs, viewed):
    robot, own = viewed
    mine = team_logs.stages[team_logs.stages["robot"] == robot]
    for trajectory, stages in own.stages.groupby("trajectory"):
        did = mine[(mine["trajectory"] == trajectory) & ~mine["action"].isin(["WAIT", "FINISH"])]["object"].tolist()
        own_did = stages[stages["action"].isin(["WASH", "LIFT"])]["object"].tolist()
        assert own_did == did[: len(own_did)]
        assert len(did) - len(own_did) in (0, 1)
    assert set(own.stages["action"].dropna()) == {"WASH", "LIFT", "FINISH"}
    assert not {"robot", "0_does", "0_reward"} & set(own.stages.columns)


def test_its_attempts_take_what_an_attempt_takes_however_long_it_waited(viewed):
    found = attempts(viewed[1], 5)
    finished = found[found["is_finished"]]
    assert len(finished) > 100
    assert finished["time_s"].min() > 1.0 - 1e-4
    assert finished["time_s"].max() < 7.0 + 1e-4
    # One that failed took the limit, one that succeeded less.
    failed = ~finished["succeeded"].astype(bool)
    np.testing.assert_allclose(finished["time_s"][failed], 7.0, rtol=1e-4)


def test_it_ends_where_the_robot_does_and_the_ordinary_learner_learns_from_it(team_logs, viewed):
    robot, own = viewed
    ends = own.trajectories.merge(team_logs.trajectories, on="trajectory", suffixes=("", "_team"))
    is_out = ends[f"{robot}_out_s"].notna()
    assert is_out.sum() > 3
    assert (ends["cause"][is_out] == "battery").mean() > 0.5
    assert ends["cause"][~is_out].dropna().isin(["operator", SPENT]).all()
    assert not ends["cause"][ends["ending_team"] == "finished"].eq("operator").any()
    assert (ends["end_s"] <= ends["end_s_team"] + 1e-6).all()
    assert 0.2 < (ends["ending"] == "finished").mean() < 0.9
    reached = np.flatnonzero(HALF[robot]).tolist()
    assert sorted(own.objects["object"].unique()) == reached
    assert own.objects["hidden_by"].map(len).eq(len(reached)).all()
    assert np.isfinite(CensoredQLearner.for_table(horizon=5, reg=1.0).fit(own).policy_.coefficients).all()


def test_a_last_attempt_that_waiting_made_the_last_is_cut_whoever_goes_home_meanwhile():
    logs = logged(played(team_of(2, horizon=3), 200), 0.0)
    for robot in (0, 1):
        own = agent_view(logs, robot)
        assert own.trajectories["cause"].eq(SPENT).sum() > 10
        tried = attempts(own, 3).merge(own.trajectories[own.trajectories["cause"].eq(SPENT)], on="trajectory")
        assert not tried.groupby("trajectory").tail(1)["is_finished"].any()


def one_by_one(rows, end, **trajectories):
    """A log of two robots and two objects that are surely grasped, written by hand."""
    names = ["robot", "action", "object", "elapsed_s", "reward", "0_reward", "1_reward", "0_does", "1_does"]
    stages = pd.DataFrame(rows, columns=names)
    stages["object"] = stages["object"].astype("Int64")
    spent = [np.cumsum(stages["robot"] == r) - (stages["robot"] == r) for r in (0, 1)]
    stages = stages.assign(trajectory=0, stage=np.arange(1, len(stages) + 1))
    stages = stages.assign(**{f"{r}_since_s": 0.0 for r in (0, 1)})
    stages = stages.assign(**{f"{r}_decisions_to_go": 5 - spent[r] for r in (0, 1)})
    objects = []
    for stage, i in np.ndindex(len(rows), 2):
        is_washed = i == 0 and stage >= 2
        objects.append(
            {
                "trajectory": 0, "stage": stage + 1, "object": i, "location": "DISHWASHER" if is_washed else "TABLE",
                "occlusion": 0.0, "log_odds": 0.0, "lifts": 0, "successes": int(is_washed), "failures": 0,
                "hidden_by": [0.0, 0.0], "attempt_occlusions": [0.0] * is_washed,
                "attempt_succeeded": [True] * is_washed, "reached_by": [0, 1], "near": [i],
            }
        )  # fmt: skip
    ending = {"trajectory": [0], **{name: [value] for name, value in {**end, **trajectories}.items()}}
    return Logs(stages, pd.DataFrame(ending), pd.DataFrame(objects))


ROWS = [
    (0, "WASH", 0, 0.0, 0.0, 0.0, 0.0, "FREE", "FREE"),
    (1, "WASH", 1, 2.0, 5.0, 5.0, 0.0, "WASH 0", "FREE"),
    (0, "WAIT", None, 3.0, -0.0, 0.0, 0.0, "FREE", "WASH 1"),
    (0, "WASH", 1, 7.0, 5.0, 5.0, 0.0, "FREE", "OUT"),
]


def test_by_hand_the_clock_stands_while_it_waits_and_who_drops_out_is_cut():
    end = {"end_s": 7.0, "ending": "finished", "cause": None, "0_out_s": np.nan, "0_out_cause": None}
    logs = one_by_one(ROWS, end, **{"1_out_s": 3.0, "1_out_cause": "e-stop"})
    left, right = agent_view(logs, 0), agent_view(logs, 1)
    assert left.stages[["action", "object", "elapsed_s", "reward"]].values.tolist() == [
        ["WASH", 0, 2.0, 5.0],
        ["WASH", 1, 6.0, 5.0],
    ]
    assert left.trajectories[["end_s", "ending"]].values.tolist() == [[6.0, "finished"]]
    assert right.stages["action"].tolist() == ["WASH"]
    assert right.stages["elapsed_s"].isna().all()
    assert right.trajectories[["end_s", "ending", "cause"]].values.tolist() == [[3.0, "cut", "e-stop"]]


def test_who_waits_to_the_end_finishes_and_who_is_cut_while_it_waits_is_cut_at_once():
    rows = [*ROWS[:2], (0, "WAIT", None, 6.0, 5.0, 0.0, 5.0, "FREE", "WASH 1")]
    logs = one_by_one(rows, {"end_s": 6.0, "ending": "finished", "cause": None})
    left = agent_view(logs, 0)
    assert left.stages["action"].tolist() == ["WASH", "FINISH"]
    assert left.stages["elapsed_s"].tolist() == [2.0, 6.0]
    rows[2] = (0, "WAIT", None, np.nan, np.nan, np.nan, np.nan, "FREE", "WASH 1")
    cut = agent_view(one_by_one(rows, {"end_s": 5.0, "ending": "cut", "cause": "operator"}), 0)
    assert cut.stages["action"].tolist()[0] == "WASH"
    assert cut.stages["action"].isna().tolist() == [False, True]
    assert cut.trajectories[["end_s", "ending", "cause"]].values.tolist() == [[2.0, "cut", "operator"]]


def test_of_a_simulated_team_who_tried_is_who_began(team_logs, viewed):
    """In the order of the stages, an attempt that was not abandoned ends before the next one at its object begins."""
    robot, own = viewed
    of_older_logs = Logs(team_logs.stages, team_logs.trajectories, team_logs.objects.drop(columns="attempt_by"))
    assert own.objects["attempt_succeeded"].map(len).max() > 1
    assert own.objects["lifts"].max() > 0
    pd.testing.assert_frame_equal(own.objects, agent_view(of_older_logs, robot).objects)


def test_an_attempt_that_never_left_home_is_nobodys():
    """Robot 0 began with object 0 and was told to give way at home, so what failed there is of robot 1."""
    rows = [
        (0, "WASH", 0, 1.0, 0.0, 0.0, 0.0, "FREE", "FREE"),
        (0, "WASH", 1, 1.0, 0.0, 0.0, 0.0, "FREE", "FREE"),
        (1, "WASH", 0, 2.0, -1.0, 0.0, -1.0, "WASH 1", "FREE"),
        (1, "WASH", 0, 3.0, 5.0, 5.0, 0.0, "WASH 1", "FREE"),
        (0, "WASH", 1, 4.0, 5.0, 0.0, 5.0, "FREE", "WASH 0"),
    ]
    plain = one_by_one(rows, {"end_s": 4.0, "ending": "finished", "cause": None})
    at = plain.objects["object"]
    held = [[False] if tried else [] for tried in (plain.objects["stage"] > 3 + at)]
    objects = plain.objects.assign(
        location="TABLE", attempt_succeeded=held, attempt_occlusions=[[0.0] * len(each) for each in held]
    )
    by = [[1 - target] * len(each) for target, each in zip(at, held, strict=True)]
    left, right = (
        agent_view(Logs(plain.stages, plain.trajectories, objects.assign(attempt_by=by)), robot) for robot in (0, 1)
    )

    def failures(own, target):
        return own.objects.loc[own.objects["object"] == target, "failures"].tolist()

    assert "attempt_by" not in left.objects.columns
    assert set(failures(left, 0)) == set(failures(right, 1)) == {0}
    assert failures(left, 1) == [0, 0, 1]
    assert failures(right, 0) == [0, 1]
    # A log that does not say so lays it to who began first.
    assert failures(agent_view(Logs(plain.stages, plain.trajectories, objects), 0), 0) == [0, 0, 1]


def test_what_cannot_be_attributed_is_refused(team_logs):
    with pytest.raises(ArgumentError, match="robot is 7, which decides in no stage"):
        agent_view(team_logs, 7)
    without = Logs(team_logs.stages.drop(columns="0_reward"), team_logs.trajectories, team_logs.objects)
    with pytest.raises(LogError, match="no column '0_reward'"):
        agent_view(without, 0)
    logs = one_by_one(ROWS[:2], {"end_s": 3.0, "ending": "finished", "cause": None})
    logs.objects.at[2, "attempt_occlusions"], logs.objects.at[2, "attempt_succeeded"] = [0.0] * 2, [False] * 2
    with pytest.raises(LogError, match="trajectory 0, stage 2, object 0: it has more attempts than the WASH and LIFT"):
        agent_view(logs, 0)


def test_own_rewards_add_up_to_the_teams_where_reaches_are_apart():
    """With grasps that never fail and reaches that share nothing, each object left is the price of one robot."""
    world = WorldConfig(grasping=SureGrasping(), horizon=5, speed=(1.0, 1.0))
    apart = np.array([[True, True, False, False], [False, False, True, True]])
    logs = logged(played(world, 60, reach=apart), 0.0)
    total = logs.stages[["0_reward", "1_reward"]].sum(axis=1)
    of_trajectories = total.groupby(logs.stages["trajectory"]).sum() - logs.stages.groupby("trajectory")["reward"].sum()
    np.testing.assert_allclose(of_trajectories, 0.0, atol=1e-4)
    for r in (0, 1):
        own = agent_view(logs, r)
        whole = own.trajectories.loc[own.trajectories["ending"] == "finished", "trajectory"]
        assert len(whole) > 50
        paid = own.stages.groupby("trajectory")["reward"].sum()[whole]
        np.testing.assert_allclose(paid, logs.stages.groupby("trajectory")[f"{r}_reward"].sum()[whole], atol=1e-9)


def with_reach(logs, is_reached):
    """The same log, where a robot reaches an object of a stage as `is_reached` of the row has it."""
    reached_by = [
        sorted({robot for robot in each if robot != 0} | ({0} if is_in else set()))
        for each, is_in in zip(logs.objects["reached_by"], is_reached, strict=True)
    ]
    return Logs(logs.stages, logs.trajectories, logs.objects.assign(reached_by=reached_by))


def test_what_it_no_longer_reaches_is_lost_to_it_and_comes_back(team_logs):
    """In a cell an arm may find that it cannot get at something until what stands around it changes."""
    stages, objects = team_logs.stages, team_logs.objects
    begun = set(stages.loc[stages["robot"] == 0, ["trajectory", "stage", "object"]].itertuples(index=False, name=None))
    keys = list(objects[["trajectory", "stage", "object"]].itertuples(index=False, name=None))
    rng = np.random.default_rng(0)
    is_reached = np.array([0 in by for by in objects["reached_by"]])
    is_reached &= np.array([key in begun for key in keys]) | (rng.random(len(keys)) < 0.7)
    own = agent_view(with_reach(team_logs, is_reached), 0)
    now, seen = dict(zip(keys, is_reached.tolist(), strict=True)), set()
    location = dict(zip(keys, objects["location"], strict=True))
    # By plain loops: the stages of the team in which it decided on what is in its log.
    expected = {}
    for trajectory, stage, target in keys:
        if now[trajectory, stage, target]:
            seen.add((trajectory, target))
        if (trajectory, target) in seen:
            is_lost = location[trajectory, stage, target] == "TABLE" and not now[trajectory, stage, target]
            expected[trajectory, stage, target] = "LOST" if is_lost else location[trajectory, stage, target]
    decided = {
        trajectory: rows["stage"].tolist() for trajectory, rows in stages[stages["robot"] == 0].groupby("trajectory")
    }
    waits = set(stages.loc[stages["action"] == "WAIT", ["trajectory", "stage"]].itertuples(index=False, name=None))
    result = {}
    for trajectory, rows in own.objects.groupby("trajectory"):
        of_team = [stage for stage in decided[trajectory] if (trajectory, stage) not in waits]
        own_stages = own.stages.loc[own.stages["trajectory"] == trajectory, "action"]
        if own_stages.isin(["WASH", "LIFT"]).all():
            for row in rows.itertuples():
                result[trajectory, of_team[row.stage - 1], row.object] = row.location
    assert len(result) > 100
    assert result == {key: expected[key] for key in result}
    assert {"LOST", "TABLE", "DISHWASHER"} == set(result.values())
    back = own.objects.groupby(["trajectory", "object"])["location"].agg(list)
    assert any("LOST" in each and "TABLE" in each[each.index("LOST") :] for each in back)
    assert (
        own.objects["hidden_by"]
        .map(len)
        .eq(own.objects.groupby(["trajectory", "stage"])["object"].transform("size"))
        .all()
    )
    CensoredQLearner.for_table(horizon=5, reg=1.0).fit(own)
