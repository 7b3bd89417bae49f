"""What ``halfseen look`` tells of a view."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from halfseen.perception import Label, View


def with_objects(view: "View", cloud: Path) -> "View":
    """Give a view back, if it has any object.

    Raises
    ------
    CloudError
        It has none.
    """
    from halfseen.errors import CloudError

    if not view.objects:
        cut = f" but {view.num_cut} that the image border cuts" if view.num_cut else ""
        raise CloudError(f"{cloud}: no objects on the table{cut}; put the table with its objects whole into the view")
    return view


def as_json(view: "View", told: "Sequence[Label] | None") -> dict[str, Any]:
    """Say for programs what stands on the table, and what looks dirty."""
    labels = [{}] * len(view.objects)
    if told is not None:
        labels = [{"label": label.word, "share_in_view": label.share_in_view} for label in told]
    return {
        "table": {"normal": view.table.normal.tolist(), "offset_m": view.table.offset_m},
        "objects": [
            {
                "id": seen.id,
                "centroid_m": seen.centroid_m.tolist(),
                "place_m": seen.solid.middle_m.tolist(),
                "height_m": seen.height_m,
                "occlusion": seen.occlusion,
                "num_points": seen.num_points,
                "is_upright": seen.is_upright,
                **label,
            }
            for seen, label in zip(view.objects, labels, strict=True)
        ],
        "hides": view.hides.tolist(),
    }
