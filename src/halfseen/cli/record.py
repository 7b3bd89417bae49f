"""``halfseen record``: record what a program in any language says, line by line."""

import sys
from collections.abc import Callable
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import click

from halfseen.cli import options

if TYPE_CHECKING:
    from halfseen.logs import LogRecorder


@click.command(epilog="Example: halfseen record --out logs < calls.jsonl")
@click.argument("source", type=options.PATH, required=False)
@click.option("--out", type=options.PATH, required=True, help="Folder of logs; one that was recorded is gone on with.")
@click.option(
    "--listen",
    metavar="PORT|SOCKET",
    help="Take lines from a port of this machine (0 for any), or from a Unix socket: a file.",
)
@click.option(
    "--fsync",
    type=options.Choice(["never", "trajectory", "stage", "event"]),
    default="never",
    show_default=True,
    help="How often to wait for the disk, so that a loss of power takes no more than that.",
)
@click.option(
    "--part-mb",
    type=click.IntRange(min=1, max=10**6),
    default=256,
    show_default=True,
    help="Size from which on a trajectory begins in another file of OUT [MB].",
)
@click.option("--reward-unit", help="What rewards are counted in, such as parts.")
@options.unused_seed
def record(
    source: Path | None,
    out: Path,
    listen: str | None,
    fsync: str,
    part_mb: int,
    reward_unit: str | None,
    seed: int,
) -> None:
    """Record what JSON lines say, each answered by one; lines come from SOURCE, or from standard input.

    \b
    {"call": "begin_trajectory", "name": 1, "columns": {"cell": "left"}}
    {"call": "begin_stage", "covariates": {"x": 0.3}, "action": "PICK", "probability": 0.5}
    {"call": "complete_stage", "reward": 1.0, "elapsed_s": 2.5}
    {"call": "finish"}

    \b
    begin_stage also takes "objects", "object" and "robot"; complete_stage "own_rewards".
    More calls: still_running; drop_out with "robot" and "cause"; cut with "cause".
    Without "elapsed_s" [s] the clock of this machine is read.

    Where lines end, a trajectory in progress is cut with the cause input-ended. A line that is refused harms none after
    it.
    """  # noqa: D301
    from halfseen.errors import ArgumentError
    from halfseen.logs import LogRecorder
    from halfseen.logs.protocol import record_lines

    if source is not None and listen is not None:
        raise ArgumentError("SOURCE and --listen are both given; lines come from one of them")
    recorder_of = partial(LogRecorder, out, fsync=fsync, reward_unit=reward_unit, part_bytes=part_mb * 10**6)
    if listen is not None:
        _record_clients(recorder_of, int(listen) if listen.isdecimal() else Path(listen))
        return
    with (
        nullcontext(sys.stdin.buffer) if source is None else _lines_of(source) as lines,
        recorder_of() as recorder,
    ):
        record_lines(recorder, lines, click.echo)


def _lines_of(source: Path) -> BinaryIO:
    from halfseen.errors import ArgumentError
    from halfseen.reading import NUMBERS, opened, reason_of

    try:
        return opened(source, NUMBERS)
    except OSError as error:
        raise ArgumentError(
            f"{source}: it cannot be read ({reason_of(error)}); give a file of JSON lines, or none for standard input"
        ) from error


def _record_clients(recorder_of: Callable[[], "LogRecorder"], address: int | Path) -> None:
    from halfseen.logs.protocol import HOST, listening, record_clients

    with listening(address) as listener, recorder_of() as recorder:
        where = f"{HOST}:{listener.getsockname()[1]}" if isinstance(address, int) else address
        click.echo(f"{where}  (Ctrl+C ends)")
        record_clients(recorder, listener)
