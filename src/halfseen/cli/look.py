"""halfseen look: what a depth camera sees on a table, who hides whom, and what looks dirty."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from halfseen.cli import options
from halfseen.cli.columns import aligned

if TYPE_CHECKING:
    from collections.abc import Sequence

    from halfseen.perception import Label, View


@click.command(epilog="Example: halfseen look table.pcd --picture table.png")
@click.argument("cloud", type=options.PATH)
@click.option("--json", "is_json", is_flag=True, help="Print JSON, for programs.")
@click.option("--picture", type=options.PATH, help="Draw what is seen into this PNG file.")
@options.labels
def look(cloud: Path, is_json: bool, picture: Path | None, labels: Path | None) -> None:
    """Say what stands on the table of CLOUD, who hides whom, and, if it has colour, what looks dirty.

    CLOUD is a .pcd or .ply point cloud in the camera frame [m], with packed rgb or red, green and blue if it has
    colour; or an .npz file with a depth image depth_m [m], a pinhole matrix K [px] and, if there is one, a picture rgb.
    """
    from halfseen.errors import CloudError
    from halfseen.perception import perceive, read_cloud
    from halfseen.perception.label_files import labels_of
    from halfseen.perception.picture import draw, sentence

    seen = read_cloud(cloud)
    view = perceive(seen)
    if not view.objects:
        cut = f" but {view.num_cut} that the image border cuts" if view.num_cut else ""
        raise CloudError(f"{cloud}: no objects on the table{cut}; put the table with its objects whole into the view")
    told = labels_of(view, seen, labels)
    if picture is not None:
        draw(view, picture)
    if is_json:
        click.echo(json.dumps(_as_json(view, told)))
        return
    click.echo(sentence(view))
    if view.num_cut:
        click.echo(f"Left out: {view.num_cut} that the image border cuts.")
    click.echo("\n".join(["", *_table(view, told)]))


def _as_json(view: "View", told: "Sequence[Label] | None") -> dict[str, Any]:
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


def _table(view: "View", told: "Sequence[Label] | None") -> list[str]:
    header = ["object", "x [m]", "y [m]", "z [m]", "height [m]", "pose", "points", "hidden", "hidden by"]
    rows = [header]
    for seen in view.objects:
        x, y, z = seen.centroid_m
        hiders = sorted(range(len(view.objects)), key=lambda j: (-view.hides[seen.id, j], j))
        by = ", ".join(f"{j} ({view.hides[seen.id, j]:.2f})" for j in hiders if view.hides[seen.id, j] >= 0.005)
        pose = "upright" if seen.is_upright else "lying"
        numbers = [f"{x:.3f}", f"{y:.3f}", f"{z:.3f}", f"{seen.height_m:.3f}"]
        rows.append([str(seen.id), *numbers, pose, str(seen.num_points), f"{seen.occlusion:.2f}", by or "-"])
    if told is not None:
        labels = [("in view", "label"), *((f"{label.share_in_view:.2f}", label.word) for label in told)]
        rows = [[*row, *label] for row, label in zip(rows, labels, strict=True)]
    left = ("pose", "hidden by", "label")
    return aligned(rows, left=tuple(rows[0].index(name) for name in left if name in rows[0]))
