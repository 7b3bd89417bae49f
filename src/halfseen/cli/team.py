"""``--team``: the robots at a table, from a user's file, where there are several."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from halfseen.cli import options
from halfseen.cli.laws import grasping_of

if TYPE_CHECKING:
    from halfseen.world import Team


def team_option(of: str = "") -> Any:
    """The option; None for one robot."""
    return click.option(
        "--team",
        type=options.PATH,
        help=f"{of}Robots that clear the tables together, a .toml or .json file (see `halfseen.world.read_team`); by "
        "default there is one.",
    )


def read_robots(file: Path | None) -> "Team | None":
    """Read the team of a file, a `law` of a robot being what ``--law`` takes; None where there is none.

    Raises
    ------
    ArgumentError
        The file holds no team.
    PolicyError
        A folder that it names holds no law.
    """
    if file is None:
        return None
    from halfseen.world import read_team

    return read_team(file, partial(grasping_of, beside=file.parent))
