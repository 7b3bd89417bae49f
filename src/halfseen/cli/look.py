"""``halfseen look``: what a depth camera sees on a table, who hides whom, and what looks dirty."""

import json
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from halfseen.cli import options
from halfseen.cli.inputs import perceived, refuse_output
from halfseen.cli.messages import say, tell_error
from halfseen.errors import ArgumentError, CloudError
from halfseen.progress import Progress
from halfseen.text_table import aligned

if TYPE_CHECKING:
    from halfseen.perception import View
    from halfseen.tables.first_look import FirstLook
    from halfseen.workers import Workers

HEAD = ["cloud", "objects", "upright", "lying", "cut", "half hidden", "most hidden"]
ENDINGS = (".pcd", ".ply", ".npz")  # of clouds that are looked for in a folder


@click.command(epilog="Example: halfseen look table.pcd --picture table.png")
@click.argument("clouds", nargs=-1, required=True, type=options.PATH)
@options.flag("--json", "is_json", text="Print JSON, for programs.")
@options.path("--picture", text="Draw what is seen into this PNG file; of one cloud.")
@options.overwrite("a picture that is")
@options.labels
@options.workers
def look(
    clouds: tuple[Path, ...],
    is_json: bool,
    picture: Path | None,
    overwrite: bool,
    labels: Path | None,
    workers: "Workers",
) -> None:
    """Say what stands on the table of a cloud, who hides whom, and, if it has colour, what looks dirty.

    A cloud is a .pcd or .ply point cloud in the frame of the camera, or of the VIEWPOINT that it says [m], with packed
    rgb or red, green and blue if it has colour; or an .npz file with a depth image depth_m [m], a pinhole matrix K [px]
    and, if there is one, a picture rgb. Of several, or of a folder, every cloud has one line; those that cannot be
    read, or show no object, are named below, and the exit status is 2.
    """
    if len(clouds) == 1 and not clouds[0].is_dir():
        if picture is not None:
            refuse_output(picture, "a picture", [".png"], overwrite, [clouds[0], *([labels] if labels else [])])
        _look_at(clouds[0], is_json, picture, labels)
        return
    if picture is not None or labels is not None:
        option, value = ("--picture", picture) if picture is not None else ("--labels", labels)
        raise ArgumentError(f"{option} {value}: it is of one cloud, and there are several; look at that cloud alone")
    _look_at_many(_clouds_in(clouds), workers, is_json)


def _look_at(cloud: Path, is_json: bool, picture: Path | None, labels: Path | None) -> None:
    from halfseen.perception.picture import draw, sentence
    from halfseen.tables.first_look import first_look

    seen, view = perceived(cloud)
    found = first_look(view, seen, labels)
    if picture is not None:
        draw(view, picture)
    if is_json:
        say(json.dumps(_facts(view, found)))
        return
    say(sentence(view))
    if view.num_cut:
        say(f"Left out: {view.num_cut} that the image border cuts.")
    say("\n".join(["", *_table(view, found)]))


def _table(view: "View", found: "FirstLook") -> list[str]:
    header = ["object", "x [m]", "y [m]", "z [m]", "height [m]", "pose", "points", "hidden", "hidden by"]
    rows = [header]
    for seen in view.objects:
        x, y, z = seen.centroid_m
        hiders = sorted(range(len(view.objects)), key=lambda j: (-view.hides[seen.id, j], j))
        by = ", ".join(f"{j} ({view.hides[seen.id, j]:.2f})" for j in hiders if view.hides[seen.id, j] >= 0.005)
        pose = "upright" if seen.is_upright else "lying"
        numbers = [f"{x:.3f}", f"{y:.3f}", f"{z:.3f}", f"{seen.height_m:.3f}"]
        rows.append([str(seen.id), *numbers, pose, str(seen.num_points), f"{seen.occlusion:.2f}", by or "-"])
    if found.labels is not None:
        told = zip(found.labels, found.chances, strict=True)
        labels = [("in view", "label", "P(dirty)")]
        labels += [(f"{label.share_in_view:.2f}", label.word, f"{chance:.2f}") for label, chance in told]
        rows = [[*row, *label] for row, label in zip(rows, labels, strict=True)]
    left = ("pose", "hidden by", "label")
    return aligned(rows, left=tuple(rows[0].index(name) for name in left if name in rows[0]))


def _clouds_in(places: Sequence[Path]) -> list[Path]:
    """Clouds, and all those of folders, by name."""
    found = []
    for place in places:
        those = [place]
        if place.is_dir():
            those = sorted(each for each in place.iterdir() if each.suffix.lower() in ENDINGS)
            if not those:
                raise ArgumentError(f"{place}: no cloud in it ends in {', '.join(ENDINGS)}; name another folder")
        found += those
    return found


def _look_at_many(clouds: Sequence[Path], workers: "Workers", is_json: bool) -> None:
    """Look at clouds and print what was seen, in their order; then refuse those that could not be looked at."""
    with Progress(len(clouds), "look", "clouds") as bar, workers.ready_if_worth() as pool:
        found = []
        for of_cloud in pool.in_order(partial(_seen_in, _named_facts if is_json else _row), clouds):
            found.append(of_cloud)
            bar.update()
    seen = [each for each in found if not isinstance(each, CloudError)]
    refused = [each for each in found if isinstance(each, CloudError)]
    if is_json:
        say(json.dumps(seen))
    elif seen:
        say("\n".join(aligned([HEAD, *seen])))
    for error in refused[:-1]:
        tell_error(str(error))
    if refused:
        raise refused[-1]


def _seen_in(look: "Callable[[View, Path], Any]", cloud: Path) -> Any:
    """Look at a cloud; an error is given back, so that it stops none of the others."""
    try:
        return look(perceived(cloud)[1], cloud)
    except CloudError as error:
        return error


def _named_facts(view: "View", cloud: Path) -> dict[str, Any]:
    return {"cloud": str(cloud), **_facts(view, None)}


def _row(view: "View", cloud: Path) -> list[str]:
    hidden = [each.occlusion for each in view.objects]
    num_upright = sum(each.is_upright for each in view.objects)
    counts = [len(hidden), num_upright, len(hidden) - num_upright, view.num_cut, sum(each >= 0.5 for each in hidden)]
    return [str(cloud), *map(str, counts), f"{max(hidden):.2f}"]


def _facts(view: "View", found: "FirstLook | None") -> dict[str, Any]:
    """Say for programs what stands on the table, and what looks dirty."""
    labels = [{}] * len(view.objects)
    if found is not None and found.labels is not None:
        labels = [
            {"label": label.word, "share_in_view": label.share_in_view, "p_dirty": chance}
            for label, chance in zip(found.labels, found.chances, strict=True)
        ]
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
