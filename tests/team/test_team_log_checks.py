"""A log that no team can have made is refused in one line that names where."""

import numpy as np
import pytest
from played_teams import logged, played, team_of

from halfseen.errors import LogError
from halfseen.logs import Logs
from halfseen.team.log_checks import check_same_robots
from halfseen.team.recording import states_of


@pytest.fixture(scope="module")
def logs():
    return logged(played(team_of(2), 30), 0.3)


def changed(logs, row, **values):
    stages = logs.stages.copy()
    for name, value in values.items():
        stages.loc[row, name] = value
    return Logs(stages, logs.paths, logs.objects)


def test_what_a_team_made_is_well(logs):
    states_of(logs, 10)
    check_same_robots(logs, team_of(2))


@pytest.mark.parametrize(
    ("values", "told"),
    [
        ({"0_does": "WASH 1"}, r"path 0, stage 1: 0_does is 'WASH 1', yet robot 0 decides; it decides when it is FREE"),
        ({"0_does": "OUT"}, "0_does is 'OUT', yet robot 0 decides"),
        ({"1_does": "WASH 7"}, "1_does is 'WASH 7', and no path has more than 4 objects, from 0"),
        ({"1_since_s": -1.0}, r"1_since_s is -1.0, below 0"),
        ({"1_decisions_to_go": -1}, "1_decisions_to_go is -1, no count"),
        ({"0_decisions_to_go": 0}, "0_decisions_to_go is 0, yet robot 0 decides"),
        ({"action": "WASH", "object": 2, "1_does": "LIFT 2"}, "robot 0 begins with object 2, which robot 1 is at by 1"),
    ],
)
def test_stages_that_no_team_has_are_refused(logs, values, told):
    with pytest.raises(LogError, match=told):
        states_of(changed(logs, 0, **values), 10)


def test_two_robots_at_one_object_are_refused():
    of_three = logged(played(team_of(3), 10), 0.0)
    with pytest.raises(LogError, match="path 0, stage 1: 1_does is 'WASH 1', and 2_does the same object"):
        states_of(changed(of_three, 0, **{"1_does": "WASH 1", "2_does": "LIFT 1"}), 15)


@pytest.mark.parametrize(
    ("column", "value", "told"),
    [
        ("reached_by", [0, 2], r"stage 1, object 0: reached_by is .*, names a robot that there is none of; .* 0 to 1"),
        ("reached_by", [0.5], "names a robot that there is none of"),
        ("near", [0, 4], r"object 0: near is .*, names an object that the stage has not"),
        ("near", [-1], "names an object that the stage has not"),
    ],
)  # fmt: skip
def test_lists_that_name_what_there_is_not_are_refused(logs, column, value, told):
    lists = [np.asarray(each) for each in logs.objects[column]]
    lists[0] = np.asarray(value)
    with pytest.raises(LogError, match=told):
        states_of(Logs(logs.stages, logs.paths, logs.objects.assign(**{column: lists})), 10)


def test_who_acts_beyond_its_reach_is_refused(logs):
    nobody = logs.objects.assign(reached_by=[[1]] * len(logs.objects))
    acts = logs.stages[(logs.stages["robot"] == 0) & logs.stages["object"].notna()].iloc[0]
    with pytest.raises(LogError, match=f"robot 0 begins with object {acts['object']}, which it does not reach"):
        states_of(Logs(logs.stages, logs.paths, nobody), 10)


def test_a_log_of_another_team_is_refused(logs):
    with pytest.raises(LogError, match="the log tells of 2 robots, 0_does to 1_does, and the team has 3"):
        check_same_robots(logs, team_of(3))
    plain = Logs(logs.stages.drop(columns=["0_does", "1_does"]), logs.paths, logs.objects)
    with pytest.raises(LogError, match="the log tells of 0 robots: it has no column 0_does, and the team has 2"):
        check_same_robots(plain, team_of(2))
