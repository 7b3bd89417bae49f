"""The captured tables, as perception sees them, and what it saw as pictures."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from halfseen.cell.calibration.law import Law
from halfseen.errors import ArgumentError
from halfseen.perception import perceive, read_cloud
from halfseen.perception.picture import thumbnail
from halfseen.progress import Progress
from halfseen.workers import ALONE, Workers
from halfseen.world.scene import Scene


def look_at(
    paths: Sequence[Path], law: Law | None = None, workers: Workers = ALONE
) -> tuple[tuple[Scene, ...], dict[str, bytes]]:
    """Perceive every cloud: scenes, named after their files, and what was seen, as PNG by the name of the scene.

    Under a law of a cell, what is seen of an object says how well it can be gripped.

    Raises
    ------
    ArgumentError
        Two clouds have one name, by which scenes are told apart.
    CloudError
        A cloud cannot be read, or shows no table.
    """
    of_name: dict[str, Path] = {}
    for path in paths:
        if path.stem in of_name:
            raise ArgumentError(f"{of_name[path.stem]} and {path} have one name; give each cloud a name of its own")
        of_name[path.stem] = path
    scenes, pictures = [], {}
    with Progress(len(paths), "look", "tables") as bar, workers.ready_if_worth() as pool:
        for scene, picture in pool.in_order(_Looking(law), paths):
            scenes.append(scene)
            pictures[scene.name] = picture
            bar.update()
    return tuple(scenes), pictures


@dataclass(frozen=True)
class _Looking:
    """Perceives a cloud, and draws what was seen as PNG."""

    law: Law | None

    def __call__(self, path: Path) -> tuple[Scene, bytes]:
        view = perceive(read_cloud(path))
        scene = view.scene() if self.law is None else self.law.scene(view)
        return replace(scene, name=path.stem), thumbnail(view)
