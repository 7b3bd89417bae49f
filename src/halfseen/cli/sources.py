"""Sources of ``halfseen convert``: their kinds, the options of each kind, and how they are read."""

import re
import shlex
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from halfseen.cli.options import word
from halfseen.errors import ArgumentError, LogError
from halfseen.progress import Progress
from halfseen.suggestions import as_counted

if TYPE_CHECKING:
    import numpy as np

    from halfseen.logs import Logs

MINARI, SQL = "minari:", "sql:"
STEPS = ("lerobot", "steps", "hdf5")
KINDS_OF = {
    "mapping": ("bag", "sql", "events"),
    **dict.fromkeys(("clouds", "see"), ("bag",)),
    **dict.fromkeys(("stages", "trajectories", "objects"), ("sql",)),
    **dict.fromkeys(("action", "reward", "done"), STEPS),
    **dict.fromkeys(("clock", "step_s", "truncated"), ("minari", *STEPS)),
}
"""Kinds of sources that take each option."""


class Reading(NamedTuple):
    """Options that some kinds of sources take.

    Parameters
    ----------
    mapping
        What holds what (TOML): for a bag, topics; for a table, columns; for sql, SELECTs.
    clouds
        For a bag: folder to write each stage's cloud to, as .pcd.
    see
        For a bag: take as objects of each stage what its cloud shows.
    stages
        For sql: the stages, with the columns of a log.
    trajectories
        For sql: the trajectories.
    objects
        For sql: the objects, if there are any.
    action
        For datasets of steps: the column that holds the action.
    reward
        For datasets of steps: the column that holds the reward.
    done
        For datasets of steps: the column that is true where an episode terminated.
    clock
        For datasets of steps: the column (Minari: the info) that holds the time [s].
    step_s
        For datasets of steps: how long a step lasts [s].
    truncated
        For datasets of steps: how an episode ended that did not terminate; by default cut.
    """

    mapping: Path | None = None
    clouds: Path | None = None
    see: bool = False
    stages: Annotated[str | None, {"metavar": "SELECT"}] = None
    trajectories: Annotated[str | None, {"metavar": "SELECT"}] = None
    objects: Annotated[str | None, {"metavar": "SELECT"}] = None
    action: Annotated[str | None, {"metavar": "NAME"}] = None
    reward: Annotated[str | None, {"metavar": "NAME"}] = None
    done: Annotated[str | None, {"metavar": "NAME"}] = None
    clock: Annotated[str | None, {"metavar": "NAME"}] = None
    step_s: float | None = None
    truncated: Annotated[str | None, word("cut", "finished")] = None


def kind_of(source: str, is_mapped: bool = False) -> str:
    """Kind of a source, by its content; an object store holds Parquet logs only.

    Parameters
    ----------
    is_mapped
        Whether there is a mapping, so that a table holds events, not steps.
    """
    from halfseen.logs.folder import is_remote, place_of, refuse_no_folder
    from halfseen.logs.formats import is_older
    from halfseen.logs.formats.table_cells import is_event_table

    path = Path(source)
    if source.startswith(SQL):
        return "sql"
    if source.startswith(MINARI) or (path / "data" / "metadata.json").is_file():
        return "minari"
    if re.match(r"(sqlite|duckdb|postgresql|mysql|mariadb)(\+\w+)?://", source):
        raise ArgumentError(f"a database is given as {SQL}{source.partition(':')[0]}://…; put {SQL} before the address")
    if is_remote(source):
        return "older" if is_older(place_of(source)) else "parquet"
    if not path.exists():
        raise LogError(
            f"{source}: no such file or folder; give a Minari dataset as {MINARI}NAME-v0, a database as {SQL}URL"
        )
    if (path / "meta" / "info.json").exists():
        return "lerobot"
    if is_older(path):
        return "older"
    if (path / "stages.csv").exists() or (path / "trajectories.csv").exists():
        return "csv"
    if not path.is_dir() and path.suffix in (".h5", ".hdf5"):
        return "hdf5"
    tables = tables_of_events(path) if is_mapped or path.is_file() else _step_files(path)
    if tables and is_event_table(tables[0], is_mapped):
        return "events"
    if _step_files(path):
        return "steps"
    if _bags(path):
        return "bag"
    refuse_no_folder(path)
    if is_mapped and not (path / "logs.json").exists():
        raise LogError(f"{source}: it holds no tables or bags itself; give a folder of .csv, .tsv or .parquet files")
    return "parquet"


def _step_files(path: Path) -> list[Path]:
    """Files of a step table: the path itself, or those in a folder that is not a log."""
    from halfseen.logs.formats.step_tables import TABLE_FILES

    if not path.is_dir():
        return [path] if path.suffix.lower() in TABLE_FILES else []
    files = _shown_files(path, TABLE_FILES)
    return [] if any(file.stem in ("stages", "trajectories", "objects") for file in files) else files


def tables_of_events(path: Path) -> list[Path]:
    """A table, or the tables of a folder without logs and bags."""
    if path.is_file():
        return [path]
    from halfseen.logs.folder import FOREIGN_TABLES

    if _bags(path) or (path / "logs.json").exists():
        return []
    tables = _shown_files(path, tuple(end for end in FOREIGN_TABLES if ".txt" not in end))
    return tables or _shown_files(path, (".txt", ".txt.gz"))


def _shown_files(folder: Path, suffixes: tuple[str, ...]) -> list[Path]:
    """Files of a folder, and of those in it that are named after a value (``run=7``), by the end of their names.

    They are in order, without hidden ones and locks of open workbooks.
    """
    entries = sorted((entry for entry in folder.iterdir() if not entry.name.startswith((".", "~$"))), key=_by_name)
    there = [entry for entry in entries if entry.name.lower().endswith(suffixes)]
    parts = [entry for entry in entries if "=" in entry.name and entry.is_dir()]
    return there + [file for part in parts for file in _shown_files(part, suffixes)]


def _by_name(file: Path) -> tuple[Any, str]:
    return as_counted(file.name), file.name


def _bags(path: Path) -> list[Path]:
    """Bags of a path: the path itself, or those in its folder."""
    if _is_bag(path):
        return [path]
    return sorted((entry for entry in path.iterdir() if _is_bag(entry)), key=_by_name) if path.is_dir() else []


def _is_bag(path: Path) -> bool:
    if path.is_dir():
        return (path / "metadata.yaml").exists() or any(file.suffix == ".db3" for file in path.iterdir())
    return path.suffix in (".mcap", ".db3", ".bag")


def read(kind: str, source: str, how: Reading, missing: str | None = None) -> "Logs":
    """Read the logs of a source.

    Parameters
    ----------
    kind, source, how
        Its kind, its location, and its options.
    missing
        "keep" to allow null covariates, for kinds of sources that support them; otherwise they are refused.

    Raises
    ------
    HalfseenError
        It cannot be read, or not with these options.
    """
    from halfseen.logs import formats, read_logs
    from halfseen.logs.folder import place_of

    timed: Any = {"clock": how.clock, "step_s": how.step_s, "truncated": how.truncated or "cut"}
    rules = formats.StepRules(how.action, how.reward, how.done, **timed)
    readers: dict[str, Callable[[], Logs]] = {
        "parquet": lambda: read_logs(source, missing=missing),
        "csv": lambda: formats.read_csv(source, missing=missing),
        "older": lambda: formats.read_older(place_of(source)),
        "bag": lambda: _read_bags(_bags(Path(source)), how, missing),
        "sql": lambda: _read_sql(source.removeprefix(SQL), how, missing),
        "minari": lambda: formats.read_minari(source.removeprefix(MINARI), **timed, missing=missing),
        "lerobot": lambda: formats.read_lerobot(source, rules, missing=missing),
        "hdf5": lambda: formats.read_step_arrays(source, rules, missing=missing),
        "steps": lambda: formats.read_steps(_step_files(Path(source)), rules, missing=missing),
        "events": lambda: _read_events(source, how, missing),
    }
    return readers[kind]()


def _read_sql(url: str, how: Reading, missing: str | None) -> "Logs":
    """Read a database by queries from options or from a file."""
    from halfseen.logs.formats import Queries, read_event_mapping, read_event_table, read_queries, read_sql
    from halfseen.logs.formats.sql_rows import read_rows, shown_url
    from halfseen.logs.formats.table_mapping import is_event_mapping

    if how.mapping is not None:
        if (how.stages, how.trajectories, how.objects) != (None, None, None):
            raise ArgumentError(
                f"--mapping {how.mapping}: it replaces --stages, --trajectories and --objects; leave these out"
            )
        if is_event_mapping(how.mapping):
            mapping = read_event_mapping(how.mapping)
            query = mapping.table.query
            takes = f"since = {mapping.clock.since!r}" if mapping.takes_order else "fill_down"
            has_order = "order by" in " ".join((query or "").lower().split())
            if query is not None and not has_order and (mapping.takes_order or mapping.table.fill_down):
                trouble = f"{takes} takes the order of rows, which a database does not keep"
                raise ArgumentError(f"{how.mapping}, table.query: {trouble}; add ORDER BY")
            if query is None:
                raise ArgumentError(f"{how.mapping}, table.query: it is missing; give the SELECT that returns the rows")
            return read_event_table(read_rows(url, query), how.mapping, place=shown_url(url), missing=missing)
        return read_sql(url, read_queries(how.mapping), missing=missing)
    if how.stages is None or how.trajectories is None:
        raise ArgumentError(
            "a database needs --stages and --trajectories, a SELECT each, or a --mapping FILE that has both"
        )
    return read_sql(url, Queries(how.stages, how.trajectories, how.objects), missing=missing)


def _read_events(source: str, how: Reading, missing: str | None) -> "Logs":
    """Read a table with arbitrary columns by a mapping."""
    from halfseen.logs.formats import read_event_table
    from halfseen.logs.formats.table_cells import refuse_workbook

    refuse_workbook(Path(source))
    if how.mapping is None:
        raise ArgumentError(
            f"{source}: it is not a table of steps (.csv, .parquet or .arrow with a column is_last), and others need "
            f"--mapping; make a template: halfseen convert {shlex.quote(source)} --mapping-template --out cell.toml"
        )
    tables = tables_of_events(Path(source)) if Path(source).is_dir() else source
    return read_event_table(tables, how.mapping, missing=missing)


def _read_bags(bags: list[Path], how: Reading, missing: str | None) -> "Logs":
    """Read bags; on request, detect the objects of each stage's cloud, and write the clouds to a folder."""
    from halfseen.logs.formats import read_bag

    if how.mapping is None:
        raise ArgumentError(
            "a bag needs --mapping FILE, which says what its topics carry; --mapping-template prints one to start from"
        )
    with Progress(None, "convert", "clouds") as bar:

        def counted(work: Callable[..., Any]) -> Callable[..., Any]:
            def count(*cloud: Any) -> Any:
                bar.update()
                return work(*cloud)

            return count

        keep = None if how.clouds is None else counted(partial(_kept, how.clouds))
        return read_bag(bags, how.mapping, see=counted(_see) if how.see else None, keep=keep, missing=missing)


def _kept(folder: Path, points_m: "np.ndarray", shape: tuple[int, int], name: str) -> str:
    """Write a cloud to a file of the same name."""
    from halfseen.perception import Cloud, write_pcd

    write_pcd(Cloud(points_m, shape if shape[0] > 1 else None, name=name), folder / f"{name}.pcd")
    return f"{name}.pcd"


def _see(points_m: "np.ndarray", shape: tuple[int, int], name: str) -> dict[str, list[Any]]:
    """Objects in a cloud, as columns; numbered within each cloud, the largest first."""
    import numpy as np

    from halfseen.perception import Cloud, perceive

    view = perceive(Cloud(points_m, shape if shape[0] > 1 else None, name=name))
    centroids = np.array([seen.centroid_m for seen in view.objects]).reshape(-1, 3)
    return {
        "object": [seen.id for seen in view.objects],
        "occlusion": [seen.occlusion for seen in view.objects],
        **{f"{axis}_m": centroids[:, k].tolist() for k, axis in enumerate("xyz")},
        "height_m": [seen.height_m for seen in view.objects],
        "is_upright": [seen.is_upright for seen in view.objects],
        "num_points": [seen.num_points for seen in view.objects],
        "hidden_by": view.hides.tolist(),
    }
