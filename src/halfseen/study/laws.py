"""The laws that the study's world has: those of a cell, or those that are assumed; and a sentence on where from."""

from dataclasses import replace
from pathlib import Path

import numpy as np

from halfseen.cell.calibration.law import Law
from halfseen.cell.calibration.law_folder import read_law
from halfseen.study.experiment import Setting
from halfseen.world.grasping import AssumedGrasping


def under(setting: Setting, folder: Path | None) -> tuple[Setting, Law | None]:
    """Put a study under the law in a folder, if any.

    Parameters
    ----------
    setting
        Of the study; its rewards and horizon stay.
    folder
        As `halfseen cell calibrate` writes it; None for the laws that are assumed.

    Raises
    ------
    PolicyError
        The folder holds no law.
    """
    if folder is None:
        return setting, None
    law = read_law(folder).law
    grips = tuple(law.grips.tolist())
    return replace(setting, world=law.config(setting.world), law=folder, grips=grips), law


def law_sentence(setting: Setting) -> str:
    """Say where the laws of the study's world come from."""
    if setting.law is not None:
        fit = read_law(setting.law).law.grasp
        return (
            f"How grasps go and how often labels err is estimated, not assumed: from {fit.num_decided + fit.num_cut:,} "
            f"attempts of a cell in simulated physics, of which {fit.num_cut:,} were cut."
        )
    law, start = setting.world.grasping, "How grasps go and how often labels err is assumed, not estimated"
    if not isinstance(law, AssumedGrasping):
        return f"{start}."
    times = np.exp(float(law.log_time_per_occlusion))
    return (
        f"{start}: that a grasp takes {times:.0f} times as long where the object is wholly hidden is this project’s "
        "own choice."
    )
