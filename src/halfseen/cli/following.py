"""``--watch`` and ``--record``: whoever follows a cell at work."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from halfseen.cli import options
from halfseen.cli.watch import port_option

if TYPE_CHECKING:
    from halfseen.cell.campaign import Follow
    from halfseen.world import Policy

_OPTIONS = (
    click.option("--watch", "is_watched", is_flag=True, help="Show it in the browser as it runs, until Ctrl+C."),
    port_option,
    click.option(
        "--record", type=options.PATH, help="Folder for the last hundred stages, which `halfseen watch` shows."
    ),
)


def follow_options(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options that `following` takes."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


@contextmanager
def following(
    policy: "Policy | Policy", horizon: int, is_watched: bool, port: int, record: Path | None, overwrite: bool
) -> "Iterator[Follow | None]":
    """Follow tables while they are cleared; then write what was seen, and show it until somebody interrupts.

    Parameters
    ----------
    policy, horizon
        Who decides, and how many stages a table has.
    is_watched, port
        Whether to serve a page, and where.
    record, overwrite
        Where to write what was seen, if anywhere, and whether in place of a recording that is there.

    Yields
    ------
    Follow or None
        For a `Campaign`; None where nobody follows.
    """
    if not is_watched and record is None:
        yield None
        return
    from halfseen.view.cell_watch import TablesWatch
    from halfseen.view.live_page import served
    from halfseen.view.recording import MARKER, write_recording
    from halfseen.writing import refuse_taken

    if record is not None:
        refuse_taken(record, overwrite, MARKER, "recording")
    with ExitStack() as stack:
        watch = TablesWatch(policy, horizon)
        page = stack.enter_context(served(port)) if is_watched else None
        if page is not None:
            click.echo(f"{page.url}  (Ctrl+C ends)", err=True)
            watch.on_change = page.show
        yield watch.follow
        if record is not None and watch.watched is not None:
            write_recording(watch.watched, record, overwrite=overwrite)
        if page is not None:
            page.wait()
