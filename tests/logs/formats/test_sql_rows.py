"""A log in a database: SQLite, DuckDB, and PostgreSQL by a server of our own."""

import datetime
import os
import re
import shutil
import sqlite3
import subprocess
import tempfile
import uuid
from contextlib import closing
from decimal import Decimal
from pathlib import Path

import pandas as pd
import pytest

from halfseen.logs import Logs
from halfseen.logs.formats import Queries, read_queries, read_sql
from halfseen.logs.formats.sql_rows import _value
from refusals import refused
from valid_logs import small_tables

ALL = Queries("SELECT * FROM stages", "SELECT * FROM trajectories", "SELECT * FROM objects")
TWO = Queries("SELECT * FROM stages", "SELECT * FROM trajectories")


def run(database, *statements):
    with closing(sqlite3.connect(database.removeprefix("sqlite:///"))) as connection:
        for statement, *rows in statements:
            connection.executemany(statement, rows) if rows else connection.execute(statement)
        connection.commit()


@pytest.fixture
def database(tmp_path):
    """The tables of a log, written row by row."""
    url = f"sqlite:///{tmp_path / 'cell.db'}"
    for name, frame in small_tables().items():
        rows = frame.astype(object).where(frame.notna(), None).values.tolist()
        cells = [[str(cell) if isinstance(cell, list) else cell for cell in row] for row in rows]
        places = ", ".join("?" * frame.shape[1])
        run(url, (f"CREATE TABLE {name} ({', '.join(frame)})",), (f"INSERT INTO {name} VALUES ({places})", *cells))
    return url


def assert_is_the_log(logs):
    for name, table in Logs(**small_tables()).tables.items():
        pd.testing.assert_frame_equal(logs.tables[name], table)


def test_rows_are_the_log_that_was_written(database):
    assert_is_the_log(read_sql(database, ALL))


def test_queries_may_name_filter_and_compute(database):
    run(database, ["ALTER TABLE stages RENAME COLUMN steps_to_go TO togo"])
    stages = """/* all; but one */ WITH s AS (SELECT * FROM stages WHERE trajectory < 3)
        SELECT trajectory, stage, elapsed_s, action, reward, togo * 2 AS x FROM s;"""
    # Percent signs and colons are no parameters.
    trajectories = """SELECT trajectory, end_s, ending, cause, 'a; b 100 % :x' AS note FROM trajectories
        WHERE trajectory < 3 AND ending LIKE '%' AND ':y' <> '' -- and no more"""
    logs = read_sql(database, Queries(stages, trajectories))
    assert logs.stages["x"].tolist() == [20, 18, 20, 18]
    assert logs.trajectories["note"].tolist() == ["a; b 100 % :x"] * 2


def test_whole_numbers_with_null_and_beyond_fractions_stay(database):
    run(
        database,
        ["ALTER TABLE trajectories ADD COLUMN serial"],
        [f"UPDATE trajectories SET serial = {2**60 + 1} WHERE trajectory > 1"],
    )
    assert read_sql(database, TWO).trajectories["serial"].tolist()[1:] == [2**60 + 1] * 2


def test_what_is_read_stays_as_it_is(database):
    file = Path(database.removeprefix("sqlite:///"))
    before = file.read_bytes()
    for query in (
        "DELETE FROM stages",
        "SELECT 1; DROP TABLE stages",
        "ATTACH 'other.db' AS o",
        "PRAGMA user_version = 3",
        "SELECT '' ; DELETE FROM stages; --'",
        "",
    ):
        with refused("is not a single SELECT"):
            Queries(query, "SELECT 1")
    with refused():
        read_sql(database, Queries("WITH x AS (SELECT 1) DELETE FROM stages", TWO.trajectories))
    assert file.read_bytes() == before
    assert os.listdir(file.parent) == ["cell.db"]


COLUMNS = "SELECT trajectory, stage, elapsed_s, action, "


def test_what_is_wrong_is_reported_in_one_line(database, monkeypatch):
    for stages, message in (
        ("SELECT * FROM stage", r"cell\.db, stages: the database refuses 'SELECT \* FROM stage' \(no such table"),
        ("SELECT FROM stages", r"the database refuses .*syntax error"),
        ("SELECT trajectory, stage FROM stages", r"cell\.db: stages: there is no column 'elapsed_s'"),
        ("SELECT *, trajectory FROM stages", r"stages: there are two columns 'trajectory'"),
        (f"{COLUMNS} reward, CASE stage WHEN 1 THEN 'a' ELSE 2 END AS x FROM stages",
         r"stages: column 'x' mixes int, str .*give it one type \(CAST\)"),
        ("SELECT * FROM stages WHERE trajectory = 1", r"trajectory 2: it has no stage"),
        (f"{COLUMNS} reward, 9e999 AS x FROM stages", r"covariate x is inf"),
        (f"{COLUMNS} NULL AS reward FROM stages", r"its reward is nan"),
    ):  # fmt: skip
        with refused(message):
            read_sql(database, Queries(stages, TWO.trajectories))
    # Rows without end.
    monkeypatch.setattr("halfseen.logs.formats.sql_rows.ROWS_AT_ONCE", 1000)
    monkeypatch.setattr("halfseen.logs.formats.sql_rows.MOST_BYTES", 10**5)
    endless = "WITH RECURSIVE n(k) AS (SELECT 1 UNION ALL SELECT k + 1 FROM n) SELECT k AS trajectory FROM n"
    with refused(r"stages: .* returns more than 0 MB"):
        read_sql(database, Queries(endless, TWO.trajectories))


@pytest.mark.parametrize(
    ("url", "message"),
    [
        ("nowhere", "it is no database address; give sqlite:///FILE or DIALECT://"),
        ("sqlite://", "it names no file"),
        ("sqlite:///:memory:", "it names no file"),
        ("sqlite:///none.db", r"sqlite:///none\.db: it cannot be read"),
        ("sqlite:///a.db", "file is not a database"),
        ("sqlite:///pipe.db", "it is a pipe"),
        ("sqlite:///.", "it is a folder"),
        ("nosql://me:hidden@host/cell", r"nosql://me:\*\*\*@host/cell: 'nosql' is not an installed database dialect"),
        ("postgresql+nodriver://me:hidden@host/cell", r"'postgresql\+nodriver' is not an installed database dialect"),
        ("mysql+pymysql://me:hidden@host/cell", r"its driver pymysql is not installed; run: pip install pymysql"),
        (
            "postgresql://me:hidden@host:port/cell",
            r"postgresql://me:\*\*\*@host:port/cell: it is no database address",
        ),
        ("postgresql+psycopg2://me:hid/den@x@host/cell", r"postgresql\+psycopg2://me:\*\*\*@host/cell: "),
        ("mysql+pymysql://me@host/cell?password=hidden", r"me@host/cell\?password=\*\*\*: "),
    ],
)
def test_an_address_that_leads_nowhere_is_reported_without_its_password(url, message, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("a.db").write_bytes(b"no database" * 100)
    os.mkfifo("pipe.db")
    with refused(message) as caught:
        read_sql(url, TWO)
    assert "hid" not in str(caught.value)


def test_queries_come_from_a_file(tmp_path):
    file = tmp_path / "cell.toml"
    file.write_text('stages = "SELECT 1"\ntrajectories = "SELECT 2"\nobjects = "SELECT 3"\n')
    assert read_queries(file) == Queries("SELECT 1", "SELECT 2", "SELECT 3")
    for content, message in (
        ('stages = "SELECT 1"', "trajectories: it is missing"),
        ("stages = 1\ntrajectories = 2", "stages: expected `str`, got `int`"),
        ('stages = "DROP x"\ntrajectories = "SELECT 1"', "stages 'DROP x': it is not a single SELECT"),
        ('other = "SELECT 1"', "other: it is unknown; give a SELECT for stages and trajectories, and objects"),
        ("stages =", "it is not valid TOML"),
    ):
        file.write_text(content)
        with refused(rf"cell\.toml.*{message}"):
            read_queries(file)
    with refused("it cannot be read"):
        read_queries(tmp_path / "none.toml")


def test_secrets_are_never_shown():
    places = "a:se:cret@h/d a:se/cret@h/d a:se@cret@h/d :secret@h h/d?passwd=secret&x=1 h?sslpassword=secret"
    for url in [*(f"pg://{place}" for place in places.split()), "a:secret@h"]:
        with refused() as caught:
            read_sql(url, TWO)
        assert "cret" not in str(caught.value)
    for url in ("sqlite:///a/b@c.db", "pg://a@h:5432/d?x=1"):
        with refused(re.escape(url)):
            read_sql(url, TWO)


def test_types_of_other_databases_are_those_of_a_log():
    day = datetime.date(2026, 1, 2)
    for theirs, ours in ((Decimal("1.50"), 1.5), (uuid.UUID(int=7), str(uuid.UUID(int=7))), (memoryview(b"ab"), b"ab"),
                         (day, day)):  # fmt: skip
        assert _value(theirs) == ours
    assert isinstance(_value(Decimal(3)), int)


# Servers, and DuckDB.

PASSWORD = "open-sesame"
BINARIES = sorted(Path("/usr/lib/postgresql").glob("*/bin")) or [Path(shutil.which("initdb") or "/none").parent]
USER = "nobody" if os.name == "posix" and os.geteuid() == 0 else None
"""Who runs the server: PostgreSQL refuses to be run by root."""


def run_server(program, *words):
    folder = words[words.index("-D") + 1]
    subprocess.run(
        [BINARIES[-1] / program, *words], user=USER, cwd=folder, env={"LC_ALL": "C"}, check=True, capture_output=True
    )


@pytest.fixture(scope="module")
def server():
    """Address of a database of a server that listens at a socket in a folder of its own."""
    pytest.importorskip("psycopg")
    if not (BINARIES[-1] / "initdb").exists():
        pytest.skip("PostgreSQL is not installed")
    # Of its user, who must not enter the folders of the tests; the name of a socket is short.
    with tempfile.TemporaryDirectory(prefix="pg") as name:
        folder, data = Path(name), Path(name, "data")
        data.mkdir(mode=0o700)
        (folder / "password").write_text(PASSWORD)
        for path in (folder, data, folder / "password"):
            shutil.chown(path, USER or os.getuid())
        secret = ("--auth=scram-sha-256", f"--pwfile={folder / 'password'}")
        run_server("initdb", "-D", str(data), "-U", "cell", "-E", "UTF8", *secret)
        options = f"-c listen_addresses= -c unix_socket_directories={folder} -c fsync=off"
        run_server("pg_ctl", "-D", str(data), "-w", "-l", str(data / "log"), "-o", options, "start")
        try:
            yield f"postgresql+psycopg://cell:{PASSWORD}@/postgres?host={folder}"
        finally:
            run_server("pg_ctl", "-D", str(data), "-w", "-m", "immediate", "stop")


TYPES = {"int64": "bigint", "float64": "double precision", "object": "text", "str": "text"}


def fill(url):
    """Write the tables of a log in types of PostgreSQL: rewards are decimal numbers, lists are arrays."""
    import psycopg

    with psycopg.connect(url.replace("+psycopg", ""), autocommit=True) as connection:
        connection.execute("CREATE SEQUENCE numbers")
        for name, frame in small_tables().items():
            kinds = {column: TYPES[str(dtype)] for column, dtype in frame.dtypes.items()} | {"reward": "numeric(9, 2)"}
            is_list = {column: isinstance(frame[column].iloc[0], list) for column in frame}
            columns = [f"{column} {'float8[]' if is_list[column] else kinds[column]}" for column in frame]
            connection.execute(f"CREATE TABLE {name} ({', '.join(columns)})")
            rows = frame.astype(object).where(frame.notna(), None).values.tolist()
            places = ", ".join(["%s"] * frame.shape[1])
            connection.cursor().executemany(f"INSERT INTO {name} VALUES ({places})", rows)


@pytest.mark.slow
def test_a_log_in_postgresql_is_read_and_nothing_else_is_done_there(server):
    fill(server)
    assert_is_the_log(read_sql(server, ALL))
    for query, message in (
        ("WITH gone AS (DELETE FROM stages RETURNING *) SELECT * FROM gone", "must not contain data-modifying"),
        ("SELECT nextval('numbers')", "cannot execute nextval.* in a read-only transaction"),
        ("SELECT * FROM nowhere", 'relation "nowhere" does not exist'),
    ):
        with refused(f"stages: the database refuses .*{message}"):
            read_sql(server, Queries(query, ALL.trajectories))
    for wrong in (server.replace(PASSWORD, "hidden"), server.replace("/postgres?", "/nowhere?")):
        with refused("it cannot be reached or read") as caught:
            read_sql(wrong, TWO)
        assert "hidden" not in str(caught.value)
        assert PASSWORD not in str(caught.value)
    assert_is_the_log(read_sql(server, ALL))


def test_a_log_in_duckdb_is_read_and_nothing_is_written(tmp_path):
    duckdb = pytest.importorskip("duckdb")
    pytest.importorskip("duckdb_engine")
    file = tmp_path / "cell.duckdb"
    with duckdb.connect(str(file)) as connection:
        for name, frame in small_tables().items():
            connection.register("frame", frame)
            connection.execute(f"CREATE TABLE {name} AS SELECT * FROM frame")
    before = file.read_bytes()
    assert_is_the_log(read_sql(f"duckdb:///{file}", ALL))
    with refused("the database refuses .*read-only"):
        read_sql(f"duckdb:///{file}", Queries("WITH n AS (SELECT 1) DELETE FROM stages", ALL.trajectories))
    for nowhere, message in (("", "it names no file; give duckdb:///FILE"), (tmp_path / "none", "it cannot be read")):
        with refused(message):
            read_sql(f"duckdb:///{nowhere}", TWO)
    assert [path.name for path in tmp_path.iterdir()] == ["cell.duckdb"]
    assert file.read_bytes() == before
