"""``halfseen watch``: a page in the browser that shows a run in 3-D, and why."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from halfseen.cli import options
from halfseen.cli.inputs import law_of, refuse_output
from halfseen.cli.messages import say
from halfseen.cli.options import SHIPPED

if TYPE_CHECKING:
    from halfseen.view import Watched

Shows = Callable[["Watched"], None]

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
@options.path("--policy", told="Of a cloud or of logs: the folder of a policy of tables.")
@options.path("--history", told="Of a cloud: logs whose last trajectory is the one so far.")
@options.labels
@options.law(None, f"Of a cloud, where it is {SHIPPED} by default. ")
@options.path("--clouds", told="Of logs: folder with the cloud of each stage.")
@options.whole(
    "--trajectory",
    least=1,
    most=options.MOST_EPISODES,
    told="Of logs: which trajectory, from 1; by default the first.",
)
@click.option("--stages", callback=_span, metavar="FIRST-LAST", help="Only these, counted from 1.")
@options.path(
    "--export",
    multiple=True,
    told="Write it to a file instead, once or more: .html, which opens without a server, or .gif.",
)
@options.overwrite("a file of --export that is")
@options.port
@options.unused_seed
def watch(
    source: Path,
    export: tuple[Path, ...],
    stages: tuple[int, int] | None,
    overwrite: bool,
    port: int,
    seed: int,
    **given: Any,
) -> None:
    """Show in the browser what was seen and decided, in 3-D, and why. Nothing leaves this machine.

    SOURCE is a point cloud as `halfseen look` takes it, with --policy for what is decided there; a recording, as
    `halfseen cell run --record` writes it; or a folder of logs with --clouds, as `halfseen convert` writes them.
    """
    from halfseen.errors import ArgumentError
    from halfseen.view.recording import MARKER

    for file in export:
        refuse_output(file, "an exported run", FORMS, overwrite, [source])
    if not source.exists():
        raise ArgumentError(f"{source}: no such file or folder; give a cloud, a recording or a folder of logs")
    kind = "recording" if (source / MARKER).is_file() else "logs" if source.is_dir() else "cloud"
    for name, kinds in OF_KINDS.items():
        if given[name] is not None and kind not in kinds:
            raise ArgumentError(f"--{name} is of {' or '.join(kinds)}, and {source} is a {kind}; leave it out")

    def work(show: Shows) -> None:
        if kind == "recording":
            from halfseen.view.recording import read_recording

            show(read_recording(source))
        elif kind == "logs":
            _show_logs(source, given["clouds"], given["trajectory"], given["policy"], show)
        else:
            _show_cloud(source, given["policy"], given["history"], given["labels"], given["law"], show)

    shown = partial(_of_stages, stages, work)
    if export:
        _exported(export, shown)
    else:
        _served(port, shown)


def _of_stages(span: tuple[int, int] | None, work: Callable[[Shows], None], show: Shows) -> None:
    """Show some stages of what is shown."""

    def show_some(watched: "Watched") -> None:
        from halfseen.errors import ArgumentError

        first, last = span or (1, len(watched.stages))
        if last > len(watched.stages):
            raise ArgumentError(
                f"--stages is {first}-{last}, and there are {len(watched.stages)}; leave it out for all"
            )
        show(replace(watched, stages=watched.stages[first - 1 : last]))

    work(show_some)


def _served(port: int, work: Callable[[Shows], None]) -> None:
    from halfseen.view.live_page import served

    with served(port) as page:
        urls = [page.url]

        def show(watched: "Watched") -> None:
            page.show(watched)
            if urls:
                say(f"{urls.pop()}  (Ctrl+C ends)")

        work(show)
        page.wait()


def _exported(files: tuple[Path, ...], work: Callable[[Shows], None]) -> None:
    shown: list[Watched] = []
    work(shown.append)
    for file in files:
        if file.suffix.lower() == ".gif":
            from halfseen.view.film import write_gif

            write_gif(shown[-1], file)
        else:
            from halfseen.view.viewer import write_html

            write_html(shown[-1], file)
        say(f"{file}: {len(shown[-1].stages)} stage{'' if len(shown[-1].stages) == 1 else 's'}")


def _show_cloud(
    file: Path, policy: Path | None, history: Path | None, labels: Path | None, law: str | None, show: Shows
) -> None:
    """Show what is seen as soon as it is, and then what is decided."""
    from halfseen.errors import ArgumentError, CloudError
    from halfseen.perception import perceive, read_cloud
    from halfseen.view.stages import watched_cloud

    for option, value in (("--history", history), ("--labels", labels), ("--law", law)):
        if policy is None and value is not None:
            raise ArgumentError(f"{option} is for a decision; give a --policy, or leave {option} out")
    cloud = read_cloud(file)
    view = perceive(cloud)
    if not view.objects:
        raise CloudError(f"{file}: no objects on the table; put the table with its objects whole into the view")
    show(watched_cloud(cloud, view, None, None, 0))
    if policy is None:
        return
    from halfseen.errors import PolicyError
    from halfseen.policies import decider_of, read_policy
    from halfseen.policies.folder.stored import UNDECIDED, refuse_team
    from halfseen.policies.observations import read_observation
    from halfseen.tables.present import Present

    stored = read_policy(policy)
    refuse_team(stored, UNDECIDED, policy)
    if not stored.is_table:
        raise PolicyError(f"{policy}: it is no policy of tables, and {file} is a cloud; learn one from logs of tables")
    counts_views = stored.record["schema"].get("counts_views", False)
    known = law_of(law or SHIPPED) if counts_views else None
    now = read_observation(stored, file, history, None, labels, known)
    assert isinstance(now, Present), "a policy of tables decides where a table's trajectory stands"
    show(watched_cloud(cloud, view, now, decider_of(stored, extrapolates=True).decide(now), stored.horizon))


def _show_logs(folder: Path, clouds: Path | None, number: int | None, policy: Path | None, show: Shows) -> None:
    from halfseen.errors import ArgumentError
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
    show(watched_logs(logs, clouds, number or 1, stored))
