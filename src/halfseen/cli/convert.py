"""``halfseen convert``: logs from one format to another."""

import os
import sys
from contextlib import nullcontext
from dataclasses import asdict
from itertools import permutations
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import click

from halfseen.cli import options
from halfseen.cli.inputs import check_kind, give_mapping
from halfseen.cli.messages import answer, tell_warning
from halfseen.cli.sources import KINDS_OF, MINARI, SQL, Reading, kind_of, read, tables_of_events
from halfseen.errors import ArgumentError, noted
from halfseen.progress import Progress
from halfseen.writing import placed, refuse_taken

if TYPE_CHECKING:
    from halfseen.logs import Logs

CSV = "csv:"


@options.command("halfseen convert recording.mcap --mapping cell.toml --out logs")
@options.unused_seed
def convert(
    sources: Annotated[tuple[str, ...], {"metavar": "SOURCE..."}] = (),
    *,
    target: Annotated[str | None, {"flags": "--out"}] = None,
    is_check: Annotated[bool, {"flags": "--check"}] = False,
    is_template: Annotated[bool, {"flags": "--mapping-template"}] = False,
    reading: Reading,
    as_json: options.AsJson = False,
) -> None:
    """Read the logs of SOURCE and write them to another form, all or nothing.

    \b
    FOLDER              logs, as Parquet or CSV; those of an older halfseen are brought up to date
    BAG                 ROS 1 or 2, or MCAP with ROS 2, JSON or protobuf (or a folder of bags)
    minari:NAME-v0      a Minari dataset, also by its folder
    FOLDER of LeRobot   a dataset of its version 2 or 3
    TABLE               steps as of RLDS: .parquet, .csv or .arrow (or a folder of them)
    TABLE of your own   by --mapping: .csv, .tsv, .txt, .jsonl (or .gz), .xlsx, .parquet (or a folder)
    FILE.hdf5           steps as of D4RL
    sql:URL             rows of a database, as SQLAlchemy reaches it

    Several folders of logs, such as those of many recorders, become one of Parquet files; trajectories that are still
    being recorded are left out.

    Parameters
    ----------
    target
        FOLDER of Parquet, csv:FOLDER, or minari:NAME-v0.
    is_check
        Only say what --out cannot hold; status 1 if anything is lost.
    is_template
        Print a template of a mapping file, for a table from its columns, or write it to --out.
    """  # noqa: D301
    from halfseen.logs.missing import missing_in

    if is_template:
        _give_template(sources, target)
        return
    if not sources or target is None:
        missing, ctx = "target" if sources else "sources", click.get_current_context()
        raise click.MissingParameter(ctx=ctx, param=next(one for one in ctx.command.params if one.name == missing))
    if len(sources) > 1:
        if reading.mapping is not None:
            raise ArgumentError(
                f"--mapping is for one SOURCE, and {len(sources)} are given; put tables with the same columns, or "
                "bags, into one folder, and give that"
            )
        check_kind(reading, KINDS_OF, "parquet", "this is parquet")
        _compact(sources, target, is_check, as_json)
        return
    source = next(iter(sources))
    kind, clouds = kind_of(source, reading.mapping is not None), reading.clouds
    check_kind(reading, KINDS_OF, kind, f"this is {kind}")
    place = Path(target.removeprefix(CSV))
    if not target.startswith(MINARI):
        refuse_taken(place, False, None, "logs")
        _refuse_one_in_another(place, clouds)
    # The folder of clouds appears only after the logs are written.
    with noted() as warned, nullcontext() if clouds is None or is_check else placed(clouds) as cloud_folder:
        # Keep nulls: they are refused or filled in when the logs are read.
        logs = read(kind, source, reading._replace(clouds=cloud_folder), "keep")
        if not is_check:
            _write(logs, target)
    for warning in warned:
        tell_warning(warning)
    report = {"source": _shown(source), "format": kind, "target": target, "sentence": str(logs.summary())}
    report |= asdict(logs.summary()) | _kept_and_lost(logs, target) | {"warnings": warned}
    report["missing"] = missing_in(logs.stages, logs.stage_covariates)
    answer(report, _lines(report, is_check), as_json)
    if is_check and report["losses"]:
        sys.exit(1)


def _give_template(sources: tuple[str, ...], target: str | None) -> None:
    """Print or write a mapping template; for a table it is derived from the table, for bags it is fixed."""
    from halfseen.logs.formats import MAPPING_TEMPLATE, mapping_of

    if len(sources) > 1:
        raise ArgumentError(
            f"--mapping-template is made from one SOURCE, but {len(sources)} are given; give one of them"
        )
    if any(one.startswith(SQL) for one in sources):
        raise ArgumentError(
            "--mapping-template is made from a file, not from a database; save the rows of a SELECT as CSV, make the "
            "mapping from that file, and put the SELECT into it as table.query; or give --stages and --trajectories"
        )
    if target is not None and target.startswith((CSV, MINARI)):
        raise ArgumentError(f"--out is {target}, but a mapping is one file; give its name, such as cell.toml")
    table = next((one for one in sources if kind_of(one, is_mapped=True) == "events"), None)
    text = MAPPING_TEMPLATE if table is None else mapping_of(tables_of_events(Path(table))[0], table)
    give_mapping(text, None if target is None else Path(target))


def _kept_and_lost(logs: "Logs", target: str) -> dict[str, Any]:
    """Data that a target loses, and data that only halfseen can read from it."""
    from halfseen.logs.formats import losses, seen_by_halfseen_alone

    form = "csv" if target.startswith(CSV) else "minari" if target.startswith(MINARI) else "parquet"
    lost = losses(logs, form)
    has_notes = form == "minari" and not any(loss.is_refused for loss in lost)
    return {
        "losses": [{**asdict(loss), "sentence": str(loss)} for loss in lost],
        "for_halfseen_alone": seen_by_halfseen_alone(logs) if has_notes else [],
    }


def _lines(report: dict[str, Any], is_check: bool) -> list[str]:
    """Lines of the report."""
    lost = [f"- {loss['sentence']}" for loss in report["losses"]]
    hidden = report["for_halfseen_alone"]
    lines = [f"{report['target']}: {report['sentence']}"]
    lines += ["What would be lost:" if is_check else "What is lost:", *lost] if lost else []
    lines += ["Nothing would be lost."] if is_check and not lost else []
    from halfseen.logs.missing import share_of

    lines += [
        f"Missing: {name} in {share_of(count, report['num_stages'])}; "
        + ("leave it out of the log." if count == report["num_stages"] else "fill it in with --missing when you learn.")
        for name, count in report["missing"].items()
    ]
    return lines + ([f"Kept as notes that only halfseen reads: {', '.join(hidden)}."] if hidden else [])


def _refuse_one_in_another(out: Path, clouds: Path | None) -> None:
    """Refuse two folders that are equal or nested."""
    if clouds is None:
        return
    places = [Path(os.path.realpath(place)) for place in (out, clouds)]
    if any(one == other or one in other.parents for one, other in permutations(places)):
        raise ArgumentError(f"--clouds {clouds}: it is --out, or one contains the other; give two separate folders")


def _compact(sources: tuple[str, ...], target: str, is_check: bool, as_json: bool) -> None:
    from halfseen.logs import compact

    if is_check:
        raise ArgumentError(
            "--check is for one SOURCE; several folders become one folder of Parquet files, which holds all of them"
        )
    if target.startswith((CSV, MINARI)):
        raise ArgumentError(f"--out is {target}; several folders become one folder of Parquet files: give a FOLDER")
    with Progress(2 * len(sources), "convert", "folders") as bar:
        done = compact(sources, target, on_progress=bar.update)
    words = f"{done.num_trajectories} trajectories with {done.num_stages} stages from {done.num_folders} folders"
    words += f"; {done.num_running} still being recorded left out" if done.num_running else ""
    report = {"sources": list(sources), "target": target, "sentence": words, **done._asdict()}
    answer(report, [f"{target}: {words}"], as_json)


def _shown(source: str) -> str:
    """The source without a password, for printing."""
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
