"""``halfseen look``: what a depth camera sees on a table, who hides whom, and what looks dirty."""

import json
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

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
ENDINGS = (".pcd", ".ply", ".npz")  # of cloud files in a folder


@options.command("halfseen look table.pcd --picture table.png")
@options.unused_seed
def look(
    clouds: tuple[Path, ...],
    *,
    is_json: options.Json = False,
    picture: Path | None = None,
    overwrite: bool = False,
    labels: options.Labels = None,
    workers: options.WorkersOption,
) -> None:
    """Say what stands on the table of a cloud, who hides whom, and, if it has colour, what looks dirty.

    A cloud is a .pcd or .ply point cloud in the frame of the camera, or of its VIEWPOINT [m], with packed rgb or red,
    green and blue if it has colour; or an .npz file with a depth image depth_m [m], a pinhole matrix K [px] and
    optionally a picture rgb. For several clouds, or a folder, there is one line for each; clouds that cannot be read,
    or show no object, are named below, and the exit status is 2.

    Parameters
    ----------
    is_json
        Print JSON, for programs.
    picture
        Draw what is seen into this PNG file; for one cloud only.
    overwrite
        Replace a picture that is already there.
    """
    if len(clouds) == 1 and not clouds[0].is_dir():
        if picture is not None:
            refuse_output(picture, "a picture", [".png"], overwrite, [clouds[0], *([labels] if labels else [])])
        _look_at(clouds[0], is_json, picture, labels)
        return
    if picture is not None or labels is not None:
        option, value = ("--picture", picture) if picture is not None else ("--labels", labels)
        raise ArgumentError(f"{option} {value}: it is for one cloud, but several are given; look at that cloud alone")
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
        say(f"Left out: {view.num_cut} cut by the image border.")
    say("\n".join(["", *_table(view, found)]))


def _table(view: "View", found: "FirstLook") -> list[str]:
    from halfseen.perception.view import SMALLEST_OTHER_SHARE, hidden_by_others

    header = ["object", "x [m]", "y [m]", "z [m]", "height [m]", "pose", "points", "hidden", "hidden by"]
    rows = [header]
    for seen in view.objects:
        x, y, z = seen.centroid_m
        hiders = sorted(range(len(view.objects)), key=lambda j: (-view.hides[seen.id, j], j))
        by = [f"{j} ({view.hides[seen.id, j]:.2f})" for j in hiders if view.hides[seen.id, j] >= 0.005]
        if (share := hidden_by_others(view, seen)) >= SMALLEST_OTHER_SHARE:
            by.append(f"other ({share:.2f})")
        pose = "upright" if seen.is_upright else "lying"
        numbers = [f"{x:.3f}", f"{y:.3f}", f"{z:.3f}", f"{seen.height_m:.3f}"]
        rows.append([str(seen.id), *numbers, pose, str(seen.num_points), f"{seen.occlusion:.2f}", ", ".join(by) or "-"])
    if found.labels is not None:
        labelled = zip(found.labels, found.chances, strict=True)
        labels = [("in view", "label", "P(dirty)")]
        labels += [(f"{label.share_in_view:.2f}", label.word, f"{chance:.2f}") for label, chance in labelled]
        rows = [[*row, *label] for row, label in zip(rows, labels, strict=True)]
    left = ("pose", "hidden by", "label")
    return aligned(rows, left=tuple(rows[0].index(name) for name in left if name in rows[0]))


def _clouds_in(places: Sequence[Path]) -> list[Path]:
    """Cloud files, including those in folders, by name."""
    found = []
    for place in places:
        those = [place]
        if place.is_dir():
            those = sorted(each for each in place.iterdir() if each.suffix.lower() in ENDINGS)
            if not those:
                raise ArgumentError(f"{place}: no file in it ends in {', '.join(ENDINGS)}; give a folder of clouds")
        found += those
    return found


def _look_at_many(clouds: Sequence[Path], workers: "Workers", is_json: bool) -> None:
    """Look at clouds and print the results in order; then report those that failed."""
    with Progress(len(clouds), "look", "clouds") as bar, workers.ready_if_worth() as pool:
        found = []
        for of_cloud in pool.in_order(partial(_seen_in, is_json), clouds):
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


def _seen_in(is_json: bool, cloud: Path) -> Any:
    """Look at a cloud; an error is returned, so that the other clouds are still processed."""
    from halfseen.tables.first_look import first_look

    try:
        seen, view = perceived(cloud)
    except CloudError as error:
        return error
    return {"cloud": str(cloud), **_facts(view, first_look(view, seen))} if is_json else _row(cloud, view)


def _row(cloud: Path, view: "View") -> list[str]:
    hidden = [each.occlusion for each in view.objects]
    num_upright = sum(each.is_upright for each in view.objects)
    counts = [len(hidden), num_upright, len(hidden) - num_upright, view.num_cut, sum(each >= 0.5 for each in hidden)]
    return [str(cloud), *map(str, counts), f"{max(hidden):.2f}"]


def _facts(view: "View", found: "FirstLook") -> dict[str, Any]:
    """Facts for programs: the objects on the table, and their labels."""
    labels = [{}] * len(view.objects)
    if found.labels is not None:
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
