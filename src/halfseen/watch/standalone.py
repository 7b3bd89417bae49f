"""A run as one file that opens in a browser without a server, and asks for nothing."""

import json
import os
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import Any

from halfseen.watch.drawing import Drawing, viewpoint
from halfseen.watch.page import local_server, stop
from halfseen.watch.stage_view import Watched
from halfseen.watch.wording import stage_html
from halfseen.writing import write_file

_MOMENT_S, _STAGE_S = 0.2, 3.0


def write_html(watched: Watched, file: str | os.PathLike[str]) -> None:
    """Write a run as a page.

    Parameters
    ----------
    watched
        The run.
    file
        Where to.

    Raises
    ------
    ArgumentError
        The viewer is not installed, or the file cannot be written.
    """
    server = local_server(0)
    try:
        begins, scene = _played(server, watched)
    finally:
        stop(server)
    page = Template(files("halfseen.watch").joinpath("standalone.html").read_text(encoding="utf-8"))
    filled = page.substitute(
        source=watched.source.replace("<", "&lt;"),
        stages=_script([stage_html(stage) for stage in watched.stages]),
        begins=_script(begins),
        scene=_script(scene),
    )
    write_file(Path(file), filled)


def _played(server: Any, watched: Watched) -> tuple[list[float], str]:
    """When each stage begins in the viewer's recording [s], and the viewer with its recording."""
    from_m, at_m = viewpoint(watched.stages[0])
    server.initial_camera.position = tuple(from_m[0].tolist())
    server.initial_camera.look_at = tuple(at_m[0].tolist())
    drawing, is_still = Drawing(server.scene), len(watched.stages) == 1 and len(watched.stages[0].poses) < 2
    recorded = server.get_scene_serializer()
    now_s, begins = 0.0, []
    for stage in watched.stages:
        begins.append(round(now_s, 3))
        drawing.show(stage, watched.parts)
        for moment in range(1, len(stage.poses)):
            recorded.insert_sleep(_MOMENT_S)
            now_s += _MOMENT_S
            drawing.place(stage.poses, moment)
        if not is_still:
            recorded.insert_sleep(_STAGE_S)
            now_s += _STAGE_S
    return begins, recorded.as_html()


def _script(value: Any) -> str:
    """A value for a script of the page: no text in it ends the script."""
    return json.dumps(value).replace("</", "<\\/").replace("<!--", "<\\!--")
