"""``--workers``, ``--engine`` and ``--address``: who makes what repeats."""

from collections.abc import Callable
from functools import wraps
from typing import Any

import click

from halfseen.cli import options
from halfseen.workers import ENGINES

_OPTIONS = (
    click.option(
        "--workers",
        "num_workers",
        type=click.IntRange(1, options.MOST_WORKERS),
        show_default="all cores",
        help="Processes; their number changes nothing of what comes out.",
    ),
    click.option(
        "--engine",
        type=options.Choice(ENGINES),
        default="processes",
        show_default=True,
        help="What runs them: processes of this machine, or a cluster of Ray or Dask.",
    ),
    click.option("--address", help="Of the cluster; by default one that lives on this machine while the command runs."),
)


def worker_options(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options, and let it take `workers`, which they make."""

    @wraps(command)
    def with_workers(*args: Any, num_workers: int | None, engine: Any, address: str | None, **told: Any) -> None:
        from halfseen.workers import Workers

        command(*args, workers=Workers(num_workers, engine, address), **told)

    for option in reversed(_OPTIONS):
        with_workers = option(with_workers)
    return with_workers
