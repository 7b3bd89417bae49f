import copy

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from hypothesis import given
from hypothesis import strategies as st

from halfseen.errors import LogError
from halfseen.logs import Logs
from refusals import refused
from valid_logs import assert_same, small_tables, valid_tables


@pytest.fixture
def logs():
    return Logs(**small_tables())


def test_knows_its_size_its_clocks_and_what_it_holds(logs):
    assert (logs.num_trajectories, logs.num_stages, logs.horizon) == (3, 5, 2)
    assert logs.cut_share == pytest.approx(2 / 3)
    assert logs.stage_covariates == ["steps_to_go"]
    assert logs.trajectory_columns == ["scene"]
    np.testing.assert_array_equal(logs.trajectory_ids, [1, 2, 3])
    np.testing.assert_array_equal(logs.end_s, [4.0, 3.5, 0.5])
    np.testing.assert_array_equal(logs.is_finished, [True, False, False])
    np.testing.assert_array_equal(logs.elapsed_s(), [[1.5, 4.0], [2.0, np.nan], [np.nan, np.nan]])
    np.testing.assert_array_equal(logs.stage_values("steps_to_go"), [[10, 9], [10, 9], [10, np.nan]])
    summary = logs.summary()
    assert str(summary) == "3 trajectories of up to 2 stages and 4 s: 1 finished, 2 cut (67%)."
    assert repr(logs) == f"<Logs: {summary}>"
    assert summary.causes == {"battery": 1, "operator": 1}
    assert summary.actions == {"FINISH": 1, "LIFT": 1, "WASH": 1}
    assert (summary.num_stages, summary.num_completed, summary.num_objects) == (5, 3, 2)
    assert (summary.shortest_s, summary.longest_s) == (0.5, 4.0)


def arrow_arrays(frame):
    table = pa.Table.from_pandas(frame)
    return dict(zip(table.column_names, table.columns, strict=True))


def with_categories(frame):
    return frame.astype({name: "category" for name in ("action", "cause") if name in frame})


def lists(frame):
    return frame.to_dict("list")


@pytest.mark.parametrize("wrap", [pa.Table.from_pandas, lists, pd.DataFrame.copy, arrow_arrays, with_categories])
def test_takes_pandas_arrow_dicts_and_categories(wrap, logs):
    assert_same(Logs(**{name: wrap(frame) for name, frame in small_tables().items()}), logs)


def test_optional_columns_are_added_as_null():
    tables = small_tables()
    del tables["objects"]
    tables["stages"] = tables["stages"].drop(columns=["object", "probability"])
    tables["trajectories"] = tables["trajectories"].drop(columns="cause")
    logs = Logs(**tables)
    assert logs.objects is None
    assert logs.stages["object"].isna().all()
    assert "probability" not in logs.stages
    assert logs.trajectories["cause"].isna().tolist() == [True, False, False]
    assert logs.trajectories["cause"].tolist()[1:] == ["unknown", "unknown"]


def test_a_log_in_which_nothing_is_completed_is_legal():
    stages = {"trajectory": ["a"], "stage": [1], "elapsed_s": [None], "action": [None], "reward": [None]}
    logs = Logs(stages=stages, trajectories={"trajectory": ["a"], "end_s": [1], "ending": ["cut"]})
    assert logs.stages["reward"].dtype == logs.stages["elapsed_s"].dtype == np.float64
    assert logs.end_s.dtype == np.float64
    assert np.isnan(logs.elapsed_s()).all()


def test_integers_stay_integers_beside_null():
    tables = small_tables()
    for name in ("stages", "objects"):
        tables[name]["object"] = tables[name]["object"].map({"cup": 0, "mug": 1})
    tables["stages"]["action"] = [0, 1, 2, 2, None]
    logs = Logs(**tables)
    assert logs.stages["object"].dtype == logs.stages["action"].dtype == "Int64"
    assert logs.objects["object"].dtype == "int64"


@given(valid_tables(), st.data())
def test_whatever_is_valid_is_sorted_and_can_be_taken_apart(tables, data):
    logs = Logs(**tables)
    for name, frame in logs.tables.items():
        keys = [key for key in ("trajectory", "stage", "object") if key in frame][
            : {"trajectories": 1, "stages": 2}.get(name, 3)
        ]
        pd.testing.assert_frame_equal(frame, frame.sort_values(keys, ignore_index=True))
    # The order of rows is irrelevant, and logs of logs are the same.
    assert_same(logs, Logs(**{name: None if frame is None else frame[::-1] for name, frame in tables.items()}))
    assert_same(logs, Logs(logs.stages, logs.trajectories, logs.objects))
    # Every stage has its place.
    expected = np.full((logs.num_trajectories, logs.horizon), np.nan)
    rows = {trajectory: row for row, trajectory in enumerate(logs.trajectory_ids)}
    began_s, before = [], {}
    for trajectory, stage, elapsed_s in logs.stages[["trajectory", "stage", "elapsed_s"]].itertuples(index=False):
        expected[rows[trajectory], stage - 1] = elapsed_s
        began_s.append(before.get(trajectory, 0.0))
        before[trajectory] = elapsed_s
    np.testing.assert_array_equal(logs.elapsed_s(), expected)
    # A stage begins when the one before it was completed.
    np.testing.assert_array_equal(logs.begun_s(), began_s)
    np.testing.assert_array_equal(logs.durations_s(), logs.stages["elapsed_s"] - began_s)
    # Whole trajectories are kept.
    kept = data.draw(st.sets(st.sampled_from(logs.trajectory_ids.tolist()), min_size=1))
    part = logs.select(sorted(kept))
    assert set(part.trajectory_ids.tolist()) == kept
    assert part.num_stages == logs.stages["trajectory"].isin(kept).sum()
    assert_same(part, part.select(part.trajectory_ids))


def test_does_not_touch_what_it_is_given():
    tables = small_tables()
    before = copy.deepcopy(tables)
    logs = Logs(**tables)
    logs.stages.loc[0, "steps_to_go"] = 99
    logs.trajectories.loc[0, "end_s"] = 99.0
    for name, frame in before.items():
        pd.testing.assert_frame_equal(tables[name], frame)


def test_what_is_not_there_is_refused(logs):
    with refused("trajectory 7: the log has no such trajectory", LogError):
        logs.select([1, 7])
    with refused("trajectory 1: it is named twice, and a log holds it once", LogError):
        logs.select(np.random.default_rng(0).choice([1, 1], 3))
    for name in (1, "1", None):
        with refused("select takes names of trajectories, not .*; give a list of them", LogError):
            logs.select(name)
    with refused(r"'rewards' among .*; rename 'reward'\?", LogError):
        logs.stage_values("rewards")
    with refused("'action' holds no numbers", LogError):
        logs.stage_values("action")


@pytest.mark.parametrize("mask", [np.array([True, False, True]), [True, False, True], pd.array([True, False, True])])
def test_a_mask_is_no_list_of_names_one_and_zero(mask):
    logs = Logs(**small_tables())
    with pytest.raises(LogError, match=r"select takes names of trajectories, not a mask; give trajectory_ids\[mask\]"):
        logs.select(mask)
    assert logs.select(logs.trajectory_ids[np.array(mask, dtype=bool)]).trajectory_ids.tolist() == [1, 3]
