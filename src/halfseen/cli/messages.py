"""Errors and warnings, each in one line on stderr, with its first word in colour where a person reads it."""

import os
import sys

import click


def tell_error(message: str) -> None:
    """Say why a command ends."""
    _tell(message, "red")


def tell_warning(message: str) -> None:
    """Say what is legal and probably not meant."""
    _tell(message, "yellow")


def is_coloured() -> bool:
    """Whether stderr is a terminal that shows colours, and nobody asked for none (https://no-color.org)."""
    return sys.stderr.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


def headed(message: str, colour: str) -> str:
    """Write a message in one line that says who speaks."""
    head = click.style("halfseen:", fg=colour, bold=True) if is_coloured() else "halfseen:"
    return f"{head} {' '.join(message.split())}"


def _tell(message: str, colour: str) -> None:
    bars = sys.modules.get("tqdm")
    if bars is None:
        click.echo(headed(message, colour), err=True)
    else:  # A bar that is being shown steps aside.
        bars.tqdm.write(headed(message, colour), file=sys.stderr)
