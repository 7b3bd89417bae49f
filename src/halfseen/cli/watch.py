"""``halfseen watch``: a page in the browser that shows a run in 3-D, and why."""

from collections.abc import Iterable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import click

from halfseen.cli import options
from halfseen.cli.inputs import check_kind, law_of, perceived, refuse_output
from halfseen.cli.messages import say
from halfseen.cli.options import SHIPPED
from halfseen.errors import ArgumentError, PolicyError

if TYPE_CHECKING:
    from halfseen.view import Watched

FORMS = (".html", ".gif")
KINDS_OF = {
    "policy": ("cloud", "logs"),
    "history": ("cloud",),
    "labels": ("cloud",),
    "law": ("cloud",),
    "clouds": ("logs",),
    "trajectory": ("logs",),
}
"""Kinds of sources that each option applies to."""


def _span(_: click.Context, __: click.Parameter, given: str | None) -> tuple[int, int] | None:
    """Parse ``2-5`` or ``2``."""
    if given is None:
        return None
    first, *last = given.split("-", 1)
    last = last[0] if last else first
    if not (first.isdigit() and last.isdigit() and 1 <= int(first) <= int(last)):
        raise click.BadParameter(f"{given!r} is not a span of stages; give one such as 2-5")
    return int(first), int(last)


class Given(NamedTuple):
    """Options that some kinds of sources take.

    Parameters
    ----------
    policy
        For a cloud or logs: the folder of a policy of tables.
    history
        For a cloud: logs whose last trajectory is the current one.
    clouds
        For logs: folder with the cloud of each stage.
    trajectory
        For logs: the trajectory, from 1; by default the first.
    """

    policy: Path | None = None
    history: Path | None = None
    labels: options.Labels = None
    law: Annotated[str | None, options.law("For a cloud; by default shipped. ")] = None
    clouds: Path | None = None
    trajectory: Annotated[int | None, options.whole(1, options.MOST_EPISODES)] = None


@options.command("halfseen watch table.pcd --policy policy")
@options.unused_seed
def watch(
    source: Path,
    *,
    given: Given,
    stages: Annotated[tuple[int, int] | None, {"callback": _span, "metavar": "FIRST-LAST"}] = None,
    export: tuple[Path, ...] = (),
    overwrite: bool = False,
    port: options.Port = 8080,
) -> None:
    """Show in the browser what was seen and decided, in 3-D, and why. Nothing leaves this machine.

    SOURCE is a point cloud as `halfseen look` takes it, with --policy for what is decided there; a recording, as
    `halfseen cell run --record` writes it; or a folder of logs with --clouds, as `halfseen convert` writes them.

    Parameters
    ----------
    stages
        Show only these stages, counted from 1.
    export
        Write it to a file instead: .html, which opens without a server, or .gif; may be given more than once.
    overwrite
        Replace a file of --export that is already there.
    """
    from halfseen.view.recording import MARKER, read_recording

    for file in export:
        refuse_output(file, "an exported run", FORMS, overwrite, [source])
    if not source.exists():
        raise ArgumentError(f"{source}: no such file or folder; give a cloud, a recording or a folder of logs")
    kind = "recording" if (source / MARKER).is_file() else "logs" if source.is_dir() else "cloud"
    check_kind(given, KINDS_OF, kind, f"{source} is of kind {kind}")
    if kind == "recording":
        runs = iter([read_recording(source)])
    elif kind == "logs":
        runs = _of_logs(source, given)
    else:
        runs = _of_cloud(source, given)
    shown = (_of_stages(stages, watched) for watched in runs)
    if export:
        _export(export, list(shown)[-1])
    else:
        _serve(port, shown)


def _of_stages(span: tuple[int, int] | None, watched: "Watched") -> "Watched":
    """The run restricted to a span of stages."""
    first, last = span or (1, len(watched.stages))
    if last > len(watched.stages):
        raise ArgumentError(f"--stages is {first}-{last}, but the last stage is {len(watched.stages)}; leave it out")
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


def _of_cloud(file: Path, given: Given) -> "Iterator[Watched]":
    """First the view, unless there is a history; then the decision."""
    from halfseen.tables.first_look import first_look
    from halfseen.view.stages import watched_cloud

    for option, value in (("--history", given.history), ("--law", given.law)):
        if given.policy is None and value is not None:
            raise ArgumentError(f"{option} needs a policy to decide; give a --policy, or leave {option} out")
    cloud, view = perceived(file)
    if given.policy is None:
        yield watched_cloud(cloud, view, None, None, 0, first_look(view, cloud, given.labels))
        return
    from halfseen.policies import decider_of, read_policy
    from halfseen.policies.folder.stored import UNDECIDED, refuse_team
    from halfseen.policies.table_observation import past_in, see_table

    stored = read_policy(given.policy)
    refuse_team(stored, UNDECIDED, given.policy)
    if not stored.is_table:
        raise PolicyError(
            f"{given.policy}: not a policy of tables, but {file} is a cloud; learn one from logs of tables"
        )
    schema = stored.record["schema"]
    known = law_of(given.law or SHIPPED) if stored.counts_views else None
    if given.history is None:
        dirt = first_look(view, cloud, given.labels, schema["dirty_share"], *([known.seeing] if known else []))
        yield watched_cloud(cloud, view, None, None, 0, dirt)
    now = see_table(stored, file, past_in(given.history), None, given.labels, known).present
    yield watched_cloud(cloud, view, now, decider_of(stored, extrapolates=True).decide(now), stored.horizon)


def _of_logs(folder: Path, given: Given) -> "Iterator[Watched]":
    from halfseen.logs import read_logs
    from halfseen.policies import read_policy
    from halfseen.view.stages import watched_logs

    logs = read_logs(folder)
    if given.clouds is None:
        raise ArgumentError(
            f"{folder}: logs hold no clouds; give a folder with the cloud of each stage by --clouds, or record a run "
            "with `halfseen cell run --record`"
        )
    stored = None if given.policy is None else read_policy(given.policy)
    yield watched_logs(logs, given.clouds, given.trajectory or 1, stored)
