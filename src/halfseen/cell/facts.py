"""Visible properties that may make an object hard to grip; cached for the shipped tables, as perception is slow.

``python -m halfseen.cell.facts`` recomputes the cache. Only that loads perception.
"""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, runtime_checkable

import numpy as np

from halfseen.shapes import Float
from halfseen.world.scene import Scene
from halfseen.writing import write_file

if TYPE_CHECKING:
    from halfseen.perception.solids import Hull, Vessel
    from halfseen.perception.view import SeenObject, View

MOST_ROOM_M = 0.10  # room beyond this makes no difference [m]


@dataclass(frozen=True)
class Facts:
    """Properties of an object in one view: whether it lies on its side, and its width between the fingers [m].

    `room_m` is the distance from its side to the nearest other object, at most `MOST_ROOM_M` [m].
    """

    is_lying: bool
    width_m: float
    room_m: float


def facts_of(view: "View") -> list[Facts]:
    """Compute the facts of each object in a view."""
    rotation, shift_m = view.camera_from_table[:3, :3], view.camera_from_table[:3, 3]
    is_object = view.labels >= 0
    across_m = ((view.image.points_m[is_object] - shift_m) @ rotation)[:, :2]
    labels = view.labels[is_object]
    return [_facts(seen, across_m[labels == seen.id], across_m[labels != seen.id]) for seen in view.objects]


def _facts(seen: "SeenObject", own_m: Float[np.ndarray, "own 2"], others_m: Float[np.ndarray, "others 2"]) -> Facts:
    width_m = _width_m(seen.solid, own_m)
    away_m = np.linalg.norm(others_m - seen.solid.middle_m[:2], axis=1).min(initial=np.inf)
    return Facts(not seen.is_upright, width_m, float(np.clip(away_m - 0.5 * width_m, 0.0, MOST_ROOM_M)))


def _width_m(solid: "Vessel | Hull", own_m: Float[np.ndarray, "own 2"]) -> float:
    from halfseen.perception.solids import Vessel

    if isinstance(solid, Vessel):
        return 2 * max(solid.radius_m + solid.slope * end for end in solid.ends_m)
    narrowest = np.linalg.eigh(np.cov(own_m.T))[1][:, 0]
    low_m, high_m = np.percentile(own_m @ narrowest, [2, 98])
    return float(high_m - low_m)


@runtime_checkable
class GripLaw(Protocol):
    """Predicts from their facts how well objects can be gripped."""

    def gripped(self, scene: Scene, facts: Sequence[Facts]) -> Scene:
        """Return the same table with the grip of each object."""
        ...


@dataclass(frozen=True)
class PerceivedTable:
    """One table as perceived: occlusions and positions, and the fields of `Facts` of each object."""

    plain: Scene
    facts: tuple[Mapping[str, Any], ...]

    def scene(self, law: GripLaw | None) -> Scene:
        """Scene of the table for a world; with a law, it includes grips."""
        if law is None:
            return self.plain
        return law.gripped(self.plain, [Facts(**each) for each in self.facts])


def tables_seen() -> list[PerceivedTable]:
    """Read the cached views of the ten tables, in order."""
    tables = json.loads(_path().read_text(encoding="utf-8"))
    return [
        PerceivedTable(
            Scene(np.array(one["hides"]), one["name"], places_m=np.array(one["places_m"])), tuple(one["facts"])
        )
        for one in tables
    ]


def look_again() -> list[PerceivedTable]:
    """Perceive the ten tables again."""
    from halfseen.perception import perceive, read_cloud
    from halfseen.scene import table_paths

    views = [perceive(read_cloud(path)) for path in table_paths()]
    return [PerceivedTable(view.scene(), tuple(asdict(each) for each in facts_of(view))) for view in views]


def _path() -> Path:
    return Path(str(files("halfseen.cell"))) / "tables_seen.json"


def _as_json(seen: PerceivedTable) -> dict[str, Any]:
    assert seen.plain.places_m is not None
    places_m = seen.plain.places_m.round(6).tolist()
    return {"name": seen.plain.name, "hides": seen.plain.hides.tolist(), "places_m": places_m, "facts": seen.facts}


def main() -> None:
    """Write the cache of the ten tables."""
    tables = [_as_json(seen) for seen in look_again()]
    write_file(_path(), "[\n" + ",\n".join(json.dumps(one, default=bool) for one in tables) + "\n]\n")


if __name__ == "__main__":
    main()
