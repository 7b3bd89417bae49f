"""A team at a table is recorded as it works: the log is that which it would have been given afterwards."""

import numpy as np
import pandas as pd
import pytest

from halfseen.errors import LogError
from halfseen.learning import CensoredQLearner
from halfseen.logs import LogRecorder, read_logs
from halfseen.world import check_log
from halfseen.world.logs import states_of
from picked import assert_same
from played_teams import logged, played, team_of
from refusals import refused

HALF = np.array([[True, True, True, False], [False, True, True, True]])


@pytest.fixture(scope="module")
def logs():
    team = team_of(2, horizon=4, drop_out_rate=(0.08, 0.06), reward_per_s=-0.05)
    return logged(played(team, 12, reach=HALF), 0.4)


def seen_in(logs, row):
    """What was known when a stage began: the columns of what the robots are at, and the objects."""
    seen = {
        name: row[name] for name in logs.stages.columns if "_does" in name or "_since_s" in name or "_to_go" in name
    }
    is_there = (logs.objects["trajectory"] == row["trajectory"]) & (logs.objects["stage"] == row["stage"])
    return seen, logs.objects[is_there].drop(columns=["trajectory", "stage"]).to_dict("records")


def begin(trajectory, logs, row, **change):
    seen, objects = seen_in(logs, row)
    target = None if pd.isna(row["object"]) else row["object"]
    given = {"action": row["action"], "object": target, "probability": row["probability"], "robot": row["robot"]}
    given |= {name: value for name, value in change.items() if name in given}
    seen |= {name: value for name, value in change.items() if name in seen}
    trajectory.begin_stage(seen, change.get("objects", objects), **given)


def record(logs, folder, num_trajectories=None):
    """Live through a log."""
    with LogRecorder(folder, check=check_log) as recorder:
        for end in logs.trajectories.head(num_trajectories).to_dict("records"):
            trajectory = recorder.begin_trajectory(
                end["trajectory"], scene=end["scene"], dirty_share=end["dirty_share"]
            )
            outs = sorted((end[f"{r}_out_s"], r) for r in (0, 1) if not pd.isna(end[f"{r}_out_s"]))
            for row in logs.stages[logs.stages["trajectory"] == end["trajectory"]].to_dict("records"):
                begin(trajectory, logs, row)
                until_s = end["end_s"] if pd.isna(row["elapsed_s"]) else row["elapsed_s"]
                while outs and outs[0][0] <= until_s:
                    out_s, robot = outs.pop(0)
                    trajectory.drop_out(robot, end[f"{robot}_out_cause"], elapsed_s=out_s)
                if not pd.isna(row["elapsed_s"]):
                    own = [row["0_reward"], row["1_reward"]]
                    trajectory.complete_stage(row["reward"], elapsed_s=row["elapsed_s"], own_rewards=own)
            if end["ending"] == "finished":
                trajectory.finish(elapsed_s=end["end_s"])
            else:
                trajectory.cut(end["cause"], elapsed_s=end["end_s"])


@pytest.fixture(scope="module")
def recorded(logs, tmp_path_factory):
    folder = tmp_path_factory.mktemp("team") / "logs"
    record(logs, folder)
    return folder


@pytest.mark.slow
def test_the_log_of_a_team_is_recorded_as_it_was(logs, recorded):
    assert 0 < logs.cut_share < 1
    assert logs.trajectories[["0_out_s", "1_out_s"]].notna().sum().min() > 2
    assert logs.stages["elapsed_s"].eq(0.0).any()
    back = read_logs(recorded)
    for name in ("stages", "trajectories", "objects"):
        there, wanted = getattr(back, name), getattr(logs, name)
        assert set(there.columns) == set(wanted.columns)
        pd.testing.assert_frame_equal(there[wanted.columns], wanted, check_dtype=False)
    assert_same(*(states_of(each, 8) for each in (back, logs)))


@pytest.mark.slow
def test_the_same_is_learned_from_it(logs, recorded):
    ours, theirs = (
        CensoredQLearner.for_team(2, horizon=4, reg=1.0, base=None).fit(each).policy_
        for each in (read_logs(recorded), logs)
    )
    np.testing.assert_array_equal(ours.coefficients, theirs.coefficients)


SECOND = "trajectory 0, stage 2"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"robot": 7}, f"{SECOND}: robot is 7, but the columns are of robots 0 to 1"),
        ({"object": 2}, f"{SECOND}: robot 1 starts on object 2, which robot 0 is acting on by 0_does"),
        ({"0_does": "WASH 9"}, f"{SECOND}: 0_does is 'WASH 9', but no trajectory has more than 4 objects"),
        ({"object": 0}, f"{SECOND}: robot 1 starts on object 0, which reached_by says it cannot reach"),
        ({"objects": "somewhere"}, f"{SECOND}, object 0: location is not one of TABLE, DISHWASHER, LOST"),
        ({"objects": "fewer"}, "trajectory 0, stage 1, object 0: stage 2 no longer lists it"),
    ],
)
def test_what_no_team_learns_from_is_refused_when_it_is_reported(logs, tmp_path, change, message):
    first = logs.stages[(logs.stages["trajectory"] == 0) & (logs.stages["stage"] == 1)].to_dict("records")[0]
    first |= {"action": "WASH", "object": 2, "elapsed_s": 0.0, "robot": 0}
    second = first | {"stage": 1, "robot": 1, "object": 3, "0_does": "WASH 2", "0_decisions_to_go": 3}
    _, objects = seen_in(logs, first)
    others = {
        "somewhere": [each | {"location": "FLOOR"} for each in objects],
        "fewer": [each | {"hidden_by": each["hidden_by"][1:], "near": []} for each in objects[1:]],
    }
    change = {name: others[value] if name == "objects" else value for name, value in change.items()}
    with LogRecorder(tmp_path / "logs", check=check_log) as recorder:
        trajectory = recorder.begin_trajectory(0)
        unreached = [{name: each[name] for name in each if name != "reached_by"} for each in objects]
        with pytest.raises(LogError, match="objects: there is no column 'reached_by'"):
            begin(trajectory, logs, first, objects=unreached)
        begin(trajectory, logs, first)
        trajectory.complete_stage(0.0, elapsed_s=0.0, own_rewards=[0.0, 0.0])
        with refused(message, LogError):
            begin(trajectory, logs, second, **change)
        begin(trajectory, logs, second)
        with pytest.raises(LogError, match=r"column '2_out_s' is of an unknown robot"):
            trajectory.drop_out(2, "battery", elapsed_s=1.0)
        trajectory.complete_stage(0.0, elapsed_s=2.0, own_rewards=[0.0, 0.0])
        trajectory.finish()
    check_log(read_logs(tmp_path / "logs"))
