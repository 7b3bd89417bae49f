"""``halfseen look`` at many clouds: a line each, made by workers, and those that cannot be looked at."""

import json
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from halfseen.cli.columns import aligned
from halfseen.cli.messages import say, tell_error
from halfseen.cli.view_facts import as_json, with_objects
from halfseen.progress import Progress

if TYPE_CHECKING:
    from halfseen.perception import View
    from halfseen.workers import Workers

HEAD = ["cloud", "objects", "upright", "lying", "cut", "half hidden", "most hidden"]
ENDINGS = (".pcd", ".ply", ".npz")
"""Of clouds that are looked for in a folder."""


def clouds_in(places: Sequence[Path]) -> list[Path]:
    """Clouds, and all those of folders, by name.

    Raises
    ------
    ArgumentError
        A folder has none.
    """
    from halfseen.errors import ArgumentError

    found = []
    for place in places:
        those = [place]
        if place.is_dir():
            those = sorted(each for each in place.iterdir() if each.suffix.lower() in ENDINGS)
            if not those:
                raise ArgumentError(f"{place}: no cloud in it ends in {', '.join(ENDINGS)}; name another folder")
        found += those
    return found


def look_at_many(clouds: Sequence[Path], workers: "Workers", is_json: bool) -> None:
    """Look at clouds and print what was seen, in their order.

    Raises
    ------
    CloudError
        After all else is printed: some could not be looked at.
    """
    from halfseen.errors import CloudError

    look = _facts if is_json else _row
    with Progress(len(clouds), "look", "clouds") as bar, workers.ready_if_worth() as pool:
        told: dict[int, Any] = {}
        for number, of_cloud in pool.each(partial(_told, look), clouds):
            told[number] = of_cloud
            bar.update()
    in_order = [told[number] for number in range(len(clouds))]
    seen = [each for each in in_order if not isinstance(each, CloudError)]
    refused = [each for each in in_order if isinstance(each, CloudError)]
    if is_json:
        say(json.dumps(seen))
    elif seen:
        say("\n".join(aligned([HEAD, *seen], left=(0,))))
    for error in refused[:-1]:
        tell_error(str(error))
    if refused:
        raise refused[-1]


def _told(look: "Callable[[View, Path], Any]", cloud: Path) -> Any:
    """Look at a cloud, and tell of it; an error is given back, so that it stops none of the others."""
    from halfseen.errors import CloudError
    from halfseen.perception import perceive, read_cloud

    try:
        return look(with_objects(perceive(read_cloud(cloud)), cloud), cloud)
    except CloudError as error:
        return error


def _facts(view: "View", cloud: Path) -> dict[str, Any]:
    return {"cloud": str(cloud), **as_json(view, None)}


def _row(view: "View", cloud: Path) -> list[str]:
    hidden = [each.occlusion for each in view.objects]
    num_upright = sum(each.is_upright for each in view.objects)
    counts = [len(hidden), num_upright, len(hidden) - num_upright, view.num_cut, sum(each >= 0.5 for each in hidden)]
    return [str(cloud), *map(str, counts), f"{max(hidden):.2f}"]
