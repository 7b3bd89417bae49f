"""``--team``: the robots at a table, from a user's file, where there are several."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from halfseen.cli import options

if TYPE_CHECKING:
    from halfseen.team import Team


def team_option(of: str = "") -> Any:
    """The option; None for one robot."""
    return click.option(
        "--team",
        type=options.PATH,
        help=f"{of}Robots that clear the tables together, a .toml or .json file (see `halfseen.team.read_team`); by "
        "default there is one.",
    )


def read_robots(file: Path | None) -> "Team | None":
    """Read the team of a file; None where there is none.

    Raises
    ------
    ArgumentError
        The file holds no team.
    """
    if file is None:
        return None
    from halfseen.team import read_team

    return read_team(file)
