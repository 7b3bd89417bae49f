"""The captured tables, as perception sees them, and what it saw as pictures."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from halfseen.cell.calibration.law import Law
from halfseen.perception import perceive, read_cloud
from halfseen.perception.picture import thumbnail
from halfseen.progress import Progress
from halfseen.world.scene import Scene


def look_at(paths: Sequence[Path], law: Law | None = None) -> tuple[tuple[Scene, ...], dict[str, bytes]]:
    """Perceive every cloud: scenes, named after their files, and what was seen, as PNG by the name of the scene.

    Under a law of a cell, what is seen of an object says how well it can be gripped.
    """
    scenes, pictures = [], {}
    with Progress(len(paths), "look", "tables") as bar:
        for path in paths:
            view = perceive(read_cloud(path))
            scene = view.scene() if law is None else law.scene(view)
            scenes.append(replace(scene, name=path.stem))
            pictures[path.stem] = thumbnail(view)
            bar.update()
    return tuple(scenes), pictures
