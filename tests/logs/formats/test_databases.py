"""A log in PostgreSQL, by a server of our own, and in DuckDB, by the same door as in SQLite."""

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import pandas as pd
import pytest

from halfseen.logs import Logs
from halfseen.logs.formats import Queries, read_sql
from refusals import refused
from valid_logs import small_tables

ALL = Queries("SELECT * FROM stages", "SELECT * FROM trajectories", "SELECT * FROM objects")
TWO = Queries("SELECT * FROM stages", "SELECT * FROM trajectories")
PASSWORD = "open-sesame"
BINARIES = sorted(Path("/usr/lib/postgresql").glob("*/bin")) or [Path(shutil.which("initdb") or "/none").parent]
USER = "nobody" if os.name == "posix" and os.geteuid() == 0 else None
"""Who runs the server: PostgreSQL refuses to be run by root."""


def run(program, *words):
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
        run("initdb", "-D", str(data), "-U", "cell", "-E", "UTF8", *secret)
        options = f"-c listen_addresses= -c unix_socket_directories={folder} -c fsync=off"
        run("pg_ctl", "-D", str(data), "-w", "-l", str(data / "log"), "-o", options, "start")
        try:
            yield f"postgresql+psycopg://cell:{PASSWORD}@/postgres?host={folder}"
        finally:
            run("pg_ctl", "-D", str(data), "-w", "-m", "immediate", "stop")


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


def assert_is_the_log(logs):
    for name, table in Logs(**small_tables()).tables.items():
        pd.testing.assert_frame_equal(logs.tables[name], table)


@pytest.mark.slow
def test_a_log_in_postgresql_is_read_and_nothing_else_is_done_there(server):
    fill(server)
    assert_is_the_log(read_sql(server, ALL))
    for query, told in (
        ("WITH gone AS (DELETE FROM stages RETURNING *) SELECT * FROM gone", "must not contain data-modifying"),
        ("SELECT nextval('numbers')", "cannot execute nextval.* in a read-only transaction"),
        ("SELECT * FROM nowhere", 'relation "nowhere" does not exist'),
    ):
        with refused(f"stages: the database refuses .*{told}"):
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
    for nowhere, told in (("", "it names no file; give duckdb:///FILE"), (tmp_path / "none", "it cannot be read")):
        with refused(told):
            read_sql(f"duckdb:///{nowhere}", TWO)
    assert [path.name for path in tmp_path.iterdir()] == ["cell.duckdb"]
    assert file.read_bytes() == before
