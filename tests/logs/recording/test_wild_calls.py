"""Whatever a recorder takes is read back, and what it refuses is what no log takes."""

import math
import re
from itertools import product

import numpy as np
import pandas as pd
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recordings import of_robot

from halfseen.errors import LogError
from halfseen.logs import LogRecorder, read_logs
from refusals import refused
from small_logs import log_of

WILD_TEXT = st.text(st.characters(exclude_categories=()), max_size=3) | st.sampled_from(
    ["", "\0", "a\0", "\ud800", "0_reward", "1_out_s", "0_out_cause", " Path", "x", "y", "NaN", "null"]
)
WHOLE = st.integers(-(2**65), 2**65) | st.sampled_from(
    [2**53, 2**53 + 1, -(2**53) - 1, 2**63 - 1, -(2**63), 10**400, 0]
)
WILD_NUMBER = WHOLE | st.floats() | st.booleans()
WILD_VALUE = WILD_NUMBER | WILD_TEXT | st.none() | st.lists(WILD_NUMBER | WILD_TEXT, max_size=3)
TAME = st.sampled_from([0.5, 1, 2**53 + 1])
VALUE = TAME | TAME | TAME | WILD_VALUE
NAME = st.just("A") | st.just("A") | st.just("A") | WHOLE | WILD_TEXT
AT_S = st.fixed_dictionaries(
    {"elapsed_s": st.none() | st.sampled_from([0.0, 1e-12, 1e-9, 1e-6, 1e-3, 1.0, 1e3, 1e9]) | st.floats(0.0, 10.0)}
)
X = st.fixed_dictionaries({"x": VALUE})
COVARIATES = X | X | X | st.dictionaries(WILD_TEXT, WILD_VALUE)
OBJECT = st.fixed_dictionaries({"object": NAME, "z": VALUE})
CHANCES = st.fixed_dictionaries({}, optional={"probability": st.floats(0.0, 1.0), "robot": st.integers(0, 2)})
SHARES = st.fixed_dictionaries({}, optional={"own_rewards": st.lists(st.floats(), max_size=2)})


def call(names, *given, **named):
    """Calls of some names with what is given by position and by name."""
    words = st.tuples(*named.values()).map(lambda parts: {key: value for part in parts for key, value in part.items()})
    return st.tuples(st.sampled_from(names.split()), st.tuples(*given), words)


BEGIN_PLAINLY = call("begin_stage", X, st.none(), NAME, st.none())
CALLS = st.one_of(
    *[BEGIN_PLAINLY] * 3,
    call("begin_trajectory", st.none() | NAME, columns=st.dictionaries(WILD_TEXT, VALUE, max_size=2)),
    call("begin_stage", COVARIATES, st.none() | st.lists(OBJECT, max_size=2), NAME, st.none() | NAME, chances=CHANCES),
    call("complete_stage", st.floats(-9, 9) | WILD_NUMBER, at=AT_S, shares=SHARES),
    call("drop_out", st.integers(0, 2), WILD_TEXT, at=AT_S),
    call("still_running finish", at=AT_S),
    call("cut", WILD_TEXT, at=AT_S),
)
"""One call of any kind with arguments of any kind: few of them are taken."""


def same(back, given):
    """Whether a value came back: whole numbers exactly, and lists as arrays."""
    if isinstance(given, list):
        return len(back) == len(given) and all(same(b, g) for b, g in zip(back, given, strict=True))
    return bool(back == given) and isinstance(back, bool | np.bool_) == isinstance(given, bool)


def check_row(row, values):
    assert all(value is None or same(row[column], value) for column, value in values.items())


def check_calls(folder, calls):
    """Make calls, and read back what was taken: of trajectories, of stages and of objects."""
    columns, stages = {}, {}
    with LogRecorder(folder) as recorder:
        for name, given, named in calls:
            trajectory = recorder.trajectory
            try:
                if name == "begin_trajectory":
                    columns[recorder.begin_trajectory(*given, **named).name] = named
                elif trajectory is not None:
                    getattr(trajectory, name)(*given, **named)
                    if name == "begin_stage":
                        stages.setdefault(trajectory.name, []).append((given, named))
            except LogError as error:
                assert len(str(error).splitlines()) == 1  # noqa: PT017
    if not stages:
        return
    tables = {name: rows.astype(object).to_dict("records") for name, rows in read_logs(folder).tables.items()}
    for end in tables["trajectories"]:
        name = end["trajectory"]
        check_row(end, columns[name])
        rows = [row for row in tables["stages"] if row["trajectory"] == name]
        assert len(stages[name]) - len(rows) in (0, 1)  # a cut may take the last one back
        for row, ((covariates, objects, action, acted_on), named) in zip(rows, stages[name], strict=False):
            check_row(row, covariates | {"action": action, "object": acted_on})
            assert named.get("probability") is None or math.isclose(row["probability"], named["probability"])
            for each in objects or ():
                (found,) = (
                    one
                    for one in tables["objects"]
                    if (one["trajectory"], one["stage"], one["object"]) == (name, row["stage"], each["object"])
                )
                check_row(found, each)


@pytest.mark.slow
@pytest.mark.parametrize("most", [60, pytest.param(500, marks=pytest.mark.slow)])
def test_whatever_is_taken_is_read_back(tmp_path_factory, monkeypatch, most):
    monkeypatch.setattr("halfseen.logs.recorded.ROWS_A_CHUNK", 2)

    @settings(max_examples=most)
    @given(calls=st.lists(CALLS, min_size=4, max_size=12 if most == 60 else 20))
    def check(calls):
        check_calls(tmp_path_factory.mktemp("logs") / "logs", [("begin_trajectory", (None,), {}), *calls])

    check()


PLAIN = st.sampled_from([1, 2.5, 2**53 + 1, [1], [2.5], [2**60], [], "a", True])


@given(values=st.lists(st.tuples(PLAIN, PLAIN, PLAIN | st.none()), min_size=2, max_size=5))
def test_columns_of_numbers_of_all_sizes_are_read_back_or_refused(tmp_path_factory, values):
    calls = []
    for x, y, scene in values:
        stage = ({"x": x}, [{"object": 1, "y": y}], "A", 1)
        calls += [("begin_trajectory", (), {} if scene is None else {"scene": scene}), ("begin_stage", stage, {})]
        calls += [("complete_stage", (0.0,), {"elapsed_s": 1.0}), ("finish", (), {}), ("cut", ("operator",), {})]
    check_calls(tmp_path_factory.mktemp("logs") / "logs", calls)


DECISION = st.tuples(st.integers(0, 2), st.sampled_from([None, 0, 1, 2]), st.sampled_from([0.0, 1.0, 2.0]))


def logs_of(decisions, ending):
    """As `Logs` takes them; the last stage of a trajectory that is cut is not completed."""
    robots, targets, lengths = zip(*decisions, strict=True)
    stage, clock = range(1, len(decisions) + 1), np.cumsum(lengths)
    objects = pd.DataFrame(product([1], stage, range(3)), columns=["trajectory", "stage", "object"])
    done = {"elapsed_s": [*clock[:-1], clock[-1] if ending == "finished" else np.nan], "reward": 0.0}
    done |= {"object": pd.array(targets, dtype="Int64"), "robot": robots}
    return log_of({"end_s": clock[-1] + 1.0, "ending": ending}, objects, stage=stage, x=1.0, **done)


@pytest.mark.slow
@settings(max_examples=15)
@given(st.lists(DECISION, min_size=2, max_size=5))
def test_a_stage_of_robots_is_refused_where_the_log_with_it_would_not_be_read(tmp_path_factory, decisions):
    folder, taken = tmp_path_factory.mktemp("robots") / "logs", []
    with LogRecorder(folder) as recorder:
        trajectory = recorder.begin_trajectory(1)
        for robot, target, length in decisions:
            try:
                logs_of([*taken, (robot, target, length)], "cut")
            except LogError as message:
                with refused(re.escape(str(message)), LogError):
                    of_robot(trajectory, robot, target)
                continue
            taken.append((robot, target, length))
            of_robot(trajectory, robot, target)
            trajectory.complete_stage(0.0, elapsed_s=sum(each for *_, each in taken))
        if not taken:
            trajectory.cut("operator")
            return
        trajectory.finish(elapsed_s=sum(each for *_, each in taken) + 1.0)
    found, wanted = read_logs(folder), logs_of(taken, "finished")
    for name in ("robot", "elapsed_s", "action", "object"):
        pd.testing.assert_series_equal(found.stages[name], wanted.stages[name], check_dtype=False)
    assert found.end_s.tolist() == wanted.end_s.tolist()
