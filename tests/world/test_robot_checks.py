"""A log that no team can have made is refused in one line that names where."""

import numpy as np
import pytest

from halfseen.errors import LogError
from halfseen.logs import Logs
from halfseen.tables.agent_logs import agent_view
from halfseen.world.logs import states_of
from played_teams import logged, played, team_of


@pytest.fixture(scope="module")
def logs():
    return logged(played(team_of(2), 30), 0.3)


def changed(logs, row, **values):
    stages = logs.stages.copy()
    for name, value in values.items():
        column = stages[name].astype(object)
        column.loc[row] = value
        stages[name] = column.infer_objects()
    return Logs(stages, logs.paths, logs.objects)


READERS = pytest.mark.parametrize(
    "read", [lambda logs: states_of(logs, 10), lambda logs: agent_view(logs, 0)], ids=["states_of", "agent_view"]
)
"""Who reads the states of a team, and who the part of one robot, refuse the same."""


@READERS
def test_what_a_team_made_is_well(logs, read):
    read(logs)


@READERS
@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"0_does": "WASH 1"}, r"path 0, stage 1: 0_does is 'WASH 1', yet robot 0 decides; it decides when it is FREE"),
        ({"0_does": "OUT"}, "0_does is 'OUT', yet robot 0 decides"),
        ({"1_does": "WASH 7"}, "1_does is 'WASH 7', and no path has more than 4 objects, from 0"),
        ({"1_since_s": -1.0}, r"1_since_s is -1.0, below 0"),
        ({"1_decisions_to_go": -1}, "1_decisions_to_go is -1, no count"),
        ({"1_decisions_to_go": 2.5}, "1_decisions_to_go is 2.5, no count"),
        ({"0_decisions_to_go": 0}, "0_decisions_to_go is 0, yet robot 0 decides"),
        ({"action": "WASH", "object": 2, "1_does": "LIFT 2"}, "robot 0 begins with object 2, which robot 1 is at by 1"),
    ],
)
def test_stages_that_no_team_has_are_refused(logs, values, told, read):
    with pytest.raises(LogError, match=told):
        read(changed(logs, 0, **values))


@READERS
@pytest.mark.parametrize("column", ["1_since_s", "1_decisions_to_go"])
def test_text_in_place_of_numbers_is_refused(logs, column, read):
    text = logs.stages.assign(**{column: logs.stages[column].astype(str)})
    with pytest.raises(LogError, match=f"stages: column '{column}' holds string, not numbers; convert it"):
        read(Logs(text, logs.paths, logs.objects))


def test_more_decisions_than_a_path_may_have_are_refused(logs):
    told = "1_decisions_to_go is 1000000000, more than horizon=10 decisions of all robots together; raise horizon"
    with pytest.raises(LogError, match=f"path 0, stage 1: {told}"):
        states_of(changed(logs, 0, **{"1_decisions_to_go": 10**9}), 10)


@READERS
def test_a_drop_out_of_a_robot_that_there_is_none_of_is_refused(logs, read):
    paths = logs.paths.assign(**{"5_out_s": np.nan})
    with pytest.raises(LogError, match=r"paths: column '5_out_s' is of a robot .*; the stages tell of robots 0 to 1: "):
        read(Logs(logs.stages, paths, logs.objects))


@READERS
@pytest.mark.parametrize(
    ("by", "told"),
    [
        ([], r"object \d: attempt_by and attempt_occlusions differ in length; give the robot of each past attempt"),
        ([2], r"object \d: attempt_by names a robot that there is none of; .* robots 0 to 1 .*2"),
    ],
)
def test_attempts_of_nobody_are_refused(logs, by, told, read):
    lists = [np.asarray(each) for each in logs.objects["attempt_by"]]
    row = next(k for k, each in enumerate(lists) if len(each) == 1)
    lists[row] = np.asarray(by, dtype=np.int64)
    with pytest.raises(LogError, match=f"path .*, stage .*, {told}"):
        read(Logs(logs.stages, logs.paths, logs.objects.assign(attempt_by=lists)))


def test_two_robots_at_one_object_are_refused():
    of_three = logged(played(team_of(3), 10), 0.0)
    with pytest.raises(LogError, match="path 0, stage 1: 1_does is 'WASH 1', and 2_does the same object"):
        states_of(changed(of_three, 0, **{"1_does": "WASH 1", "2_does": "LIFT 1"}), 15)


@READERS
@pytest.mark.parametrize(
    ("column", "value", "told"),
    [
        ("reached_by", [0, 2], r"stage 1, object 0: reached_by names a robot that there is none of; .* 0 to 1 .*0, 2"),
        ("reached_by", [0.5], "names a robot that there is none of"),
        ("near", [0, 4], r"object 0: near names an object that the stage has not"),
        ("near", [-1], "names an object that the stage has not"),
    ],
)  # fmt: skip
def test_lists_that_name_what_there_is_not_are_refused(logs, column, value, told, read):
    lists = [np.asarray(each) for each in logs.objects[column]]
    lists[0] = np.asarray(value)
    with pytest.raises(LogError, match=told):
        read(Logs(logs.stages, logs.paths, logs.objects.assign(**{column: lists})))


@READERS
def test_who_acts_beyond_its_reach_is_refused(logs, read):
    nobody = logs.objects.assign(reached_by=[[1]] * len(logs.objects))
    acts = logs.stages[(logs.stages["robot"] == 0) & logs.stages["object"].notna()].iloc[0]
    with pytest.raises(LogError, match=f"robot 0 begins with object {acts['object']}, which it does not reach"):
        read(Logs(logs.stages, logs.paths, nobody))
