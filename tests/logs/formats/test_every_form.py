"""What holds of every form that is read: torn files are refused in one line, missing libraries named."""

import sqlite3
from contextlib import closing

import pytest

from bags import WITHOUT_CLOUD, mapping_for, mixed, two_trajectories, write_bag, write_mcap
from foreign import arrays, episodes, rows_of, write_arrays, write_rows
from halfseen.errors import HalfseenError
from halfseen.logs.formats import (
    Queries,
    StepRules,
    extras,
    read_bag,
    read_minari,
    read_sql,
    read_step_arrays,
    read_steps,
    write_minari,
)
from refusals import refused
from small_logs import flat_log


def rows(kind):
    def make(folder):
        file = write_rows(folder / "steps", rows_of(episodes(), [True] * 3), kind)
        return file, lambda: read_steps(file, StepRules(step_s=1.0))

    return make


def hdf5(folder):
    file = write_arrays(folder / "steps.hdf5", arrays(episodes(), terminated=[0, 1, 2]))
    return file, lambda: read_step_arrays(file)


def bag(storage, is_folder=False):
    def make(folder):
        (folder / "cell.toml").write_text(WITHOUT_CLOUD)
        write_bag(folder / "bag", two_trajectories() * 5, storage)
        (file,) = (file for file in (folder / "bag").iterdir() if file.suffix != ".yaml")
        return file, lambda: read_bag(folder / "bag" if is_folder else file, folder / "cell.toml")

    return make


def mcap(folder):
    (folder / "cell.toml").write_text(mapping_for(mixed))
    file = write_mcap(folder / "cell.mcap", two_trajectories() * 3, mixed)
    return file, lambda: read_bag(file, folder / "cell.toml")


def minari(folder):
    write_minari(flat_log(6), "flat-v0")
    return folder / "flat-v0" / "data" / "main_data.hdf5", lambda: read_minari("flat-v0")


def sqlite(folder):
    file = folder / "logs.db"
    with closing(sqlite3.connect(file)) as database:
        for name in ("stages", "trajectories"):
            flat_log(8).tables[name].to_sql(name, database, index=False)
    return file, lambda: read_sql(f"sqlite:///{file}", Queries("SELECT * FROM stages", "SELECT * FROM trajectories"))


NO_BAG = "it is no whole bag .*ros2 bag reindex"
FORMS = {
    **{kind: (rows(kind), "steps") for kind in ("parquet", "csv", "feather", "arrow")},
    "hdf5": (hdf5, r"steps\.hdf5: it is no whole HDF5 file of steps"),
    "db3": (bag("sqlite3"), NO_BAG),
    "db3-folder": (bag("sqlite3", True), NO_BAG),
    "bag-of-mcap": (bag("mcap"), NO_BAG),
    "folder-of-mcap": (bag("mcap", True), NO_BAG),
    "mcap": (mcap, "it is no whole bag"),
    "minari": (minari, "dataset flat-v0: "),
    "sqlite": (
        sqlite,
        r"logs\.db: trajectories, row 0: trajectory is null|logs\.db, stages: the database refuses .*(malformed|disk "
        r"image|no such)",
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
        with refused(told):
            read()
    file.unlink()
    with refused():
        read()


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
