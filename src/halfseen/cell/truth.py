"""What is true of the cups of a running cell: which are dirty, and where they are."""

from typing import Any

import numpy as np

from halfseen.arrays import Points
from halfseen.cell.workcell import Workcell
from halfseen.scene.table import TABLE_TOP_M
from halfseen.shapes import Bool, Float

_TOPPLED_COSINE = 0.5
_ON_TABLE_M = 0.05  # a cup's origin is not lower than this below the top of the table it stands on


class Truth:
    """Which cups are dirty, and where they are: what no decision looks at.

    Parameters
    ----------
    cell
        Before anything happened.
    is_dirty
        Of each cup.
    """

    def __init__(self, cell: Workcell, is_dirty: Bool[np.ndarray, " N"]) -> None:
        self.is_dirty, self.is_racked = is_dirty, np.zeros(len(is_dirty), dtype=bool)
        self._stood = self._upright(cell) > _TOPPLED_COSINE

    @property
    def num_dirty_left(self) -> int:
        """Dirty cups that are not in the rack."""
        return int(self._is_left.sum())

    def num_dirty_left_to(self, cell: Workcell, arm: int) -> int:
        """Count those of them that are within the reach of an arm, whoever holds them and even where they fell."""
        station = cell.stations[arm]
        apart_m = np.linalg.norm(self._places_m(cell)[:, :2] - station.robot.base_m[:2], axis=1)
        return int((self._is_left & (apart_m <= station.reach_m)).sum())

    @property
    def _is_left(self) -> Bool[np.ndarray, " N"]:
        return self.is_dirty & ~self.is_racked

    def newly_racked(self, cell: Workcell, arm: int | None = None) -> list[bool]:
        """Of the cups that came into the rack since it was asked last, whether each is dirty.

        Parameters
        ----------
        cell
            The cell.
        arm
            Whose rack is looked at; None for all.
        """
        stations = cell.stations if arm is None else (cell.stations[arm],)
        places_m = self._places_m(cell)
        now = np.array([any(each.rack.holds(place) for each in stations) for place in places_m], dtype=bool)
        if arm is not None:
            now |= self.is_racked
        new = now & ~self.is_racked
        self.is_racked = now
        return self.is_dirty[new].tolist()

    def add_to(self, rows: list[dict[str, Any]], cell: Workcell) -> None:
        """Add the truth to the rows of a log: of each object that of the cup that is nearest to it."""
        places_m = self._places_m(cell)
        for row, known in zip(rows, cell.memory.objects, strict=True):
            row["is_dirty"] = bool(self.is_dirty[np.linalg.norm(places_m - known.middle_m, axis=1).argmin()])

    def is_cleared(self, cell: Workcell) -> bool:
        """Whether no cup is on the table."""
        return not self._on_table(cell).any()

    def counts(self, cell: Workcell) -> dict[str, int]:
        """Count cups, as `Run` has them."""
        self.newly_racked(cell)
        on_table = self._on_table(cell)
        marked = {
            "num_racked": self.is_racked,
            "num_toppled": on_table & self._stood & (self._upright(cell) < _TOPPLED_COSINE),
            "num_fallen": ~on_table & ~self.is_racked,
            "num_dirty": self.is_dirty,
            "num_washed": self.is_dirty & self.is_racked,
        }
        return {"num_cups": len(self.is_dirty), **{name: int(mask.sum()) for name, mask in marked.items()}}

    def _on_table(self, cell: Workcell) -> Bool[np.ndarray, " N"]:
        return (self._places_m(cell)[:, 2] > TABLE_TOP_M - _ON_TABLE_M) & ~self.is_racked

    def _places_m(self, cell: Workcell) -> Points:
        # A table without cups has places, too: none.
        return np.array([cell.cell.cup(index).position_m for index in range(len(self.is_dirty))]).reshape(-1, 3)

    def _upright(self, cell: Workcell) -> Float[np.ndarray, " N"]:
        return np.array([cell.cell.cup(index).rotation[2, 2] for index in range(len(self.is_dirty))])
