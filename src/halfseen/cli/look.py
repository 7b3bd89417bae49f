"""halfseen look: what a depth camera sees on a table, and who hides whom."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from halfseen.cli import options
from halfseen.cli.columns import aligned

if TYPE_CHECKING:
    from halfseen.perception import View


@click.command(epilog="Example: halfseen look table.pcd --picture table.png")
@click.argument("cloud", type=options.PATH)
@click.option("--json", "is_json", is_flag=True, help="Print JSON, for programs.")
@click.option("--picture", type=options.PATH, help="Draw what is seen into this PNG file.")
def look(cloud: Path, is_json: bool, picture: Path | None) -> None:
    """Say what stands on the table of CLOUD, and who hides whom.

    CLOUD is a .pcd or .ply point cloud in the camera frame [m], or an .npz file with a depth image depth_m [m] and a
    pinhole matrix K [px].
    """
    from halfseen.errors import CloudError
    from halfseen.perception import perceive, read_cloud
    from halfseen.perception.picture import draw, sentence

    view = perceive(read_cloud(cloud))
    if not view.objects:
        cut = f" but {view.num_cut} that the image border cuts" if view.num_cut else ""
        raise CloudError(f"{cloud}: no objects on the table{cut}; put the table with its objects whole into the view")
    if picture is not None:
        draw(view, picture)
    if is_json:
        click.echo(json.dumps(_as_json(view)))
        return
    click.echo(sentence(view))
    if view.num_cut:
        click.echo(f"Left out: {view.num_cut} that the image border cuts.")
    click.echo("\n".join(["", *_table(view)]))


def _as_json(view: "View") -> dict[str, Any]:
    return {
        "table": {"normal": view.table.normal.tolist(), "offset_m": view.table.offset_m},
        "objects": [
            {
                "id": seen.id,
                "centroid_m": seen.centroid_m.tolist(),
                "height_m": seen.height_m,
                "occlusion": seen.occlusion,
                "num_points": seen.num_points,
                "is_upright": seen.is_upright,
            }
            for seen in view.objects
        ],
        "hides": view.hides.tolist(),
    }


def _table(view: "View") -> list[str]:
    header = ["object", "x [m]", "y [m]", "z [m]", "height [m]", "pose", "points", "hidden", "hidden by"]
    rows = [header]
    for seen in view.objects:
        x, y, z = seen.centroid_m
        hiders = sorted(range(len(view.objects)), key=lambda j: (-view.hides[seen.id, j], j))
        by = ", ".join(f"{j} ({view.hides[seen.id, j]:.2f})" for j in hiders if view.hides[seen.id, j] >= 0.005)
        pose = "upright" if seen.is_upright else "lying"
        numbers = [f"{x:.3f}", f"{y:.3f}", f"{z:.3f}", f"{seen.height_m:.3f}"]
        rows.append([str(seen.id), *numbers, pose, str(seen.num_points), f"{seen.occlusion:.2f}", by or "-"])
    return aligned(rows, left=(header.index("pose"), header.index("hidden by")))
