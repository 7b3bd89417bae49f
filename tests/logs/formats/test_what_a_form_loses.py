"""What is not named as lost comes back equal; what is refused is refused by the writer, too."""

import datetime
import os
from decimal import Decimal

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from halfseen.errors import ArgumentError, LogError
from halfseen.logs import Logs, read_logs
from halfseen.logs.formats import losses, read_csv, read_minari, seen_by_halfseen_alone, write_csv, write_minari
from refusals import refused
from valid_logs import small_tables, valid_tables

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning:minari.utils")
WORDS = ["", "ä", "007", "true", "[1", '"', ",", "a\r\nb", "nan"]
KINDS = {
    "text": lambda rng, n: rng.choice(WORDS, n).tolist(),
    "text or null": lambda rng, n: [None if rng.random() < 0.4 else "" for _ in range(n)],
    "all null": lambda rng, n: [None] * n,
    "bytes": lambda rng, n: [bytes([k]) for k in rng.integers(0, 256, n)],
    "struct": lambda rng, n: [{"a": int(k)} for k in rng.integers(0, 9, n)],
    "decimal": lambda rng, n: [Decimal(int(k)) / 8 for k in rng.integers(0, 99, n)],
    "date": lambda rng, n: [datetime.date(2026, 1, 1 + int(k)) for k in rng.integers(0, 28, n)],
    "time": lambda rng, n: [datetime.time(int(k)) for k in rng.integers(0, 24, n)],
    "duration": lambda rng, n: pd.to_timedelta(rng.integers(0, 99, n), unit="s"),
    "instant": lambda rng, n: pd.to_datetime(rng.integers(0, 2**60, n), utc=bool(rng.random() < 0.5)),
    "instant of a second": lambda rng, n: pd.to_datetime(["2024-05-01"] * n).as_unit("s").tz_localize("UTC"),
    "uint64": lambda rng, n: rng.integers(0, 2**64, n, dtype=np.uint64),
    "int8": lambda rng, n: rng.integers(-128, 128, n).astype(np.int8),
    "float16": lambda rng, n: rng.normal(size=n).astype(np.float16),
    "float32": lambda rng, n: rng.normal(size=n).astype(np.float32),
    "float64": lambda rng, n: rng.normal(size=n) * 10.0 ** rng.integers(-300, 300, n),
    "Int64": lambda rng, n: pd.array(rng.integers(-(2**62), 2**62, n), dtype="Int64"),
    "string": lambda rng, n: pd.array([str(k) for k in rng.integers(0, 9, n)], dtype="string"),
    "bool": lambda rng, n: rng.random(n) < 0.5,
    "boolean": lambda rng, n: pd.array([[True, False, None][k] for k in rng.integers(0, 3, n)], dtype="boolean"),
    "bool or null": lambda rng, n: [[True, False, None][k] for k in rng.integers(0, 3, n)],
    "date or null": lambda rng, n: [None if rng.random() < 0.4 else datetime.date(2024, 2, 29) for _ in range(n)],
    "float64 at its ends": lambda rng, n: rng.choice([5e-324, -0.0, 1e308, 0.1], n),
    "zoned": lambda rng, n: pd.to_datetime(rng.integers(0, 2**60, n), utc=True).tz_convert("Europe/Berlin"),
    "arrow": lambda rng, n: pd.array(rng.integers(0, 9, n), dtype=pd.ArrowDtype(pa.int32())),
    "categories": lambda rng, n: pd.Categorical(rng.choice(["a", "b"], n), ["z", "b", "a"]),
    "categories in order": lambda rng, n: pd.Categorical(rng.choice(["a", "b"], n), ["z", "b", "a"], ordered=True),
    "categories of numbers": lambda rng, n: pd.Categorical(rng.choice([1, 2], n), [3, 2, 1]),
    "categories of null": lambda rng, n: pd.Categorical([None] * n),
    "list": lambda rng, n: [rng.normal(size=rng.integers(0, 3)).tolist() for _ in range(n)],
    "list of lists": lambda rng, n: [[[int(k)] * int(k % 3)] for k in rng.integers(0, 9, n)],
    "list of text": lambda rng, n: [["a", ""][: int(k)] for k in rng.integers(0, 3, n)],
    "list of dates": lambda rng, n: [[datetime.date(2026, 1, 1)]] * n,
    "period": lambda rng, n: pd.period_range("2026", periods=n, freq="D"),
}  # fmt: skip
NAMES = ["x", " y", "with, comma", 'quo"te', "two\nlines", "größe", "-1", ""]


@st.composite
def any_tables(draw):
    tables = draw(valid_tables())
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    for name in [name for name, table in tables.items() if table is not None]:
        for column in draw(st.lists(st.sampled_from(NAMES), max_size=3, unique=True)):
            values = KINDS[draw(st.sampled_from(sorted(KINDS)))](rng, len(tables[name]))
            tables[name] = tables[name].assign(**{column: pd.Series(values, index=tables[name].index)})
    return tables


def log_of(tables):
    try:
        return Logs(**tables)
    except LogError:  # a column of null is no covariate of numbers
        assume(False)


FORMS = {
    "parquet": (lambda logs, folder: logs.write(folder / "a"), lambda folder: read_logs(folder / "a")),
    "csv": (lambda logs, folder: write_csv(logs, folder / "a"), lambda folder: read_csv(folder / "a")),
    "minari": (lambda logs, folder: write_minari(logs, "a-v0"), lambda folder: read_minari("a-v0")),
}


def check(form, tables, unit, folder):
    """What a form does not name as lost comes back; what it names as refused its writer refuses."""
    (write, read), logs = FORMS[form], log_of(tables).in_unit(unit)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("MINARI_DATASETS_PATH", str(folder))
        refused = [loss for loss in losses(logs, form) if loss.is_refused]
        if refused:
            with pytest.raises(LogError) as caught:
                write(logs, folder)
            assert all(str(loss) in str(caught.value) for loss in refused)
        else:
            write(logs, folder)
            assert_back(logs, read(folder), {(loss.table, loss.column) for loss in losses(logs, form)})


@pytest.mark.slow
@pytest.mark.parametrize(("form", "most"), [("parquet", 15), ("csv", 20), ("minari", 8)])
def test_what_is_not_lost_comes_back_and_what_is_refused_is_refused_by_the_writer(tmp_path_factory, form, most):
    @given(any_tables(), st.sampled_from([None, "Körbe"]))
    @settings(max_examples=most)
    def check_any(tables, unit):
        check(form, tables, unit, tmp_path_factory.mktemp("logs"))

    check_any()


@pytest.mark.slow
@pytest.mark.parametrize("form", FORMS)
def test_each_type_comes_back_or_is_refused(tmp_path, form):
    tables, rng = small_tables(), np.random.default_rng(0)
    for name, table in tables.items():
        columns = {kind: pd.Series(make(rng, len(table)), index=table.index) for kind, make in KINDS.items()}
        # Null is no covariate.
        kept = {kind: values for kind, values in columns.items() if name == "trajectories" or values.notna().all()}
        tables[name] = table.assign(**kept)
    is_refused = {(loss.table, loss.column) for loss in losses(Logs(**tables), form) if loss.is_refused}
    for number, left_out in enumerate([set(), is_refused]):
        whole = {n: t.drop(columns=[column for of, column in left_out if of == n]) for n, t in tables.items()}
        (tmp_path / str(number)).mkdir()
        check(form, whole, None, tmp_path / str(number))
    # What is refused is refused for each column alone.
    for number, (name, column) in enumerate(sorted(is_refused)):
        (tmp_path / f"alone-{number}").mkdir()
        alone = small_tables()
        alone[name] = alone[name].assign(**{column: tables[name][column]})
        check(form, alone, None, tmp_path / f"alone-{number}")


def assert_back(logs, back, lost):
    assert back.reward_unit == logs.reward_unit
    assert back.tables.keys() == logs.tables.keys()
    for name, table in logs.tables.items():
        assert list(back.tables[name]) == list(table)
        for column in table:
            ours, theirs = table[column], back.tables[name][column]
            if (name, column) in lost:
                with pytest.raises(AssertionError):
                    pd.testing.assert_series_equal(ours, theirs)
                assert [str(each) for each in ours] == [str(each) for each in theirs]
            else:
                pd.testing.assert_series_equal(ours, theirs)
                if ours.dtype == np.float64:
                    np.testing.assert_array_equal(np.signbit(ours), np.signbit(theirs))


@pytest.mark.parametrize(
    ("form", "at"),
    [
        ("parquet", "halfseen.logs.parquet.pq.write_table"),
        ("csv", "halfseen.logs.formats.csv_folder.arrow_csv.write_csv"),
        ("minari", "minari.dataset._storages.hdf5_storage.HDF5Storage.update_episode_metadata"),
    ],
)
def test_a_write_that_fails_leaves_nothing_and_what_is_there_is_never_replaced(tmp_path, monkeypatch, form, at):
    def full_disk(*args, **kwargs):
        raise OSError(28, "No space left on device")

    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    logs, (write, _) = Logs(**small_tables()), FORMS[form]
    with monkeypatch.context() as patch:
        patch.setattr(at, full_disk)
        with refused("No space left on device", ArgumentError):
            write(logs, tmp_path)
    assert os.listdir(tmp_path) == []
    write(logs, tmp_path)
    before = {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()}
    with pytest.raises(ArgumentError, match="it already exists"):
        write(logs.select([1]), tmp_path)
    assert {file: file.read_bytes() for file in tmp_path.rglob("*") if file.is_file()} == before
    assert os.environ["MINARI_DATASETS_PATH"] == str(tmp_path)


def test_each_loss_is_named_with_its_column():
    tables = small_tables()
    tables["stages"]["pose"] = [{"x": 1.0}] * 5
    more = {"raw": [b"a"] * 3, "two\nlines": 1, "serial": pd.array([1, 2, 3], dtype=pd.ArrowDtype(pa.int32()))}
    tables["trajectories"] = tables["trajectories"].assign(**more)
    logs = Logs(**tables)
    in_csv, in_minari = (losses(logs, form) for form in ("csv", "minari"))
    message = "holds struct<x: double>, which cannot be written as text; drop it, or convert it to numbers"
    assert str(in_csv[0]).startswith(f"stages: column 'pose' {message}")
    assert [loss.table for loss in in_csv] == ["stages", "trajectories", "trajectories", "trajectories"]
    assert [loss.column for loss in in_csv] == ["pose", "raw", "serial", "two\nlines"]
    found = [(loss.column, loss.is_refused) for loss in in_minari]
    assert found == [("pose", True), ("raw", True), ("serial", False)]
    assert "is read back as pandas stores such values, not as int32[pyarrow]" in str(in_minari[2])
    assert losses(logs, "parquet") == []
    with refused("form 'xml': choose among parquet, csv, minari", ArgumentError):
        losses(logs, "xml")
    # A log without a completed stage.
    logs = Logs(**small_tables()).select([3])
    assert [str(loss) for loss in losses(logs, "minari")] == [
        "stages: no stage was completed, so Minari would have no step; record longer, or write Parquet"
    ]
    assert losses(logs, "csv") == []


def test_what_steps_cannot_carry_is_named():
    tables = small_tables()
    result = ["stages.object", "stages.probability", "trajectories.cause", "trajectories.scene", "objects"]
    assert seen_by_halfseen_alone(Logs(**tables)) == result
    bare = Logs(tables["stages"].drop(columns=["object", "probability"]), tables["trajectories"].drop(columns="scene"))
    assert seen_by_halfseen_alone(bare.select([1])) == []
