import datetime
import os
import sqlite3
from pathlib import Path

import pandas as pd
import pytest

from halfseen.errors import HalfseenError
from halfseen.logs import Logs
from halfseen.logs.formats import Queries, read_queries, read_sql
from halfseen.logs.formats.sql_rows import shown_url
from valid_logs import small_tables

ALL = Queries("SELECT * FROM stages", "SELECT * FROM paths", "SELECT * FROM objects")
TWO = Queries("SELECT * FROM stages", "SELECT * FROM paths")


@pytest.fixture
def database(tmp_path):
    """The tables of a log, written row by row."""
    tables = small_tables()
    with sqlite3.connect(tmp_path / "cell.db") as connection:
        for name, frame in tables.items():
            connection.execute(f"CREATE TABLE {name} ({', '.join(frame)})")
            for row in frame.astype(object).where(frame.notna(), None).itertuples(index=False):
                cells = [str(cell) if isinstance(cell, list) else cell for cell in row]
                connection.execute(f"INSERT INTO {name} VALUES ({', '.join('?' * len(cells))})", cells)
    connection.close()
    return f"sqlite:///{tmp_path / 'cell.db'}"


def run(database, *statements):
    with sqlite3.connect(database.removeprefix("sqlite:///")) as connection:
        for statement in statements:
            connection.execute(statement)
    connection.close()


def test_rows_are_the_log_that_was_written(database):
    wanted = Logs(**small_tables())
    logs = read_sql(database, ALL)
    for name, table in wanted.tables.items():
        pd.testing.assert_frame_equal(logs.tables[name], table)


def test_queries_may_name_filter_and_compute(database):
    run(database, "ALTER TABLE stages RENAME COLUMN steps_to_go TO togo")
    stages = """/* all; but one */ WITH s AS (SELECT * FROM stages WHERE path < 3)
        SELECT path, stage, elapsed_s, action, reward, togo * 2 AS x FROM s;"""
    # Percent signs and colons are no parameters.
    paths = """SELECT path, end_s, ending, cause, 'a; b 100 % :x' AS note FROM paths
        WHERE path < 3 AND ending LIKE '%' AND ':y' <> '' -- and no more"""
    logs = read_sql(database, Queries(stages, paths))
    assert logs.num_paths == 2
    assert logs.stages["x"].tolist() == [20, 18, 20, 18]
    assert logs.paths["note"].tolist() == ["a; b 100 % :x"] * 2


def test_whole_numbers_with_null_and_beyond_fractions_stay(database):
    run(database, "ALTER TABLE paths ADD COLUMN serial", f"UPDATE paths SET serial = {2**60 + 1} WHERE path > 1")
    assert read_sql(database, TWO).paths["serial"].tolist()[1:] == [2**60 + 1] * 2


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
        with pytest.raises(HalfseenError, match="is not one SELECT"):
            Queries(query, "SELECT 1")
    with pytest.raises(HalfseenError):
        read_sql(database, Queries("WITH x AS (SELECT 1) DELETE FROM stages", TWO.paths))
    assert file.read_bytes() == before
    assert os.listdir(file.parent) == ["cell.db"]


@pytest.mark.parametrize(
    ("stages", "told"),
    [
        ("SELECT * FROM stage", r"cell\.db, stages: the database refuses 'SELECT \* FROM stage' \(no such table"),
        ("SELECT FROM stages", r"the database refuses .*syntax error"),
        ("SELECT path, stage FROM stages", r"cell\.db: stages: there is no column 'elapsed_s'"),
        ("SELECT *, path FROM stages", r"stages: there are two columns 'path'"),
        ("SELECT path, stage, elapsed_s, action, reward, CASE stage WHEN 1 THEN 'a' ELSE 2 END AS x FROM stages",
         r"stages: column 'x' mixes int, str .*give it one type \(CAST\)"),
        ("SELECT * FROM stages WHERE path = 1", r"path 2: it has no stage"),
        ("SELECT path, stage, elapsed_s, action, reward, 9e999 AS x FROM stages", r"covariate x is inf"),
        ("SELECT path, stage, elapsed_s, action, NULL AS reward FROM stages", r"its reward is nan"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told_in_one_line(database, stages, told):
    with pytest.raises(HalfseenError, match=told) as caught:
        read_sql(database, Queries(stages, TWO.paths))
    assert "\n" not in str(caught.value)


def test_rows_without_end_are_refused(database, monkeypatch):
    monkeypatch.setattr("halfseen.logs.formats.sql_rows.ROWS_AT_ONCE", 1000)
    monkeypatch.setattr("halfseen.logs.formats.sql_rows.MOST_BYTES", 10**5)
    endless = "WITH RECURSIVE n(k) AS (SELECT 1 UNION ALL SELECT k + 1 FROM n) SELECT k AS path FROM n"
    with pytest.raises(HalfseenError, match=r"stages: .* gives more than 0 MB"):
        read_sql(database, Queries(endless, TWO.paths))


@pytest.mark.parametrize(
    ("url", "told"),
    [
        ("nowhere", "it is no address of a database; give DIALECT://"),
        ("sqlite://", "it names no file"),
        ("sqlite:///:memory:", "it names no file"),
        ("sqlite:///none.db", r"sqlite:///none\.db: it cannot be read"),
        ("nosql://me:hidden@host/cell", r"nosql://me:\*\*\*@host/cell: 'nosql' is no kind of database"),
        ("postgresql+nodriver://me:hidden@host/cell", r"'postgresql\+nodriver' is no kind of database"),
        ("mysql+pymysql://me:hidden@host/cell", r"its driver pymysql is not installed; run: pip install pymysql"),
        ("postgresql://me:hidden@host:port/cell", r"postgresql://me:\*\*\*@host:port/cell: it is no address"),
        ("postgresql://me:hid/den@x@host/cell", r"postgresql://me:\*\*\*@host/cell: "),
        ("mysql+pymysql://me@host/cell?password=hidden", r"me@host/cell\?password=\*\*\*: "),
    ],
)
def test_an_address_that_leads_nowhere_is_told_without_its_password(url, told):
    with pytest.raises(HalfseenError, match=told) as caught:
        read_sql(url, TWO)
    assert "hid" not in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_is_no_database_is_refused(tmp_path):
    (tmp_path / "a.db").write_bytes(b"no database" * 100)
    os.mkfifo(tmp_path / "pipe.db")
    for name, told in (("a.db", "file is not a database"), ("pipe.db", "it is a pipe"), (".", "it is a folder")):
        with pytest.raises(HalfseenError, match=told):
            read_sql(f"sqlite:///{tmp_path / name}", TWO)


@pytest.mark.parametrize(
    ("content", "told"),
    [
        ('stages = "SELECT 1"', "paths: it is missing"),
        ("stages = 1\npaths = 2", "stages: 1 is no text"),
        ('stages = "DROP x"\npaths = "SELECT 1"', "stages 'DROP x': it is not one SELECT"),
        ('other = "SELECT 1"', "other: it is unknown; there are stages, paths, objects"),
        ("stages =", "it is no TOML"),
    ],
)
def test_queries_come_from_a_file(tmp_path, content, told):
    file = tmp_path / "cell.toml"
    file.write_text('stages = "SELECT 1"\npaths = "SELECT 2"\nobjects = "SELECT 3"\n')
    assert read_queries(file) == Queries("SELECT 1", "SELECT 2", "SELECT 3")
    file.write_text(content)
    with pytest.raises(HalfseenError, match=rf"cell\.toml.*{told}"):
        read_queries(file)
    with pytest.raises(HalfseenError, match="it cannot be read"):
        read_queries(tmp_path / "none.toml")


def test_secrets_are_never_shown():
    places = "a:se:cret@h/d a:se/cret@h/d a:se@cret@h/d :secret@h h/d?passwd=secret&x=1 h?sslpassword=secret"
    for url in [*(f"pg://{place}" for place in places.split()), "a:secret@h"]:
        assert "cret" not in shown_url(url)
    for url in ("sqlite:///a/b@c.db", "pg://a@h:5432/d?x=1"):
        assert shown_url(url) == url


def test_types_of_other_databases_are_those_of_a_log():
    import uuid
    from decimal import Decimal

    from halfseen.logs.formats.sql_rows import _value

    assert _value(Decimal("1.50")) == 1.5
    assert isinstance(_value(Decimal(3)), int)
    assert _value(uuid.UUID(int=7)) == "00000000-0000-0000-0000-000000000007"
    assert _value(memoryview(b"ab")) == b"ab"
    assert _value(datetime.date(2026, 1, 2)) == datetime.date(2026, 1, 2)
