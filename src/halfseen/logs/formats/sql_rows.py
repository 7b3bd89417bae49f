"""Logs as rows of a database that SQLAlchemy reaches: one SELECT per table of the log.

The columns are those of the CSV format. Text columns in which every cell is a JSON list are read as lists. The database
is only read: each SELECT runs in a transaction that is rolled back, and is read-only if the database supports that.
"""

import re
from collections.abc import Iterator
from contextlib import contextmanager
from decimal import Decimal
from pathlib import Path
from typing import Any
from urllib.parse import quote

import msgspec
import pyarrow as pa

from halfseen.errors import ArgumentError, HalfseenError, LogError, within
from halfseen.installation import extra
from halfseen.logs.columns import OWN_NAMES, refuse_repeated, shown
from halfseen.logs.formats.as_text import from_list_texts
from halfseen.logs.formats.mapping import Given, mapping_in
from halfseen.logs.formats.sqlite_file import check_sqlite
from halfseen.logs.logs import Logs
from halfseen.logs.missing import Missing
from halfseen.reading import TABLE, UNPACKED, check_file, reason_of

ROWS_AT_ONCE = 10_000
BYTES_OF_VALUE = 8
MOST_BYTES = UNPACKED
"""Largest size of the rows of one table [B]."""
_COMMENTS_AND_TEXT = re.compile(r"--[^\n]*|/\*.*?\*/|'(?:[^']|'')*'|\"(?:[^\"]|\"\")*\"", re.DOTALL)
_SELECTS = re.compile(r"\(*\s*(select|with|values|table)\b", re.IGNORECASE)
_SECRET = re.compile(r"(?i)((?:password|passwd|pwd|token|secret|key)[^=&;]*=)[^&;]*")
_OF_USER = re.compile(r"(?:(?<=://)|^)([^:/@]*):(?!//).*@", re.DOTALL)


class Queries(msgspec.Struct, **Given):
    """The queries for the tables of a log.

    Parameters
    ----------
    stages, trajectories, objects
        One SELECT each; None if the log has no objects.

    Raises
    ------
    ArgumentError
        A query has more than one statement, or is not a SELECT.
    """

    stages: str
    trajectories: str
    objects: str | None = None

    def __post_init__(self) -> None:
        for name, query in self.by_table.items():
            _refuse_other_than_select(name, query)

    @property
    def by_table(self) -> dict[str, str]:
        """The queries by the name of their table."""
        return {name: query for name, query in msgspec.structs.asdict(self).items() if query is not None}


def read_queries(file: str | Path) -> Queries:
    """Read a file (TOML) whose keys ``stages``, ``trajectories`` and, if there are any, ``objects`` are SELECTs.

    Raises
    ------
    ArgumentError
        The file is missing or not TOML, a key is missing or unknown, or a query is invalid.
    """
    return mapping_in(file, Queries, "give a SELECT for stages and trajectories, and objects if there are any")


def read_sql(url: str, queries: Queries, *, missing: Missing = None) -> Logs:
    """Read a log from a database.

    Parameters
    ----------
    url
        Address for SQLAlchemy: ``sqlite:///cell.db``, ``duckdb:///cell.duckdb``,
        ``postgresql+psycopg://user:password@host/cell``. The password is never shown.
    queries
        Queries for the stages, the trajectories and the objects.
    missing
        What replaces null in covariates of the stages, as in `Logs`.

    Raises
    ------
    ArgumentError
        SQLAlchemy or the driver is not installed, or the URL is invalid.
    LogError
        The database cannot be read, it refuses a query, or the rows violate an invariant.
    """
    place = shown_url(url)
    with _connected(url, place) as connection:
        tables = {name: _rows(connection, f"{place}, {name}", query) for name, query in queries.by_table.items()}
    with within(place):
        return Logs(**tables, missing=missing)


def read_rows(url: str, query: str) -> pa.Table:
    """Read the rows of one SELECT; the errors are those of `read_sql`."""
    place = shown_url(url)
    _refuse_other_than_select("query", query)
    with _connected(url, place) as connection:
        return _rows(connection, place, query)


def _refuse_other_than_select(name: str, query: str) -> None:
    bare = _COMMENTS_AND_TEXT.sub(" ", query).strip().rstrip(";")
    if ";" in bare or not _SELECTS.match(bare):
        raise ArgumentError(f"{name} {shown(query)}: it is not a single SELECT; no other statement is run")


def shown_url(url: str) -> str:
    """A URL without its password."""
    head, question, options = _OF_USER.sub(r"\1:***@", url).partition("?")
    return head + question + _SECRET.sub(r"\1***", options)


@contextmanager
def _connected(url: str, place: str) -> Iterator[Any]:
    sqlalchemy = extra("sqlalchemy", "sql")
    try:
        parsed = sqlalchemy.make_url(url)
        engine = _engine(sqlalchemy, parsed)
    except HalfseenError:
        raise
    except ModuleNotFoundError as error:
        raise ArgumentError(
            f"{place}: its driver {error.name} is not installed; run: pip install {error.name}"
        ) from None
    except sqlalchemy.exc.NoSuchModuleError:
        kind = url.partition(":")[0][:40]
        raise ArgumentError(f"{place}: {kind!r} is not an installed database dialect; install it") from None
    except OSError as error:
        raise LogError(f"{place}: it cannot be read ({reason_of(error)}); give the file of a database") from error
    except Exception:  # its text may contain the password
        raise ArgumentError(
            f"{place}: it is no database address; give sqlite:///FILE or DIALECT://USER:PASSWORD@HOST/NAME"
        ) from None
    try:
        with engine.connect() as connection:
            options = {"postgresql_readonly": True} if engine.dialect.name == "postgresql" else {}
            connection = connection.execution_options(no_parameters=True, stream_results=True, **options)
            if engine.dialect.name in ("mysql", "mariadb"):
                connection.exec_driver_sql("SET SESSION TRANSACTION READ ONLY")
            yield connection
            connection.rollback()
    except (HalfseenError, MemoryError):
        raise
    except Exception as error:  # drivers raise nearly anything
        raise LogError(f"{place}: it cannot be reached or read ({_reason(error, parsed)}); check the address") from None
    finally:
        engine.dispose()


def _engine(sqlalchemy: Any, url: Any) -> Any:
    kind = url.get_backend_name()
    if kind == "duckdb":
        _check_file_of(url)
        return sqlalchemy.create_engine(url, connect_args={"read_only": True})
    if kind != "sqlite" or url.get_driver_name() != "pysqlite":
        return sqlalchemy.create_engine(url)
    import sqlite3

    address = f"file:{quote(str(_check_file_of(url).absolute()))}?mode=ro"
    return sqlalchemy.create_engine(
        url.set(database=None, query={}), creator=lambda: sqlite3.connect(address, uri=True)
    )


def _check_file_of(url: Any) -> Path:
    """The file of a file-based database, checked to be readable: connecting to a missing one would create it."""
    file = Path(url.database or "")
    if not url.database or str(file).startswith((":memory:", "file:")):
        raise ArgumentError(f"{shown_url(str(url))}: it names no file; give {url.get_backend_name()}:///FILE")
    check_file(file, TABLE)
    try:
        check_sqlite(file)
    except ValueError as error:
        raise LogError(f"{shown_url(str(url))}: {error}; copy it again, once nobody writes to it") from error
    return file


def _rows(connection: Any, place: str, query: str) -> pa.Table:
    try:
        result = connection.exec_driver_sql(query.strip().rstrip(";"))
        names = list(map(str, result.keys()))
        refuse_repeated(place, names, "rename one (AS)")
        cells: list[list[Any]] = [[] for _ in names]
        num_bytes = 0
        for rows in result.partitions(ROWS_AT_ONCE):
            for column, values in zip(cells, zip(*rows, strict=True), strict=True):
                column.extend(values)
                num_bytes += sum(len(v) if isinstance(v, str | bytes) else BYTES_OF_VALUE for v in values)
            if num_bytes > MOST_BYTES:
                raise LogError(
                    f"{place}: {shown(query)} returns more than {MOST_BYTES / 1e6:,.0f} MB; select fewer rows"
                )
    except (HalfseenError, MemoryError):
        raise
    except Exception as error:  # drivers raise nearly anything
        raise LogError(f"{place}: the database refuses {shown(query)} ({_reason(error)}); fix the query") from None
    return pa.table({name: _column(place, name, values) for name, values in zip(names, cells, strict=True)})


def _column(place: str, name: str, values: list[Any]) -> Any:
    plain = [_value(value) for value in values]
    try:
        column = pa.array(plain)
    except (pa.ArrowException, ValueError, TypeError, OverflowError) as error:
        kinds = ", ".join(sorted({type(value).__name__ for value in plain if value is not None}))
        does = "mixes" if "," in kinds else "cannot hold its"
        raise LogError(
            f"{place}: column {shown(name)} {does} {kinds} ({reason_of(error)}); give it one type (CAST)"
        ) from error
    lists = None if name in OWN_NAMES else from_list_texts(column)
    return column if lists is None else lists


def _value(value: Any) -> Any:
    """Convert a database value for a log: decimals to numbers, identifiers to text."""
    if isinstance(value, Decimal):
        return int(value) if value == value.to_integral_value() and value.as_tuple().exponent == 0 else float(value)
    if isinstance(value, memoryview):
        return bytes(value)
    return str(value) if type(value).__name__ == "UUID" else value


def _reason(error: Exception, url: Any = None) -> str:
    """The message of a driver, in one line and without the password."""
    reason = reason_of(getattr(error, "orig", None) or error)
    secret = None if url is None else url.password
    return reason.replace(str(secret), "***") if secret else reason
