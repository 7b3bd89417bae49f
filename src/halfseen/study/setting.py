"""The setting of all experiments: tables as perceived, the world and its laws, repetitions and the seed."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path

import numpy as np

from halfseen.cell.calibration.law import Law, read_law
from halfseen.errors import ArgumentError
from halfseen.perception import perceive, read_cloud
from halfseen.perception.picture import thumbnail
from halfseen.progress import Progress
from halfseen.workers import ALONE, Workers
from halfseen.world.config import WorldConfig
from halfseen.world.grasping import AssumedGrasping
from halfseen.world.scene import Scene
from halfseen.world.state import Layout, pad_scenes

DEFAULT_REPETITIONS = 40
CUT_KIND_NAMES = {
    "independent": "independent cuts",
    "occlusion": "cuts where much is hidden",
    "attempt": "the operator's hand",
}
"""Kind of cut → its name in text."""


@dataclass(frozen=True)
class Setting:
    """The setting of all experiments.

    Parameters
    ----------
    scenes
        The tables, as perceived.
    repetitions
        Number of fresh logs, each with a fresh block of evaluation episodes that all policies share; some experiments
        use fewer.
    seed
        Determines all results except measured times.
    alpha
        Significance level of the tests.
    world
        Parameters of the world.
    law
        Folder of the law of the world, with the attempts that it was estimated from; None if the world's laws are
        assumed.
    grips
        Grip offsets, as quantiles over objects of the physical cell; objects of random tables draw theirs from them.
        None if all offsets are 0.
    """

    scenes: tuple[Scene, ...]
    repetitions: int = DEFAULT_REPETITIONS
    seed: int = 0
    alpha: float = 0.01
    world: WorldConfig = field(default_factory=WorldConfig)
    law: Path | None = None
    grips: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if self.repetitions < 2:
            raise ArgumentError(f"repetitions is {self.repetitions}; intervals and tests need at least 2")

    @cached_property
    def layouts(self) -> Layout:
        """The tables, padded to the largest."""
        return pad_scenes(self.scenes)


def under(setting: Setting, folder: Path | None) -> tuple[Setting, Law | None]:
    """Apply the law in a folder, if any, to a study.

    Parameters
    ----------
    setting
        Setting of the study; its rewards and horizon are kept.
    folder
        A folder written by `halfseen cell calibrate`; None for the assumed laws.

    Raises
    ------
    PolicyError
        The folder holds no law.
    """
    if folder is None:
        return setting, None
    law = read_law(folder).law
    return replace(setting, world=law.config(setting.world), law=folder, grips=tuple(law.grips.tolist())), law


def law_sentence(setting: Setting) -> str:
    """State the source of the laws of the study's world."""
    if setting.law is not None:
        fit = read_law(setting.law).law.grasp
        return (
            "The laws of grasping and seeing are estimated, not assumed: from "
            f"{fit.num_decided + fit.num_cut:,} attempts of a cell in simulated physics, of which "
            f"{fit.num_cut:,} were cut."
        )
    law, start = setting.world.grasping, "The laws of grasping and seeing are assumed, not estimated"
    if not isinstance(law, AssumedGrasping):
        return f"{start}."
    times = np.exp(float(law.log_time_per_occlusion))
    return (
        f"{start}: a grasp takes {times:.0f} times as long where the object is fully hidden, which is this "
        "project’s own choice."
    )


def look_at(
    paths: Sequence[Path], law: Law | None = None, workers: Workers = ALONE
) -> tuple[tuple[Scene, ...], dict[str, bytes]]:
    """Perceive every cloud: scenes, named after their files, and pictures of them, as PNG by the name of the scene.

    Under a law of a cell, the visible part of an object determines its ease of grip.

    Raises
    ------
    ArgumentError
        Two clouds have the same name, which must be unique among scenes.
    CloudError
        A cloud cannot be read, or shows no table.
    """
    of_name: dict[str, Path] = {}
    for path in paths:
        if path.stem in of_name:
            raise ArgumentError(f"{of_name[path.stem]} and {path} have the same name; give each cloud a unique name")
        of_name[path.stem] = path
    seen = []
    with Progress(len(paths), "look", "tables") as bar, workers.ready_if_worth() as pool:
        for each in pool.in_order(partial(_perceived, law), paths):
            seen.append(each)
            bar.update()
    return tuple(scene for scene, _ in seen), {scene.name: picture for scene, picture in seen}


def _perceived(law: Law | None, path: Path) -> tuple[Scene, bytes]:
    view = perceive(read_cloud(path))
    scene = view.scene() if law is None else law.scene(view)
    return replace(scene, name=path.stem), thumbnail(view)
