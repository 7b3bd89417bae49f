"""``halfseen look``: what a depth camera sees on a table, who hides whom, and what looks dirty.

``halfseen watch``: a page in the browser that shows a run in 3-D, and why.
"""

import json
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import click

from halfseen.cli import options
from halfseen.cli.inputs import check_kind, law_of, perceived, refuse_output
from halfseen.cli.messages import say, tell_error
from halfseen.cli.options import SHIPPED
from halfseen.errors import ArgumentError, CloudError, PolicyError
from halfseen.progress import Progress
from halfseen.text_table import aligned

if TYPE_CHECKING:
    from halfseen.perception import Cloud, View
    from halfseen.tables.first_look import FirstLook
    from halfseen.view import Watched
    from halfseen.workers import Workers


HEAD = ["cloud", "objects", "upright", "lying", "cut", "half hidden", "most hidden"]
ENDINGS = (".pcd", ".ply", ".npz")  # of cloud files in a folder


@options.command("halfseen look table.pcd --picture table.png")
@options.unused_seed
def look(
    clouds: tuple[Path, ...],
    *,
    is_json: Annotated[bool, {"flags": "--json"}] = False,
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


def _seen_in(look: "Callable[[Cloud, View, Path], Any]", cloud: Path) -> Any:
    """Look at a cloud; an error is returned, so that the other clouds are still processed."""
    try:
        return look(*perceived(cloud), cloud)
    except CloudError as error:
        return error


def _named_facts(seen: "Cloud", view: "View", cloud: Path) -> dict[str, Any]:
    from halfseen.tables.first_look import first_look

    return {"cloud": str(cloud), **_facts(view, first_look(view, seen))}


def _row(_: "Cloud", view: "View", cloud: Path) -> list[str]:
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


FORMS = (".html", ".gif")
KINDS_OF = {
    "policy": ("cloud", "logs"),
    "history": ("cloud",),
    "labels": ("cloud",),
    "law": ("cloud",),
    "clouds": ("logs",),
    "trajectory": ("logs",),
}
"""Kinds of sources that each option applies to."""


def _span(_: click.Context, __: click.Parameter, given: str | None) -> tuple[int, int] | None:
    """Parse ``2-5`` or ``2``."""
    if given is None:
        return None
    first, *last = given.split("-", 1)
    last = last[0] if last else first
    if not (first.isdigit() and last.isdigit() and 1 <= int(first) <= int(last)):
        raise click.BadParameter(f"{given!r} is not a span of stages; give one such as 2-5")
    return int(first), int(last)


class Given(NamedTuple):
    """Options that some kinds of sources take.

    Parameters
    ----------
    policy
        For a cloud or logs: the folder of a policy of tables.
    history
        For a cloud: logs whose last trajectory is the current one.
    clouds
        For logs: folder with the cloud of each stage.
    trajectory
        For logs: the trajectory, from 1; by default the first.
    """

    policy: Path | None = None
    history: Path | None = None
    labels: options.Labels = None
    law: Annotated[str | None, options.law("For a cloud; by default shipped. ")] = None
    clouds: Path | None = None
    trajectory: Annotated[int | None, options.whole(1, options.MOST_EPISODES)] = None


@options.command("halfseen watch table.pcd --policy policy")
@options.unused_seed
def watch(
    source: Path,
    *,
    given: Annotated[Given, options.Gathered(Given)],
    stages: Annotated[tuple[int, int] | None, {"callback": _span, "metavar": "FIRST-LAST"}] = None,
    export: tuple[Path, ...] = (),
    overwrite: bool = False,
    port: options.Port = 8080,
) -> None:
    """Show in the browser what was seen and decided, in 3-D, and why. Nothing leaves this machine.

    SOURCE is a point cloud as `halfseen look` takes it, with --policy for what is decided there; a recording, as
    `halfseen cell run --record` writes it; or a folder of logs with --clouds, as `halfseen convert` writes them.

    Parameters
    ----------
    stages
        Show only these stages, counted from 1.
    export
        Write it to a file instead: .html, which opens without a server, or .gif; may be given more than once.
    overwrite
        Replace a file of --export that is already there.
    """
    from halfseen.view.recording import MARKER, read_recording

    for file in export:
        refuse_output(file, "an exported run", FORMS, overwrite, [source])
    if not source.exists():
        raise ArgumentError(f"{source}: no such file or folder; give a cloud, a recording or a folder of logs")
    kind = "recording" if (source / MARKER).is_file() else "logs" if source.is_dir() else "cloud"
    check_kind(given, KINDS_OF, kind, f"{source} is of kind {kind}")
    if kind == "recording":
        runs = iter([read_recording(source)])
    elif kind == "logs":
        runs = _of_logs(source, given.clouds, given.trajectory, given.policy)
    else:
        runs = _of_cloud(source, given.policy, given.history, given.labels, given.law)
    shown = (_of_stages(stages, watched) for watched in runs)
    if export:
        _export(export, list(shown)[-1])
    else:
        _serve(port, shown)


def _of_stages(span: tuple[int, int] | None, watched: "Watched") -> "Watched":
    """The run restricted to a span of stages."""
    first, last = span or (1, len(watched.stages))
    if last > len(watched.stages):
        raise ArgumentError(f"--stages is {first}-{last}, but the last stage is {len(watched.stages)}; leave it out")
    return replace(watched, stages=watched.stages[first - 1 : last])


def _serve(port: int, shown: "Iterable[Watched]") -> None:
    from halfseen.view.viewer import Page

    with closing(Page(port)) as page:
        for number, watched in enumerate(shown):
            page.show(watched)
            if number == 0:
                say(f"{page.url}  (Ctrl+C ends)")
        page.wait()


def _export(files: tuple[Path, ...], watched: "Watched") -> None:
    for file in files:
        if file.suffix.lower() == ".gif":
            from halfseen.view.recording import write_gif

            write_gif(watched, file)
        else:
            from halfseen.view.viewer import write_html

            write_html(watched, file)
        say(f"{file}: {len(watched.stages)} stage{'' if len(watched.stages) == 1 else 's'}")


def _of_cloud(
    file: Path, policy: Path | None, history: Path | None, labels: Path | None, law: str | None
) -> "Iterator[Watched]":
    """First the view, unless there is a history; then the decision."""
    from halfseen.tables.first_look import first_look
    from halfseen.view.stages import watched_cloud

    for option, value in (("--history", history), ("--law", law)):
        if policy is None and value is not None:
            raise ArgumentError(f"{option} needs a policy to decide; give a --policy, or leave {option} out")
    cloud, view = perceived(file)
    if policy is None:
        yield watched_cloud(cloud, view, None, None, 0, first_look(view, cloud, labels))
        return
    from halfseen.policies import decider_of, read_policy
    from halfseen.policies.folder.stored import UNDECIDED, refuse_team
    from halfseen.policies.observations import read_observation
    from halfseen.tables.present import Present

    stored = read_policy(policy)
    refuse_team(stored, UNDECIDED, policy)
    if not stored.is_table:
        raise PolicyError(f"{policy}: not a policy of tables, but {file} is a cloud; learn one from logs of tables")
    schema = stored.record["schema"]
    known = law_of(law or SHIPPED) if stored.counts_views else None
    if history is None:
        dirt = first_look(view, cloud, labels, schema["dirty_share"], *([known.seeing] if known else []))
        yield watched_cloud(cloud, view, None, None, 0, dirt)
    now = read_observation(stored, file, history, None, labels, known)
    assert isinstance(now, Present), "a policy of tables decides where a table's trajectory stands"
    yield watched_cloud(cloud, view, now, decider_of(stored, extrapolates=True).decide(now), stored.horizon)


def _of_logs(folder: Path, clouds: Path | None, number: int | None, policy: Path | None) -> "Iterator[Watched]":
    from halfseen.logs import read_logs
    from halfseen.policies import read_policy
    from halfseen.view.stages import watched_logs

    logs = read_logs(folder)
    if clouds is None:
        raise ArgumentError(
            f"{folder}: logs hold no clouds; give a folder with the cloud of each stage by --clouds, or record a run "
            "with `halfseen cell run --record`"
        )
    stored = None if policy is None else read_policy(policy)
    yield watched_logs(logs, clouds, number or 1, stored)
