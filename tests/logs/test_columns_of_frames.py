"""Whatever a table comes as, its columns are kept as plain ones, or refused in one line."""

from decimal import Decimal

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from halfseen.errors import LogError
from halfseen.logs import Logs, read_logs
from halfseen.logs.frames import frame_of
from refusals import refused
from small_logs import log_of


def in_arrow(values):
    return pd.Series(pd.arrays.ArrowExtensionArray(pa.array(values)))


@pytest.mark.parametrize("kind", [">f4", ">f8", ">i2", ">i4", ">i8", ">u4"])
def test_numbers_of_another_machine_are_read(kind):
    found = log_of(trajectory=range(2), x=np.array([1, 2], kind)).stages["x"]
    assert found.dtype == np.dtype(kind).newbyteorder("=")
    assert found.tolist() == [1, 2]


def test_what_pandas_keeps_in_arrow_is_kept_as_plain_columns(tmp_path):
    named = pd.Series(pd.arrays.ArrowExtensionArray(pa.array(["a", "b"]).dictionary_encode()))
    columns = {"action": named, "word": named, "x": in_arrow([[1.0], [2.0]])}
    log_of(trajectory=range(2), **columns).write(tmp_path / "ours")
    stages = pd.read_parquet(tmp_path / "ours" / "stages.parquet").assign(**columns)
    pq.write_table(pa.Table.from_pandas(stages), tmp_path / "ours" / "stages.parquet")
    for logs in (log_of(trajectory=range(2), **columns), read_logs(tmp_path / "ours")):
        assert logs.stages["action"].tolist() == logs.stages["word"].tolist() == ["a", "b"]
        assert [each.tolist() for each in logs.stages["x"]] == [[1.0], [2.0]]


@pytest.mark.parametrize("kind", [list, pa.array, in_arrow])
def test_decimals_of_databases_are_numbers(kind):
    tables = log_of(trajectory=range(3)).tables
    stages = pa.Table.from_pandas(tables["stages"]).append_column("x", pa.array([Decimal("0.5"), None, Decimal("-2")]))
    stages = stages if kind is pa.array else stages.to_pandas().assign(x=kind([Decimal("0.5"), None, Decimal("-2")]))
    found = Logs(stages, tables["trajectories"], missing="median+flag").stages
    assert found[["x", "x_missing"]].to_numpy().tolist() == [[0.5, 0.0], [-0.75, 1.0], [-2.0, 0.0]]


def test_a_decimal_is_the_nearest_float():
    tenths = [Decimal(k) / 10 for k in range(1000)]
    assert frame_of(pa.table({"x": tenths}))["x"].tolist() == [k / 10 for k in range(1000)]


def test_nan_in_arrow_is_missing():
    tables = log_of(trajectory=range(3)).tables
    stages = tables["stages"].assign(x=in_arrow([float("nan"), None, 2.0]))
    logs = Logs(stages, tables["trajectories"], missing="median+flag")
    assert logs.stages[["x", "x_missing"]].to_numpy().tolist() == [[2.0, 1.0], [2.0, 1.0], [2.0, 0.0]]


@pytest.mark.parametrize("nothing", [in_arrow([None, None]), [np.nan] * 2, pd.Series([pd.NaT] * 2)])
def test_names_that_are_all_null_are_null_whatever_their_type(nothing):
    tables = log_of(trajectory=range(2)).tables
    logs = Logs(tables["stages"].assign(object=nothing), tables["trajectories"].assign(cause=nothing))
    assert logs.stages["object"].tolist() == logs.trajectories["cause"].tolist() == [None, None]


@pytest.mark.parametrize("column", ["action", "trajectory", "object", "x"])
@pytest.mark.parametrize("kind", [object, "category", "string"])
def test_text_with_nul_is_refused(column, kind):
    with refused(rf"column '{column}' holds 'a.x00b', which has the character NUL", LogError):
        log_of(**{"trajectory": [*"ab"], column: pd.Series(["a\0b", "a"], dtype=kind)})
