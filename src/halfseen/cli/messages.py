"""What is said: answers on stdout, errors and warnings in one line each on stderr.

Where a person reads it, the first word of such a line is in colour. Names and values of a log command no terminal.
"""

import os
import re
import sys

import click

_UNPRINTABLE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")

MOST_TOLD = 1200
"""Characters of a line; of a longer one, which quotes a value, its middle is left out."""


def say(message: str) -> None:
    """Answer on stdout."""
    click.echo(printable(message))


def printable(text: str) -> str:
    r"""Write what moves the cursor, colours, turns the direction or is no character as ``\x1b``, and the like.

    Parameters
    ----------
    text
        Of any number of lines.
    """
    return _UNPRINTABLE.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


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
    line = printable(" ".join(message.split()))
    return f"{head} {line if len(line) <= MOST_TOLD else f'{line[: MOST_TOLD - 500]} … {line[-500:]}'}"


def _tell(message: str, colour: str) -> None:
    bars = sys.modules.get("tqdm")
    if bars is None:
        click.echo(headed(message, colour), err=True)
    else:  # A bar that is being shown steps aside.
        bars.tqdm.write(headed(message, colour), file=sys.stderr)
