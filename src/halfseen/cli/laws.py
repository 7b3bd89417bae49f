"""What ``--law`` names: a folder, the law that comes with the package, or those that are assumed."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from halfseen.suggestions import did_you_mean

if TYPE_CHECKING:
    from halfseen.cell.calibration.law import Law
    from halfseen.world import GraspLaw

ASSUMED, SHIPPED = "assumed", "shipped"


def law_option(default: str | None, of: str = "") -> Any:
    """The option, and what it names where nothing is said; None where the command must know that nothing was."""
    return click.option(
        "--law",
        default=default,
        show_default=default is not None,
        metavar="FOLDER",
        help=f"{of}Law of grasping and seeing: a folder that `halfseen cell calibrate` wrote, {SHIPPED} (with this "
        f"package), or {ASSUMED}.",
    )


def law_folder(name: str, beside: Path | None = None) -> Path | None:
    """Find the folder of a law; None for those that are assumed.

    Parameters
    ----------
    name
        As ``--law`` takes it.
    beside
        The folder of the file that names it; None where ``--law`` does.

    Raises
    ------
    ArgumentError
        There is no such folder.
    """
    if name == ASSUMED:
        return None
    from halfseen.cell.calibration.law_folder import shipped_law
    from halfseen.errors import ArgumentError

    if name == SHIPPED:
        return shipped_law()
    folder, told = (Path(name), f"--law {name}") if beside is None else (beside / name, name)
    if not folder.exists():
        there = f"there is no such folder; let `halfseen cell calibrate` write one, or name {SHIPPED} or {ASSUMED}"
        raise ArgumentError(f"{told}: {there}{did_you_mean(name, (SHIPPED, ASSUMED))}")
    return folder


def law_of(name: str, beside: Path | None = None) -> "Law | None":
    """Read the law of a name; None for those that are assumed; see `law_folder`.

    Raises
    ------
    PolicyError
        The folder holds no law.
    """
    folder = law_folder(name, beside)
    if folder is None:
        return None
    from halfseen.cell.calibration.law_folder import read_law

    return read_law(folder).law


def grasping_of(name: str, beside: Path) -> "GraspLaw":
    """Read the law of grasping that a file names, a folder being looked for beside it; see `law_of`."""
    law = law_of(name, beside)
    if law is not None:
        return law.grasping
    from halfseen.world import AssumedGrasping

    return AssumedGrasping()
