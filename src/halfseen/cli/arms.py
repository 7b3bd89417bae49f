"""``--arm`` and ``--arms``: the arm of a cell, from a user's file, and how many there are."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import click

from halfseen.cli import options

if TYPE_CHECKING:
    from halfseen.cell import Robot
    from halfseen.cell.model import Station

_OPTIONS = (
    click.option("--arm", type=options.PATH, help="MJCF or URDF file of another arm; by default the Jaco 2."),
    click.option("--flange", help="Of --arm: site or body where the hand is mounted; by default it is found."),
    options.names("--joints", "Of --arm: its hinges from the base on, as pan,lift; by default all to the flange."),
)


def arm_options(command: Callable[..., None]) -> Callable[..., None]:
    """Give a command the options that `robot_for` takes."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


num_arms_option = click.option(
    "--arms",
    "num_arms",
    type=click.IntRange(1, 2),
    default=1,
    show_default=True,
    help="One arm behind the table, or two at its ends.",
)


def stations_for(num_arms: int, arm: Path | None) -> "tuple[Station, ...]":
    """Give where several arms stand; nothing for one.

    Parameters
    ----------
    num_arms
        How many.
    arm
        File of the arm; None for the usual arm.

    Raises
    ------
    ArgumentError
        There are several, of a file.
    """
    if num_arms == 1:
        return ()
    from halfseen.cell.model import PAIR
    from halfseen.errors import ArgumentError

    if arm is not None:
        raise ArgumentError(
            f"--arm is {arm} and --arms {num_arms}: only the usual arm stands there twice; leave one out"
        )
    return PAIR


def robot_for(arm: Path | None, flange: str | None, joints: list[str] | None) -> "tuple[Robot, str]":
    """Make the robot that is asked for.

    Parameters
    ----------
    arm
        File of its arm; None for the usual arm.
    flange, joints
        Names in it; None for what is found.

    Returns
    -------
    tuple
        The robot, and what its arm is, in words: with a digest, where it is of a file.

    Raises
    ------
    HalfseenError
        There is no such file, it holds no such arm, or one that cannot work at the table.
    """
    from halfseen.cell import ArmFile, Robot, robot_of
    from halfseen.errors import ArgumentError

    if arm is None:
        for name, given in (("--flange", flange), ("--joints", joints)):
            if given is not None:
                raise ArgumentError(f"{name} is of an arm from a file; give the file by --arm, or leave {name} out")
        return Robot(), Robot().arm.name
    given = ArmFile(arm, flange=flange, joints=None if joints is None else tuple(joints))
    return robot_of(given), f"{arm.name} ({given.digest})"
