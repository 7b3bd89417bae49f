"""What holds of every form that is read: the same log, torn files refused in one line, missing libraries named."""

import sqlite3
from contextlib import closing

import numpy as np
import pytest
import test_mcap_files as in_mcap
import test_step_arrays as in_hdf5
import test_step_tables as in_rows
from bags import two_paths, write_bag
from foreign import assert_is, episodes, expected, last_of, write_lerobot
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from halfseen.errors import HalfseenError
from halfseen.logs.formats import (
    Queries,
    StepRules,
    extras,
    read_bag,
    read_lerobot,
    read_minari,
    read_sql,
    read_step_arrays,
    read_steps,
    write_minari,
)
from small_logs import flat_log

FINISHED, CUT = ("finished", None), ("cut", "truncated")
ENDED = st.lists(st.tuples(st.integers(1, 5), st.booleans()), min_size=1, max_size=5)


def times(found, step_s):
    return [step_s * np.arange(1.0, len(each["actions"]) + 1) for each in found]


@given(ENDED, st.integers(0, 2**32 - 1), st.booleans(), st.sampled_from(["parquet", "csv", "feather"]))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=15)
def test_each_form_is_the_same_log(tmp_path_factory, ended, seed, is_text, kind):
    folder = tmp_path_factory.mktemp("steps")
    found = episodes(seed, [length for length, _ in ended], is_text=is_text)
    terminal = [is_terminal for _, is_terminal in ended]
    endings = [FINISHED if is_terminal else CUT for is_terminal in terminal]
    rules = StepRules(step_s=0.25)

    file = in_rows.write(folder / "rows", in_rows.rows_of(found, terminal), kind=kind)
    names = [f"e{number}" for number in range(len(found))]
    assert_is(read_steps(file, rules), expected(found, endings, times(found, 0.25), in_rows.SEEN, names=names))

    ends = [[number for number, is_over in enumerate(terminal) if is_over is wanted] for wanted in (True, False)]
    file = in_hdf5.write(folder / "steps.hdf5", in_hdf5.arrays(found, *ends))
    assert_is(read_step_arrays(file, rules), expected(found, endings, times(found, 0.25), in_hdf5.SEEN))

    write_lerobot(folder, found, fps=29.97, extra={"next.done": last_of(found, terminal)})
    logs = read_lerobot(folder)
    columns = ["observation.state_0", "observation.state_1"]
    assert_is(logs, expected(found, endings, times(found, 1 / 29.97), columns, has_last=False), rtol=1e-12)


def rows(kind):
    def make(folder):
        file = in_rows.write(folder / "steps", in_rows.rows_of(episodes(), [True] * 3), kind=kind)
        return file, lambda: read_steps(file, StepRules(step_s=1.0))

    return make


def arrays(folder):
    file = in_hdf5.write(folder / "steps.hdf5", in_hdf5.arrays(episodes(), terminated=[0, 1, 2]))
    return file, lambda: read_step_arrays(file)


def bag(storage, is_folder=False):
    def make(folder):
        (folder / "cell.toml").write_text(in_mcap.WITHOUT_CLOUD)
        write_bag(folder / "bag", two_paths() * 5, storage)
        (file,) = (file for file in (folder / "bag").iterdir() if file.suffix != ".yaml")
        return file, lambda: read_bag(folder / "bag" if is_folder else file, folder / "cell.toml")

    return make


def mcap(folder):
    file = in_mcap.write_mcap(folder / "cell.mcap", two_paths() * 3, in_mcap.mixed)
    mapping = in_mcap.mapping(folder, in_mcap.mixed)
    return file, lambda: read_bag(file, mapping)


def minari(folder):
    write_minari(flat_log(6), "flat-v0")
    return folder / "flat-v0" / "data" / "main_data.hdf5", lambda: read_minari("flat-v0")


def sqlite(folder):
    file = folder / "logs.db"
    with closing(sqlite3.connect(file)) as database:
        for name in ("stages", "paths"):
            flat_log(8).tables[name].to_sql(name, database, index=False)
    return file, lambda: read_sql(f"sqlite:///{file}", Queries("SELECT * FROM stages", "SELECT * FROM paths"))


NO_BAG = "it is no whole bag .*ros2 bag reindex"
FORMS = {
    **{kind: (rows(kind), "steps") for kind in ("parquet", "csv", "feather", "arrow")},
    "hdf5": (arrays, r"steps\.hdf5: it is no whole HDF5 file of steps"),
    "db3": (bag("sqlite3"), NO_BAG),
    "db3-folder": (bag("sqlite3", True), NO_BAG),
    "bag-of-mcap": (bag("mcap"), NO_BAG),
    "folder-of-mcap": (bag("mcap", True), NO_BAG),
    "mcap": (mcap, "it is no whole bag"),
    "minari": (minari, "dataset flat-v0: "),
    "sqlite": (
        sqlite,
        r"logs\.db: paths, row 0: path is null|logs\.db, stages: the database refuses .*(malformed|disk image|no such)",
    ),
}
"""By form: what makes a file and reads it, and what is said where that broke off."""


@pytest.mark.filterwarnings("ignore::UserWarning:minari.utils")
@pytest.mark.parametrize("form", FORMS)
def test_a_file_that_breaks_off_is_refused_in_one_line(tmp_path, monkeypatch, form):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    make, told = FORMS[form]
    file, read = make(tmp_path)
    content = file.read_bytes()
    for share in (0.0, 0.05, 0.1, 0.3, 0.5, 0.6, 0.9, 0.99):
        file.write_bytes(content[: int(share * len(content))])
        with pytest.raises(HalfseenError, match=told) as caught:
            read()
        assert "\n" not in str(caught.value)


@pytest.mark.filterwarnings("ignore::UserWarning:minari.utils")
@pytest.mark.parametrize(
    ("form", "extra"),
    [("hdf5", "hdf5"), ("db3-folder", "ros"), ("mcap", "mcap"), ("minari", "minari"), ("sqlite", "sql")],
)
def test_without_its_library_the_remedy_is_named(tmp_path, monkeypatch, form, extra):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    _, read = FORMS[form][0](tmp_path)

    def missing(module):
        raise ModuleNotFoundError(f"No module named {module!r}")

    monkeypatch.setattr(extras, "import_module", missing)
    calls = [read, lambda: write_minari(flat_log(6), "other-v0")] if form == "minari" else [read]
    for call in calls:
        with pytest.raises(HalfseenError, match=rf"run: .*pip install .*\[{extra}\]'"):
            call()
