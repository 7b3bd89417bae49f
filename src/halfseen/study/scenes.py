"""The ten captured tables, as perception sees them, and what it saw as pictures."""

from collections.abc import Sequence
from pathlib import Path

from tqdm import tqdm

from halfseen.perception import View, perceive, read_cloud
from halfseen.world.scene import Scene


def look_at(paths: Sequence[Path]) -> list[View]:
    """Perceive every cloud."""
    return [perceive(read_cloud(path)) for path in tqdm(paths, desc="look at tables", disable=None, leave=False)]


def scenes_of(views: Sequence[View], paths: Sequence[Path]) -> tuple[Scene, ...]:
    """Scenes, named after their files."""
    return tuple(Scene(view.scene().hides, name=path.stem) for view, path in zip(views, paths, strict=True))
