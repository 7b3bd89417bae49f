"""The captured tables, as perception sees them, and what it saw as pictures."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from halfseen.cell.calibration.law import Law
from halfseen.perception import perceive, read_cloud
from halfseen.perception.picture import draw
from halfseen.progress import Progress
from halfseen.world.scene import Scene


def look_at(paths: Sequence[Path], law: Law | None = None) -> tuple[tuple[Scene, ...], dict[str, bytes]]:
    """Perceive every cloud: scenes, named after their files, and what was seen, as PNG by the name of the scene.

    Under a law of a cell, what is seen of an object says how well it can be gripped.
    """
    scenes, pictures = [], {}
    with TemporaryDirectory() as folder, Progress(len(paths), "look", "tables") as bar:
        picture = Path(folder) / "picture.png"
        for path in paths:
            view = perceive(read_cloud(path))
            draw(view, picture)
            scene = view.scene() if law is None else law.scene(view)
            scenes.append(replace(scene, name=path.stem))
            pictures[path.stem] = picture.read_bytes()
            bar.update()
    return tuple(scenes), pictures
