"""What perception sees of the tables that come with the package, kept: seeing takes longer than playing on them.

``python -m halfseen.cell.tables_seen`` looks at them anew. Nothing else here loads perception.
"""

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from halfseen.world.scene import Scene
from halfseen.writing import write_file

if TYPE_CHECKING:
    from halfseen.cell.calibration.law import Law


@dataclass(frozen=True)
class TableSeen:
    """One table, as it is seen.

    Parameters
    ----------
    plain
        Which object hides which, and where each stands.
    facts
        Fields of `halfseen.cell.facts.Facts`, of each object.
    """

    plain: Scene
    facts: tuple[Mapping[str, Any], ...]

    def scene(self, law: "Law | None") -> Scene:
        """Give what a world needs to know of the table; under a law, grips included."""
        if law is None:
            return self.plain
        from halfseen.cell.facts import Facts

        return law.gripped(self.plain, [Facts(**each) for each in self.facts])


def tables_seen() -> list[TableSeen]:
    """Read what is seen of the ten tables, in their order."""
    told = json.loads(_trajectory().read_text(encoding="utf-8"))
    return [
        TableSeen(Scene(np.array(one["hides"]), one["name"], places_m=np.array(one["places_m"])), tuple(one["facts"]))
        for one in told
    ]


def look_again() -> list[TableSeen]:
    """See the ten tables anew."""
    from halfseen.cell.facts import facts_of
    from halfseen.perception import perceive, read_cloud
    from halfseen.scene import table_paths

    views = [perceive(read_cloud(path)) for path in table_paths()]
    return [TableSeen(view.scene(), tuple(asdict(each) for each in facts_of(view))) for view in views]


def _trajectory() -> Path:
    return Path(str(files("halfseen.cell"))) / "tables_seen.json"


def _told(seen: TableSeen) -> dict[str, Any]:
    assert seen.plain.places_m is not None
    places_m = seen.plain.places_m.round(6).tolist()
    return {"name": seen.plain.name, "hides": seen.plain.hides.tolist(), "places_m": places_m, "facts": seen.facts}


def main() -> None:
    """Write what is seen now."""
    told = [_told(seen) for seen in look_again()]
    write_file(_trajectory(), "[\n" + ",\n".join(json.dumps(one, default=bool) for one in told) + "\n]\n")


if __name__ == "__main__":
    main()
