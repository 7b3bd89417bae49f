"""What ``--law`` names: the law that comes with the package, one in a folder, or those that are assumed."""

from pathlib import Path

ASSUMED = "assumed"


def law_folder(name: str | None) -> Path | None:
    """Find the folder of a law; None for those that are assumed.

    Parameters
    ----------
    name
        A folder, or `ASSUMED`; None for the law that comes with the package.
    """
    from halfseen.cell.calibration.shipped import shipped_law

    if name is None:
        return shipped_law()
    return None if name == ASSUMED else Path(name)
