"""``halfseen convert``: logs from one form into another."""

import json
import os
import sys
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import asdict
from functools import partial
from itertools import permutations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from halfseen.cli import options
from halfseen.cli.messages import say
from halfseen.progress import Progress

if TYPE_CHECKING:
    import numpy as np

    from halfseen.logs import Logs

CSV, MINARI, SQL = "csv:", "minari:", "sql:"
OPTIONS_OF = {
    ("mapping",): ("bag", "sql"),
    ("clouds", "see"): ("bag",),
    ("stages", "trajectories", "objects"): ("sql",),
    ("action", "reward", "done"): ("lerobot", "steps", "hdf5"),
    ("clock", "step_s", "truncated"): ("minari", "lerobot", "steps", "hdf5"),
}
"""Which kinds of sources take an option."""
STEPS = "Of others' steps:"


def _print_template(ctx: click.Context, _: click.Parameter, is_asked: bool) -> None:
    if not is_asked or ctx.resilient_parsing:
        return
    from halfseen.logs.formats import MAPPING_TEMPLATE

    click.echo(MAPPING_TEMPLATE, nl=False)
    ctx.exit()


HELP = """Read the logs of SOURCE and write them to another form, all or nothing.

\b
FOLDER              logs, as Parquet or CSV; those of an older halfseen are brought up to date
BAG                 ROS 1 or 2, or MCAP with ROS 2, JSON or protobuf (or a folder of bags)
minari:NAME-v0      a Minari dataset, also by its folder
FOLDER of LeRobot   a dataset of its version 3
TABLE               steps as of RLDS: .parquet, .csv or .arrow (or a folder of them)
FILE.hdf5           steps as of D4RL
sql:URL             rows of a database, as SQLAlchemy reaches it

Several folders of logs, such as those of many recorders, become one of Parquet files; trajectories that are still being
recorded are left out.
"""


@click.command(help=HELP, epilog="Example: halfseen convert recording.mcap --mapping cell.toml --out logs")
@click.argument("sources", metavar="SOURCE...", nargs=-1, required=True)
@click.option("--out", "target", required=True, help="FOLDER of Parquet, csv:FOLDER, or minari:NAME-v0.")
@options.flag("--check", "is_check", told="Only say what --out cannot hold; status 1 if anything is lost.")
@options.path("--mapping", told="Of a bag: which topic carries what; of sql: the SELECTs (TOML).")
@click.option(
    "--mapping-template",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=_print_template,
    help="Print a mapping file to start from.",
)
@options.path("--clouds", told="Of a bag: write each stage's cloud there as .pcd.")
@options.flag("--see", told="Of a bag: what each stage's cloud shows becomes its objects.")
@click.option("--stages", metavar="SELECT", help="Of sql: the rows that are the stages, by the columns of a log.")
@click.option("--trajectories", metavar="SELECT", help="Of sql: the rows that are the trajectories.")
@click.option("--objects", metavar="SELECT", help="Of sql: the rows that are the objects, if there are any.")
@click.option("--action", metavar="NAME", help=f"{STEPS} the column that holds the action.")
@click.option("--reward", metavar="NAME", help=f"{STEPS} the column that holds the reward.")
@click.option("--done", metavar="NAME", help=f"{STEPS} the column that is true where an episode terminated.")
@click.option("--clock", metavar="NAME", help=f"{STEPS} the column (Minari: the info) that holds the time [s].")
@click.option("--step-s", type=float, help=f"{STEPS} how long a step lasts [s].")
@options.word(
    "--truncated",
    of=["cut", "finished"],
    told=f"{STEPS} what an episode is that did not terminate; by default cut.",
)
@options.unused_seed
@options.as_json
def convert(
    sources: tuple[str, ...], target: str, is_check: bool, seed: int, as_json: bool, clouds: Path | None, **chosen: Any
) -> None:
    """Read the logs of SOURCE and write them to another form."""
    from halfseen.writing import placed, refuse_taken

    if len(sources) > 1:
        _check_options("parquet", {**chosen, "clouds": clouds})
        _compact(sources, target, is_check, as_json)
        return
    source = next(iter(sources))
    kind = _kind(source)
    _check_options(kind, {**chosen, "clouds": clouds})
    place = Path(target.removeprefix(CSV))
    if not target.startswith(MINARI):
        refuse_taken(place, False, None, "logs")
        _refuse_one_in_another(place, clouds)
    # The folder of clouds appears only once the logs are written too.
    with _noted() as warned, nullcontext() if clouds is None or is_check else placed(clouds) as cloud_folder:
        logs = _read(kind, source, cloud_folder, **chosen)
        if not is_check:
            _write(logs, target)
    report = {"source": _shown(source), "format": kind, "target": target, "sentence": str(logs.summary())}
    report |= asdict(logs.summary()) | _kept_and_lost(logs, target) | {"warnings": warned}
    say(json.dumps(report, indent=2) if as_json else "\n".join(_lines(report, is_check)))
    if is_check and report["losses"]:
        sys.exit(1)


@contextmanager
def _noted() -> Iterator[list[str]]:
    """Keep the warnings that are meant for users, too, for whoever reads the answer alone."""
    from halfseen.errors import HalfseenWarning

    usual, noted = warnings.showwarning, []

    def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        if issubclass(category, HalfseenWarning):
            noted.append(str(message))
        usual(message, category, *where, **more)

    warnings.showwarning = show
    try:
        yield noted
    finally:
        warnings.showwarning = usual


def _kept_and_lost(logs: "Logs", target: str) -> dict[str, Any]:
    """What does not come back from a target, and what nobody but halfseen finds in it."""
    from halfseen.logs.formats import losses, seen_by_halfseen_alone

    form = "csv" if target.startswith(CSV) else "minari" if target.startswith(MINARI) else "parquet"
    lost = losses(logs, form)
    has_notes = form == "minari" and not any(loss.is_refused for loss in lost)
    return {
        "losses": [{**asdict(loss), "sentence": str(loss)} for loss in lost],
        "for_halfseen_alone": seen_by_halfseen_alone(logs) if has_notes else [],
    }


def _lines(report: dict[str, Any], is_check: bool) -> list[str]:
    """Write a report for people."""
    lost = [f"- {loss['sentence']}" for loss in report["losses"]]
    hidden = report["for_halfseen_alone"]
    lines = [f"{report['target']}: {report['sentence']}"]
    lines += ["It would not be written whole:" if is_check else "What is lost:", *lost] if lost else []
    lines += ["Nothing would be lost."] if is_check and not lost else []
    return lines + ([f"Kept as notes that halfseen alone reads: {', '.join(hidden)}."] if hidden else [])


def _refuse_one_in_another(out: Path, clouds: Path | None) -> None:
    """Refuse folders of which one would lie in the other, or take its place."""
    from halfseen.errors import ArgumentError

    if clouds is None:
        return
    places = [Path(os.path.realpath(place)) for place in (out, clouds)]
    if any(one == other or one in other.parents for one, other in permutations(places)):
        raise ArgumentError(f"--clouds {clouds}: it is --out, or one lies in the other; give each a folder of its own")


def _compact(sources: tuple[str, ...], target: str, is_check: bool, as_json: bool) -> None:
    from halfseen.errors import ArgumentError
    from halfseen.logs import compact

    if is_check:
        raise ArgumentError("--check is for one SOURCE; several folders become one of Parquet files, which holds them")
    if target.startswith((CSV, MINARI)):
        raise ArgumentError(f"--out is {target}; several folders become one of Parquet files: give a FOLDER")
    with Progress(2 * len(sources), "convert", "folders") as bar:
        done = compact(sources, target, on_progress=bar.update)
    words = f"{done.num_trajectories} trajectories with {done.num_stages} stages from {done.num_folders} folders"
    words += f"; {done.num_running} still being recorded left out" if done.num_running else ""
    report = {"sources": list(sources), "target": target, "sentence": words, **done._asdict()}
    say(json.dumps(report, indent=2) if as_json else f"{target}: {words}")


def _kind(source: str) -> str:
    """What a source is, by what stands there; in an object store there is one form alone."""
    from halfseen.errors import LogError
    from halfseen.logs.folder import is_remote, place_of
    from halfseen.logs.formats import is_older

    path = Path(source)
    if source.startswith(SQL):
        return "sql"
    if source.startswith(MINARI) or (path / "data" / "metadata.json").is_file():
        return "minari"
    if is_remote(source):
        return "older" if is_older(place_of(source)) else "parquet"
    if not path.exists():
        raise LogError(
            f"{source}: there is no such file or folder; a Minari dataset is called {MINARI}NAME-v0, and a database "
            f"{SQL}URL"
        )
    if (path / "meta" / "info.json").exists():
        return "lerobot"
    if is_older(path):
        return "older"
    if (path / "stages.csv").exists() or (path / "trajectories.csv").exists():
        return "csv"
    if not path.is_dir() and path.suffix in (".h5", ".hdf5"):
        return "hdf5"
    if _step_files(path):
        return "steps"
    return "bag" if _bags(path) else "parquet"


def _step_files(path: Path) -> list[Path]:
    """The files of a step table: itself, or those that lie in a folder that is no log."""
    from halfseen.logs.formats.step_tables import TABLE_FILES

    if not path.is_dir():
        return [path] if path.suffix in TABLE_FILES else []
    files = sorted(file for file in path.iterdir() if file.suffix in TABLE_FILES)
    return [] if any(file.stem in ("stages", "trajectories", "objects") for file in files) else files


def _bags(path: Path) -> list[Path]:
    """The bags of a path: itself, or those that lie in it side by side."""
    if _is_bag(path):
        return [path]
    return sorted(entry for entry in path.iterdir() if _is_bag(entry)) if path.is_dir() else []


def _is_bag(path: Path) -> bool:
    if path.is_dir():
        return (path / "metadata.yaml").exists() or any(file.suffix == ".db3" for file in path.iterdir())
    return path.suffix in (".mcap", ".db3", ".bag")


def _check_options(kind: str, chosen: Mapping[str, Any]) -> None:
    from halfseen.errors import ArgumentError

    for names, owners in OPTIONS_OF.items():
        for name in names:
            is_given = chosen[name] is not None and chosen[name] is not False
            if is_given and kind not in owners:
                kinds = " or ".join(filter(None, [", ".join(owners[:-1]), owners[-1]]))
                raise ArgumentError(
                    f"--{name.replace('_', '-')} is for a source of kind {kinds}; this is {kind}: leave it out"
                )
    if kind == "bag" and chosen["mapping"] is None:
        raise ArgumentError(
            "a bag needs --mapping FILE, which says what its topics carry; --mapping-template prints one to start from"
        )


def _read(kind: str, source: str, clouds: Path | None, **chosen: Any) -> "Logs":
    from halfseen.logs import formats, read_logs
    from halfseen.logs.folder import place_of

    timed: dict[str, Any] = {"clock": chosen["clock"], "step_s": chosen["step_s"]}
    timed["truncated"] = chosen["truncated"] or "cut"
    named = {name: chosen[name] for name in ("action", "reward", "done")}
    readers: dict[str, Callable[[], Logs]] = {
        "parquet": lambda: read_logs(source),
        "csv": lambda: formats.read_csv(source),
        "older": lambda: formats.read_older(place_of(source)),
        "bag": lambda: _read_bags(_bags(Path(source)), chosen["mapping"], chosen["see"], clouds),
        "sql": lambda: _read_sql(source.removeprefix(SQL), **chosen),
        "minari": lambda: formats.read_minari(source.removeprefix(MINARI), **timed),
        "lerobot": lambda: formats.read_lerobot(source, formats.StepRules(**named, **timed)),
        "hdf5": lambda: formats.read_step_arrays(source, formats.StepRules(**named, **timed)),
        "steps": lambda: formats.read_steps(_step_files(Path(source)), formats.StepRules(**named, **timed)),
    }
    return readers[kind]()


def _read_sql(
    url: str, stages: str | None, trajectories: str | None, objects: str | None, mapping: Path | None, **_: Any
) -> "Logs":
    """Read a database by its queries, which options say, or a file."""
    from halfseen.errors import ArgumentError
    from halfseen.logs.formats import Queries, read_queries, read_sql

    queries = {"stages": stages, "trajectories": trajectories, "objects": objects}
    if mapping is not None and any(query is not None for query in queries.values()):
        raise ArgumentError(
            f"--mapping {mapping}: --stages, --trajectories and --objects say the same; give one of them"
        )
    if mapping is not None:
        return read_sql(url, read_queries(mapping))
    if stages is None or trajectories is None:
        raise ArgumentError(
            "a database needs --stages and --trajectories, a SELECT each, or a --mapping FILE that has both"
        )
    return read_sql(url, Queries(stages, trajectories, objects))


def _read_bags(bags: list[Path], mapping: Path, see: bool, clouds: Path | None) -> "Logs":
    """Read bags; each cloud of a stage is seen as objects, if that is asked for, and written to a folder, if any."""
    from halfseen.logs.formats import read_bag

    with Progress(None, "convert", "clouds") as bar:

        def counted(work: Callable[..., Any]) -> Callable[..., Any]:
            def count(*cloud: Any) -> Any:
                bar.update()
                return work(*cloud)

            return count

        keep = None if clouds is None else counted(partial(_kept, clouds))
        return read_bag(bags, mapping, see=counted(_see) if see else None, keep=keep)


def _kept(folder: Path, points_m: "np.ndarray", shape: tuple[int, int], name: str) -> str:
    """Write a cloud; its file is called like it."""
    from halfseen.perception import Cloud, write_pcd

    write_pcd(Cloud(points_m, shape if shape[0] > 1 else None, name=name), folder / f"{name}.pcd")
    return f"{name}.pcd"


def _see(points_m: "np.ndarray", shape: tuple[int, int], name: str) -> dict[str, list[Any]]:
    """Objects that a cloud shows, as columns; numbered anew in each cloud, the largest first."""
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


def _shown(source: str) -> str:
    """A source as it may be printed: without a password."""
    from halfseen.logs.formats.sql_rows import shown_url

    return SQL + shown_url(source.removeprefix(SQL)) if source.startswith(SQL) else source


def _write(logs: "Logs", target: str) -> None:
    from halfseen.logs import formats

    if target.startswith(MINARI):
        formats.write_minari(logs, target.removeprefix(MINARI))
    elif target.startswith(CSV):
        formats.write_csv(logs, target.removeprefix(CSV))
    else:
        logs.write(target)
