"""``halfseen watch``: a page in the browser that shows a run in 3-D, and why."""

from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from halfseen.cli import options
from halfseen.cli.inputs import law_of, perceived, refuse_output
from halfseen.cli.messages import say
from halfseen.cli.options import SHIPPED
from halfseen.errors import ArgumentError, PolicyError

if TYPE_CHECKING:
    from halfseen.view import Watched

FORMS = (".html", ".gif")
OF_KINDS = {
    "policy": ("cloud", "logs"),
    "history": ("cloud",),
    "labels": ("cloud",),
    "law": ("cloud",),
    "clouds": ("logs",),
    "trajectory": ("logs",),
}
"""Kinds of sources that an option is of."""


def _span(_: click.Context, __: click.Parameter, given: str | None) -> tuple[int, int] | None:
    """Take ``2-5`` apart, or ``2``."""
    if given is None:
        return None
    first, *last = given.split("-", 1)
    last = last[0] if last else first
    if not (first.isdigit() and last.isdigit() and 1 <= int(first) <= int(last)):
        raise click.BadParameter(f"{given!r} is no span of stages; give one as 2-5")
    return int(first), int(last)


@click.command(epilog="Example: halfseen watch table.pcd --policy policy")
@click.argument("source", type=options.PATH)
@options.path("--policy", text="Of a cloud or of logs: the folder of a policy of tables.")
@options.path("--history", text="Of a cloud: logs whose last trajectory is the one so far.")
@options.labels
@options.law(None, f"Of a cloud, where it is {SHIPPED} by default. ")
@options.path("--clouds", text="Of logs: folder with the cloud of each stage.")
@options.whole(
    "--trajectory", least=1, most=options.MOST_EPISODES, text="Of logs: which trajectory, from 1; by default the first."
)
@click.option("--stages", callback=_span, metavar="FIRST-LAST", help="Only these, counted from 1.")
@options.path(
    "--export",
    multiple=True,
    text="Write it to a file instead, once or more: .html, which opens without a server, or .gif.",
)
@options.overwrite("a file of --export that is")
@options.port
@options.unused_seed
def watch(
    source: Path, export: tuple[Path, ...], stages: tuple[int, int] | None, overwrite: bool, port: int, **given: Any
) -> None:
    """Show in the browser what was seen and decided, in 3-D, and why. Nothing leaves this machine.

    SOURCE is a point cloud as `halfseen look` takes it, with --policy for what is decided there; a recording, as
    `halfseen cell run --record` writes it; or a folder of logs with --clouds, as `halfseen convert` writes them.
    """
    from halfseen.view.recording import MARKER

    for file in export:
        refuse_output(file, "an exported run", FORMS, overwrite, [source])
    if not source.exists():
        raise ArgumentError(f"{source}: no such file or folder; give a cloud, a recording or a folder of logs")
    kind = "recording" if (source / MARKER).is_file() else "logs" if source.is_dir() else "cloud"
    for name, kinds in OF_KINDS.items():
        if given[name] is not None and kind not in kinds:
            raise ArgumentError(f"--{name} is of {' or '.join(kinds)}, and {source} is a {kind}; leave it out")

    if kind == "recording":
        runs = _of_recording(source)
    elif kind == "logs":
        runs = _of_logs(source, given["clouds"], given["trajectory"], given["policy"])
    else:
        runs = _of_cloud(source, given["policy"], given["history"], given["labels"], given["law"])
    shown = (_of_stages(stages, watched) for watched in runs)
    if export:
        _export(export, list(shown)[-1])
    else:
        _serve(port, shown)


def _of_stages(span: tuple[int, int] | None, watched: "Watched") -> "Watched":
    """Some stages of what is shown."""
    first, last = span or (1, len(watched.stages))
    if last > len(watched.stages):
        raise ArgumentError(f"--stages is {first}-{last}, and there are {len(watched.stages)}; leave it out for all")
    return replace(watched, stages=watched.stages[first - 1 : last])


def _serve(port: int, shown: "Iterable[Watched]") -> None:
    from halfseen.view.viewer import Page

    with closing(Page(port)) as page:
        for number, watched in enumerate(shown):
            page.show(watched)
            if number == 0:
                say(f"{page.url}  (Ctrl+C ends)")
        page.wait()


def _export(files: tuple[Path, ...], watched: "Watched") -> None:
    for file in files:
        if file.suffix.lower() == ".gif":
            from halfseen.view.recording import write_gif

            write_gif(watched, file)
        else:
            from halfseen.view.viewer import write_html

            write_html(watched, file)
        say(f"{file}: {len(watched.stages)} stage{'' if len(watched.stages) == 1 else 's'}")


def _of_recording(folder: Path) -> "Iterator[Watched]":
    from halfseen.view.recording import read_recording

    yield read_recording(folder)


def _of_cloud(
    file: Path, policy: Path | None, history: Path | None, labels: Path | None, law: str | None
) -> "Iterator[Watched]":
    """What is seen, as soon as it is where no history tells of it, and then what is decided."""
    from halfseen.tables.first_look import first_look
    from halfseen.view.stages import watched_cloud

    for option, value in (("--history", history), ("--law", law)):
        if policy is None and value is not None:
            raise ArgumentError(f"{option} is for a decision; give a --policy, or leave {option} out")
    cloud, view = perceived(file)
    if policy is None:
        yield watched_cloud(cloud, view, None, None, 0, first_look(view, cloud, labels))
        return
    from halfseen.policies import decider_of, read_policy
    from halfseen.policies.folder.stored import UNDECIDED, refuse_team
    from halfseen.policies.observations import read_observation
    from halfseen.tables.present import Present

    stored = read_policy(policy)
    refuse_team(stored, UNDECIDED, policy)
    if not stored.is_table:
        raise PolicyError(f"{policy}: it is no policy of tables, and {file} is a cloud; learn one from logs of tables")
    schema = stored.record["schema"]
    known = law_of(law or SHIPPED) if stored.counts_views else None
    if history is None:
        told = first_look(view, cloud, labels, schema["dirty_share"], *([known.seeing] if known else []))
        yield watched_cloud(cloud, view, None, None, 0, told)
    now = read_observation(stored, file, history, None, labels, known)
    assert isinstance(now, Present), "a policy of tables decides where a table's trajectory stands"
    yield watched_cloud(cloud, view, now, decider_of(stored, extrapolates=True).decide(now), stored.horizon)


def _of_logs(folder: Path, clouds: Path | None, number: int | None, policy: Path | None) -> "Iterator[Watched]":
    from halfseen.logs import read_logs
    from halfseen.policies import read_policy
    from halfseen.view.stages import watched_logs

    logs = read_logs(folder)
    if clouds is None:
        raise ArgumentError(
            f"{folder}: logs hold no clouds; give the folder that has one for each stage as --clouds, or record a run "
            "with `halfseen cell run --record`"
        )
    stored = None if policy is None else read_policy(policy)
    yield watched_logs(logs, clouds, number or 1, stored)
