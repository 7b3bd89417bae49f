"""Tables that the simulated world plays, as perception sees them."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from halfseen.cell.calibration.law import Law
    from halfseen.world import Scene


def num_scenes(clouds: Sequence[Path]) -> int:
    """Count what `scenes_of` gives."""
    from halfseen.cell.tables_seen import tables_seen

    return len(clouds) or len(tables_seen())


def scenes_of(
    clouds: Sequence[Path], law: "Law | None" = None, on_each: Callable[[], object] = lambda: None
) -> list["Scene"]:
    """Look at each cloud, by default at the ten that come with halfseen; under a law, what is seen tells of grips.

    Raises
    ------
    CloudError
        A cloud cannot be read, or shows no objects.
    """
    if not clouds:
        return _shipped(law, on_each)
    from halfseen.errors import CloudError
    from halfseen.perception import perceive, read_cloud

    scenes = []
    for cloud in clouds:
        view = perceive(read_cloud(cloud))
        scene = view.scene() if law is None else law.scene(view)
        if scene.num_objects == 0:
            raise CloudError(f"{cloud}: no objects on the table; put the table with its objects whole into the view")
        scenes.append(scene)
        on_each()
    return scenes


def _shipped(law: "Law | None", on_each: Callable[[], object]) -> list["Scene"]:
    from halfseen.cell.tables_seen import tables_seen

    scenes = []
    for seen in tables_seen():
        scenes.append(seen.scene(law))
        on_each()
    return scenes
