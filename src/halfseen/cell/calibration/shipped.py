"""The law that comes with the package: of the physical cell, estimated from attempts that lie beside it."""

from importlib.resources import files
from pathlib import Path


def shipped_law() -> Path:
    """Find its folder, to be read with `halfseen.cell.calibration.law_folder.read_law`.

    It was made by ``halfseen cell calibrate --attempts 6000``; ``--from`` of its attempts makes it again.
    """
    return Path(str(files("halfseen.cell.calibration"))) / "shipped_law"
