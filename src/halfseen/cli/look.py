"""halfseen look: what a depth camera sees on a table, who hides whom, and what looks dirty."""

import json
from pathlib import Path
from typing import TYPE_CHECKING

import click

from halfseen.cli import options
from halfseen.cli.columns import aligned
from halfseen.cli.look_at_many import clouds_in, look_at_many
from halfseen.cli.messages import say
from halfseen.cli.output_files import refuse_output
from halfseen.cli.view_facts import as_json, with_objects
from halfseen.cli.workers import worker_options

if TYPE_CHECKING:
    from collections.abc import Sequence

    from halfseen.perception import Label, View
    from halfseen.workers import Workers


@click.command(epilog="Example: halfseen look table.pcd --picture table.png")
@click.argument("clouds", nargs=-1, required=True, type=options.PATH)
@click.option("--json", "is_json", is_flag=True, help="Print JSON, for programs.")
@click.option("--picture", type=options.PATH, help="Draw what is seen into this PNG file; of one cloud.")
@options.overwrite("a picture that is")
@options.labels
@worker_options
def look(
    clouds: tuple[Path, ...],
    is_json: bool,
    picture: Path | None,
    overwrite: bool,
    labels: Path | None,
    workers: "Workers",
) -> None:
    """Say what stands on the table of a cloud, who hides whom, and, if it has colour, what looks dirty.

    A cloud is a .pcd or .ply point cloud in the camera frame [m], with packed rgb or red, green and blue if it has
    colour; or an .npz file with a depth image depth_m [m], a pinhole matrix K [px] and, if there is one, a picture rgb.
    Of several, or of a folder, every cloud has one line; those that cannot be read, or show no object, are named below,
    and the exit status is 2.
    """
    from halfseen.errors import ArgumentError

    if len(clouds) == 1 and not clouds[0].is_dir():
        if picture is not None:
            refuse_output(picture, "a picture", [".png"], overwrite, [clouds[0], *([labels] if labels else [])])
        _look_at(clouds[0], is_json, picture, labels)
        return
    if picture is not None or labels is not None:
        option, value = ("--picture", picture) if picture is not None else ("--labels", labels)
        raise ArgumentError(f"{option} {value}: it is of one cloud, and there are several; look at that cloud alone")
    look_at_many(clouds_in(clouds), workers, is_json)


def _look_at(cloud: Path, is_json: bool, picture: Path | None, labels: Path | None) -> None:
    from halfseen.perception import perceive, read_cloud
    from halfseen.perception.label_files import labels_of
    from halfseen.perception.picture import draw, sentence

    seen = read_cloud(cloud)
    view = with_objects(perceive(seen), cloud)
    told = labels_of(view, seen, labels)
    if picture is not None:
        draw(view, picture)
    if is_json:
        say(json.dumps(as_json(view, told)))
        return
    say(sentence(view))
    if view.num_cut:
        say(f"Left out: {view.num_cut} that the image border cuts.")
    say("\n".join(["", *_table(view, told)]))


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
