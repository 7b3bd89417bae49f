"""Numbers of all sizes: names stay what they are beyond 2^53, and rewards that no square can hold are refused.

Beyond 2^53 fractions skip every other whole number. Rewards of other sizes only scale what is learned.
"""

import sqlite3
from contextlib import closing

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from halfseen.errors import LogError
from halfseen.learning import CensoredQLearner
from halfseen.logs import LogRecorder, Logs, LogStream, read_logs
from halfseen.logs.formats import Queries, read_csv, read_sql, write_csv
from halfseen.logs.joining import joined
from refusals import refused
from small_logs import log_of

LARGE = 2**53
"""The first whole number that a fraction does not tell from the next one."""


def tables(one, other):
    """The object of a stage may be null; names of actions are the objects' numbers, too."""
    stages = {
        "trajectory": [one, one, other, other],
        "stage": [1, 2, 1, 2],
        "elapsed_s": [1.5, 4.0, 2.0, None],
        "action": [one, other, other, None],
        "object": [one, None, other, one],
        "reward": [-0.5, -5.0, 5.0, None],
        "probability": [0.5, 1.0, 0.25, None],
    }
    trajectories = {"trajectory": [one, other], "end_s": [4.0, 3.5], "ending": ["finished", "cut"]}
    places = {"trajectory": [one] * 4 + [other] * 4, "stage": [1, 1, 2, 2] * 2}
    return {"stages": stages, "trajectories": trajectories, "objects": {**places, "object": [one, other] * 4}}


def by_arrow(found, folder):
    return Logs(**{name: pa.table(table) for name, table in found.items()})


def by_lists(found, folder):
    return Logs(**found)


def by_arrays(found, folder):
    return Logs(**{name: {key: pa.array(values) for key, values in table.items()} for name, table in found.items()})


def by_objects(found, folder):
    columns = {
        name: {key: np.array([*values, None], dtype=object)[:-1] for key, values in table.items()}
        for name, table in found.items()
    }
    return Logs(**{name: pd.DataFrame(table) for name, table in columns.items()})


def by_parquet(found, folder):
    """As a program that knows no pandas writes it."""
    by_arrow(found, folder).write(folder / "logs")
    for name, table in found.items():
        pq.write_table(pa.table(table), folder / "logs" / f"{name}.parquet")
    return read_logs(folder / "logs")


def by_stream(found, folder):
    by_arrow(found, folder).write(folder / "logs")
    return joined(list(LogStream(folder / "logs", trajectories_at_once=1)))


def by_csv(found, folder):
    write_csv(by_arrow(found, folder), folder / "csv")
    return read_csv(folder / "csv")


def by_sql(found, folder):
    with closing(sqlite3.connect(folder / "a.db")) as connection:
        for name, table in found.items():
            connection.execute(f"CREATE TABLE {name} ({', '.join(table)})")
            marks = ", ".join("?" * len(table))
            connection.executemany(f"INSERT INTO {name} VALUES ({marks})", list(zip(*table.values(), strict=True)))
        connection.commit()
    return read_sql(f"sqlite:///{folder / 'a.db'}", Queries(*(f"SELECT * FROM {name}" for name in found)))


DOORS = [by_arrow, by_lists, by_arrays, by_objects, by_parquet, by_stream, by_csv, by_sql]


@pytest.mark.parametrize("first", [LARGE - 1, LARGE, LARGE + 1, 2**62 + 1, -LARGE - 1])
@pytest.mark.parametrize("read", DOORS)
def test_whole_numbers_are_kept(tmp_path, read, first):
    found = tables(first, first + 1)
    logs = read(found, tmp_path)
    for name, column in (
        ("stages", "object"),
        ("stages", "action"),
        ("objects", "object"),
        ("trajectories", "trajectory"),
    ):
        kept = logs.tables[name][column]
        assert [None if pd.isna(each) else int(each) for each in kept] == found[name][column], (name, column)
        assert pd.api.types.is_integer_dtype(kept.dtype)


@pytest.mark.parametrize("number", [LARGE, LARGE + 2, -LARGE])
def test_fractions_that_may_be_another_number_are_refused(tmp_path, number):
    found = tables(number - 3 if number > 0 else number + 3, number)
    found["stages"]["object"] = np.array(found["stages"]["object"], dtype=np.float64)
    wording = rf"stages, row 2: object {float(number)!r} is not a valid name, as floats from 2\^53 on".replace(
        "+", r"\+"
    )
    with refused(wording):
        Logs(**found)
    found = tables(LARGE - 2, LARGE - 1)
    found["stages"]["object"] = np.array(found["stages"]["object"], dtype=np.float64)
    assert Logs(**found).stages["object"].dropna().tolist() == [LARGE - 2, LARGE - 1, LARGE - 2]


@pytest.mark.parametrize("number", [2**63, 2**64, -(2**63) - 1, 2**70])
@pytest.mark.parametrize("column", ["x", "reward", "action", "trajectory"])
def test_whole_numbers_of_more_bits_are_refused(column, number):
    with refused(rf"column '{column}' holds {number}, beyond 64-bit integers", LogError):
        log_of(**{"trajectory": range(2), column: pd.Series([number, 1], dtype=object)})


def test_a_recorder_keeps_them(tmp_path):
    one, other = LARGE, LARGE + 1
    with LogRecorder(tmp_path / "recorded") as recorder:
        trajectory = recorder.begin_trajectory(other)
        for number, target in enumerate((other, None), start=1):
            rows = [{"object": one}, {"object": other}]
            trajectory.begin_stage({}, objects=rows, action=other, object=target)
            trajectory.complete_stage(1.0, elapsed_s=number)
        trajectory.finish(elapsed_s=2.0)
    logs = read_logs(tmp_path / "recorded")
    assert logs.stages["object"].tolist()[0] == logs.stages["action"].tolist()[0] == logs.trajectory_ids[0] == other
    assert logs.objects["object"].tolist() == [one, other] * 2


# Rewards.


def scaled(scale):
    rewards, each = np.random.default_rng(0).normal(size=40), np.arange(40)
    return log_of(trajectory=each, reward=scale * rewards, action=np.where(each % 2, "a", "b"), x=each / 39.0)


@pytest.mark.parametrize("scale", [1e155, 1e76])
def test_no_reward_too_large_to_be_squared(tmp_path, scale):
    with refused(r"trajectory .*: reward .* give rewards in another unit", LogError):
        scaled(scale)
    with LogRecorder(tmp_path / "logs") as recorder:
        trajectory = recorder.begin_trajectory()
        trajectory.begin_stage({"x": 0.5}, action="a")
        with refused(r"stage 1: reward is 1e\+\d+; give rewards in another unit", LogError):
            trajectory.complete_stage(scale)
        trajectory.complete_stage(1.0)


@pytest.mark.parametrize("scale", [1e-76, 1e-200])
def test_nothing_is_learned_from_rewards_too_small_to_be_squared(scale):
    with refused(r"largest reward is .*e-\d+, .* give rewards in another unit", LogError):
        CensoredQLearner(1, ["a", "b"], ["x"]).fit(scaled(scale))


@pytest.mark.parametrize("scale", [1e70, 1e-70])
def test_other_sizes_only_scale_q(scale):
    q = [CensoredQLearner(1, ["a", "b"], ["x"]).fit(scaled(s)).policy_ for s in (1.0, scale)]
    frames = scaled(1.0).stages[["x"]]
    one, other = (policy.scores(frames, 1) for policy in q)
    np.testing.assert_allclose(other, scale * one, rtol=1e-6)
