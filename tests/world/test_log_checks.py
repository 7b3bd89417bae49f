"""A log that no table, or no team, can have made is refused in one line that names where."""

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest

from fitted_laws import FITTED
from halfseen.errors import HalfseenWarning, LogError
from halfseen.logs import Logs
from halfseen.tables import agent_view, attempts
from halfseen.tables.present import logged_dirty_share
from halfseen.world import TableWorld, UniformPolicy
from halfseen.world.log_checks import check_log, checked_tables
from halfseen.world.logs import states_of
from played_teams import logged, played, team_of
from refusals import refused
from small_logs import table_log
from world.world_cases import FITTED_SCENES


@pytest.fixture(scope="module")
def alone():
    return TableWorld(FITTED).simulate(FITTED_SCENES, UniformPolicy(), episodes=30, seed=1)


@pytest.fixture(scope="module")
def team():
    return logged(played(team_of(2), 30), 0.3)


@pytest.fixture(scope="module")
def frail():
    return logged(played(team_of(3, drop_out_rate=(0.03, 0.01, 0.0)), 30), 0.3)


def changed(logs, table="stages", row=0, **values):
    """The log with other values in one row of a table."""
    tables = {name: frame.copy() for name, frame in logs.tables.items()}
    for name, value in values.items():
        column = tables[table][name].tolist()
        column[row] = value
        if np.ndim(value) == 0:
            column = type(logs.tables[table][name])(column, dtype=object).infer_objects()
        tables[table][name] = column
    return Logs(tables["stages"], tables["trajectories"], tables["objects"])


def refuses(message, read, logs):
    with refused(message, LogError):
        read(logs)


@pytest.mark.parametrize(
    ("column", "value", "message"),
    [
        ("location", "SINK", "location is not one of"),
        ("hidden_by", [0.0] * 9, "hidden_by does not give one share"),
        ("attempt_occlusions", [0.5], "attempt_occlusions and attempt_succeeded differ"),
        ("seen", 1.5, r"seen is outside \[0, 1\]; give a share"),
        ("seen", -0.1, "seen is outside"),
        ("seen", np.nan, "covariate seen"),
        ("grip", np.nan, "covariate grip"),
        ("grip", np.inf, "covariate grip"),
    ],
)
def test_a_broken_object_is_named(alone, column, value, message):
    place = "trajectory 0, stage 1, object 0: "
    refuses(place + message, lambda logs: states_of(changed(logs, "objects", **{column: value}), 10), alone)


def test_hidden_shares_of_whom_an_object_hides_are_reported_from_those_of_who_hides_it(alone):
    """One object cannot hide more than all together, as a transposed list says."""
    checked_tables(alone)
    stacked = [np.stack(each.to_list()).T for _, each in alone.objects.groupby(["trajectory", "stage"])["hidden_by"]]
    swapped = alone.objects.assign(hidden_by=[row.tolist() for each in stacked for row in each])
    with pytest.warns(
        HalfseenWarning, match=r"^trajectory \d+, stage \d+, object \d+: one object alone hides .* transpose"
    ):
        checked_tables(Logs(alone.stages, alone.trajectories, swapped))


def test_an_object_that_vanishes_is_named(alone):
    stages, objects = alone.stages, alone.objects
    trajectory = int(stages.loc[(stages["stage"] == 2) & (stages["trajectory"] % 2 == 0), "trajectory"].iloc[0])
    acted = stages.loc[(stages["trajectory"] == trajectory) & (stages["stage"] == 2), "object"].fillna(-1).iloc[0]
    gone = next(k for k in range(3) if k != acted)
    kept = ~((objects["trajectory"] == trajectory) & (objects["stage"] == 2) & (objects["object"] == gone))
    message = f"trajectory {trajectory}, stage 1, object {gone}: stage 2 no longer lists it"
    refuses(message, lambda logs: states_of(logs, 10), Logs(stages, alone.trajectories, objects[kept]))


def test_a_log_without_objects_or_with_too_many_stages_is_refused(alone):
    nothing = Logs(alone.stages.drop(columns="object"), alone.trajectories)
    fewer = Logs(alone.stages, alone.trajectories, alone.objects.drop(columns="lifts"))
    refuses("the log has no objects table", lambda logs: states_of(logs, 10), nothing)
    refuses("there is no column 'lifts' among", lambda logs: states_of(logs, 10), fewer)
    refuses("more than horizon=2", lambda logs: states_of(logs, 2), alone)


READERS = pytest.mark.parametrize(
    "read", [lambda logs: states_of(logs, 10), lambda logs: agent_view(logs, 0)], ids=["states_of", "agent_view"]
)
"""Who reads the states of a team, and who the part of one robot, refuse the same."""


@READERS
@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"robot": 7}, r"trajectory 0, stage 1: robot is 7, but the columns are of robots 0 to 1"),
        ({"1_does": "WASH"}, r"stage 1: 1_does is 'WASH'; give one of FREE, PARKED"),
        ({"1_does": "DANCE 1"}, r"1_does is 'DANCE 1'"),
        (
            {"0_does": "WASH 1"},
            r"trajectory 0, stage 1: 0_does is 'WASH 1', yet robot 0 decides; a robot decides only when it is FREE",
        ),
        ({"0_does": "OUT"}, "0_does is 'OUT', yet robot 0 decides"),
        ({"1_does": "WASH 7"}, "1_does is 'WASH 7', but no trajectory has more than 4 objects, counted from 0"),
        ({"1_since_s": -1.0}, r"1_since_s is -1.0, below 0"),
        ({"1_decisions_to_go": -1}, "1_decisions_to_go is -1, not a count"),
        ({"1_decisions_to_go": 2.5}, "1_decisions_to_go is 2.5, not a count"),
        ({"0_decisions_to_go": 0}, "0_decisions_to_go is 0, yet robot 0 decides"),
        (
            {"action": "WASH", "object": 2, "1_does": "LIFT 2"},
            "robot 0 starts on object 2, which robot 1 is acting on by 1",
        ),
    ],
)
def test_stages_that_no_team_has_are_refused(team, values, message, read):
    read(team)
    refuses(message, read, changed(team, **values))


@READERS
@pytest.mark.parametrize("column", ["1_since_s", "1_decisions_to_go"])
def test_text_in_place_of_numbers_is_refused(team, column, read):
    text = Logs(team.stages.assign(**{column: team.stages[column].astype(str)}), team.trajectories, team.objects)
    refuses(f"stages: column '{column}' holds string, not numbers; convert it", read, text)


def test_more_decisions_than_a_trajectory_may_have_are_refused(team):
    message = "1_decisions_to_go is 1000000000, more than horizon=10 decisions of all robots together; raise horizon"
    many = changed(team, **{"1_decisions_to_go": 10**9})
    refuses(f"trajectory 0, stage 1: {message}", lambda logs: states_of(logs, 10), many)


def test_clocks_counts_and_places_that_contradict_each_other_are_refused(team):
    """An action is not older than its trajectory (milliseconds), decisions count down, and an object is near itself."""
    stages, objects = team.stages, team.objects
    others = {
        "0_since_s is .*, longer than the trajectory by then": ({"0_since_s": stages["0_since_s"] * 1000.0}, {}),
        "1_decisions_to_go is 9, no less than at its decision before": ({"1_decisions_to_go": 9}, {}),
        "near lacks the object itself": ({}, {"near": [np.zeros(0, dtype=np.int64)] * len(objects)}),
    }
    for message, (of_stages, of_objects) in others.items():
        refuses(message, check_log, Logs(stages.assign(**of_stages), team.trajectories, objects.assign(**of_objects)))


def test_two_robots_at_one_object_are_refused(frail):
    both = changed(frail, **{"1_does": "WASH 1", "2_does": "LIFT 1"})
    refuses(
        "trajectory 0, stage 1: 1_does is 'WASH 1', and 2_does names the same object",
        lambda logs: states_of(logs, 15),
        both,
    )


@pytest.mark.slow
@READERS
@pytest.mark.parametrize(
    ("column", "value", "message"),
    [
        ("reached_by", [0, 2], r"object 0: reached_by names an unknown robot; .* 0 to 1 \(it is .*0, 2"),
        ("reached_by", [0.5], "names an unknown robot"),
        ("near", [0, 4], r"object 0: near names an object that the stage lacks"),
        ("near", [-1], "names an object that the stage lacks"),
        ("attempt_by", [], r"object \d: attempt_by and attempt_occlusions differ in length; give the robot of each"),
        ("attempt_by", [2], r"object \d: attempt_by names an unknown robot; .* robots 0 to 1 .*2"),
    ],
)  # fmt: skip
def test_lists_that_name_what_there_is_not_are_refused(team, column, value, message, read):
    lengths = team.objects["attempt_by"].map(len).tolist()
    row = lengths.index(1) if column == "attempt_by" else 0
    refuses(message, read, changed(team, "objects", row, **{column: np.asarray(value, dtype=type((*value, 0)[0]))}))


@READERS
def test_who_acts_beyond_its_reach_is_refused(team, read):
    acts = team.stages[(team.stages["robot"] == 0) & team.stages["object"].notna()].iloc[0]
    nobody = Logs(team.stages, team.trajectories, team.objects.assign(reached_by=[[1]] * len(team.objects)))
    refuses(f"robot 0 starts on object {acts['object']}, which reached_by says it cannot reach", read, nobody)


@READERS
def test_a_drop_out_of_a_robot_that_there_is_none_of_is_refused(team, read):
    message = r"trajectories: column '5_out_s' is of an unknown robot; the stages have robots 0 to 1: "
    refuses(message, read, Logs(team.stages, team.trajectories.assign(**{"5_out_s": np.nan}), team.objects))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"0_out_s": lambda trajectories: trajectories["end_s"] + 1.0},
            r"trajectory 0: 0_out_s [\d.]+ lies outside the trajectory",
        ),
        ({"0_out_s": -1.0}, r"trajectory 0: 0_out_s -1.0 lies outside the trajectory"),
        ({"0_out_s": np.inf}, r"trajectory 0: 0_out_s inf lies outside the trajectory"),
        ({"2_out_cause": "battery"}, r"trajectory 0: 2_out_cause is given, yet 2_out_s is not"),
        ({"0_out_s": 1e-3}, r"robot 0 decides at [\d.]+ s, yet dropped out at 0.001 s"),
    ],
)
def test_a_drop_out_that_cannot_be_is_refused(frail, change, message):
    refuses(message, lambda logs: Logs(logs.stages, logs.trajectories.assign(**change), logs.objects), frail)


def test_what_a_robot_brought_is_a_number_where_the_stage_was_completed(frail):
    nothing = frail.stages.assign(**{"1_reward": np.nan})
    message = r"trajectory 0, stage 1: 1_reward is null; give a finite number for each completed"
    refuses(message, lambda logs: Logs(nothing, logs.trajectories, logs.objects), frail)
    assert "1_reward" not in frail.stage_covariates
    assert "1_since_s" in frail.stage_covariates


AS_OTHER = {
    "bytes": lambda values: pa.array([str(each).encode() for each in values]),
    "text": lambda values: pa.array([str(each) for each in values]),
    "large_string": lambda values: pa.array([str(each) for each in values], pa.large_string()),
    "dictionary": lambda values: pa.array([str(each) for each in values]).dictionary_encode(),
    "list": lambda values: pa.array([[0]] * len(values)),
    "struct": lambda values: pa.array([{"a": 0}] * len(values)),
    "bool": lambda values: pa.array([False] * len(values)),
    "timestamp": lambda values: pa.array([0] * len(values), pa.timestamp("us")),
    "duration": lambda values: pa.array([0] * len(values), pa.duration("us")),
}


@pytest.mark.parametrize("kind", list(AS_OTHER))
@pytest.mark.parametrize("column", ["occlusion", "log_odds", "lifts", "successes", "failures"])
def test_numbers_of_objects_are_numbers(kind, column):
    logs = table_log(num_trajectories=3)
    objects = pa.Table.from_pandas(logs.objects, preserve_index=False)
    at = objects.column_names.index(column)
    objects = objects.set_column(at, column, AS_OTHER[kind](logs.objects[column].tolist()))
    spoilt = Logs(logs.stages, logs.trajectories, objects)
    for read in (checked_tables, attempts):
        if read is checked_tables or column not in ("log_odds", "lifts"):
            refuses(rf"^objects: column '{column}' holds [\w-]+, not numbers; convert it$", read, spoilt)


def as_decimals(logs, *columns):
    objects = pa.Table.from_pandas(logs.objects, preserve_index=False)
    for column in columns:
        counts = pa.array(logs.objects[column].tolist()).cast(pa.decimal128(25, 2))
        objects = objects.set_column(objects.column_names.index(column), column, counts)
    return objects


def test_decimals_are_read_as_the_numbers_that_they_are(team):
    logs = table_log()
    objects = as_decimals(logs, "lifts", "successes", "failures")
    found = attempts(Logs(logs.stages, logs.trajectories, objects))
    pd.testing.assert_frame_equal(found, attempts(logs), check_dtype=False)
    stages = team.stages.astype({"0_does": "category", "1_does": "category"})
    found = agent_view(Logs(stages, team.trajectories, as_decimals(team, "lifts")), 0)
    pd.testing.assert_frame_equal(found.objects, agent_view(team, 0).objects)


@pytest.mark.parametrize("kind", ["bytes", "text", "list", "timestamp", "bool"])
def test_a_prior_is_a_number(alone, kind):
    trajectories = pa.Table.from_pandas(alone.trajectories.drop(columns="dirty_share"), preserve_index=False)
    trajectories = trajectories.append_column("dirty_share", AS_OTHER[kind]([0.5] * alone.num_trajectories))
    message = r"^trajectories: column 'dirty_share' holds \w+, not numbers; convert it$"
    refuses(message, logged_dirty_share, Logs(alone.stages, trajectories, alone.objects))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["list", "struct", "bytes", "bool"])
def test_what_robots_do_is_text(kind):
    logs = logged(played(team_of(2), 3), 0.0)
    stages = pa.Table.from_pandas(logs.stages, preserve_index=False)
    words = AS_OTHER[kind](logs.stages["0_does"].tolist())
    stages = stages.set_column(stages.column_names.index("0_does"), "0_does", words)
    refuses("0_does", check_log, Logs(stages, logs.trajectories, logs.objects))
