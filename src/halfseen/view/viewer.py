"""A run in 3-D: its scene, the viewer's server on this machine, and one file that opens without a server.

The viewer is viser. MuJoCo's own web viewer was tried beside it: it draws a MuJoCo model, so that each point of a cloud
would be a geom (with 20,000 of the 300,000, Chromium on a software renderer stopped answering), its controls are drawn
into the canvas, where no narrow screen can rearrange them, and it needs its server; viser draws points as points and
keeps a scene as one file.
"""

import contextlib
import io
import json
import os
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

import numpy as np

from halfseen.errors import ArgumentError
from halfseen.installation import command_for
from halfseen.view.shapes import Mesh
from halfseen.view.stage_view import (
    ARROW,
    GHOST,
    HAND,
    SHADOW,
    Colour,
    Part,
    Poses,
    Shown,
    StageView,
    Watched,
    dirty_colour,
    stage_html,
)
from halfseen.writing import write_file

if TYPE_CHECKING:
    from viser import SceneApi, ViserServer

HERE = "127.0.0.1"  # the only address that is served
LAYERS = {
    "cloud": "cloud",
    "shapes": "completed shapes, by P(DIRTY)",
    "shadows": "what nobody can see",
    "hides": "who hides whom",
    "reveals": "what LIFT would reveal",
    "cell": "arm and table",
    "grasp": "planned grasp",
}
"""Names of the layers, and what they show, in words."""

_POINT_M = 0.0022
_CAMERA = (30, 30, 30)
_ABOVE_M = np.array([0.0, 0.0, 0.10])
_LARGER = 1.05
_FINGER_WIDE_M, _WAY_M = 0.010, 0.004
_THINNEST_M, _THICKEST_M = 0.0015, 0.006
_MOMENT_S, _STAGE_S = 0.2, 3.0


class Scene:
    """Draws stages into a scene of the viewer, one in place of another, in layers that can be hidden.

    Parameters
    ----------
    scene
        Of a `viser.ViserServer`.
    """

    def __init__(self, scene: "SceneApi") -> None:
        self._scene: Any = scene
        scene.configure_default_lights(cast_shadow=False)
        # The viewer's picture of the surroundings takes most of the time of a renderer without a GPU.
        scene.configure_environment_map(None)
        scene.add_light_ambient("/light", intensity=2.2)
        self._layers = {name: scene.add_frame(f"/{name}", show_axes=False) for name in LAYERS}
        self._drawn: list[Any] = []
        self._bodies: list[Any] = []
        self._parts: tuple[Part, ...] = ()

    def set_visible(self, layer: str, is_visible: bool) -> None:
        """Show or hide a layer."""
        self._layers[layer].visible = is_visible

    def show(self, stage: StageView, parts: tuple[Part, ...]) -> None:
        """Draw a stage, and the bodies of the cell where it has poses."""
        for handle in self._drawn:
            handle.remove()
        self._drawn = [
            *self._cloud(stage),
            *(handle for shown in stage.objects for handle in self._object(shown)),
            *self._relations(stage),
        ]
        parts = parts if len(stage.poses) else ()
        if parts is not self._parts:
            for handle in self._bodies:
                handle.remove()
            self._parts = parts
            self._bodies = [
                self._mesh(f"/cell/{number}", part.solid, part.colour, 0.85) for number, part in enumerate(parts)
            ]
        self.place(stage.poses, 0)

    def place(self, poses: Poses, moment: int) -> None:
        """Put the bodies of the cell where they are at a moment."""
        for handle, pose in zip(self._bodies, poses[moment] if len(poses) else [], strict=True):
            handle.position, handle.wxyz = tuple(pose[:3].tolist()), tuple(pose[3:].tolist())

    def _mesh(self, name: str, mesh: Mesh, colour: Colour, opacity: float) -> Any:
        vertices_m, faces = mesh.vertices_m.astype(np.float32), mesh.faces.astype(np.uint32)
        shade: Any = {"cast_shadow": False, "receive_shadow": False}
        return self._scene.add_mesh_simple(name, vertices_m, faces, color=colour, opacity=opacity, **shade)

    def _cloud(self, stage: StageView) -> Iterator[Any]:
        points: Any = {"point_size": _POINT_M, "precision": "float32", "point_shading": "flat"}
        yield self._scene.add_point_cloud("/cloud/points", stage.points_m.astype(np.float32), stage.colours, **points)
        at = tuple(stage.eye_m.tolist())
        yield self._scene.add_icosphere("/cloud/camera", 0.015, _CAMERA, position=at)
        yield self._scene.add_label("/cloud/camera_name", "camera", position=at)

    def _object(self, shown: Shown) -> Iterator[Any]:
        name = str(shown.number)
        if shown.solid is not None and shown.shadow is not None:
            # A little larger, so that the points of its walls do not cover it.
            larger_m = shown.middle_m + _LARGER * (shown.solid.vertices_m - shown.middle_m)
            larger = Mesh(larger_m, shown.solid.faces)
            yield self._mesh(f"/shapes/{name}", larger, dirty_colour(shown.is_dirty), 0.6)
            yield self._mesh(f"/shadows/{name}", shown.shadow, SHADOW, 0.3)
        above = tuple((shown.middle_m + _ABOVE_M).tolist())
        words = f"{name}: {shown.is_dirty:.2f}" + ("" if shown.solid is not None else ", out of view")
        yield self._scene.add_label(f"/shapes/{name}_name", words, position=above, anchor="bottom-center")

    def _relations(self, stage: StageView) -> Iterator[Any]:
        """Who hides whom, what a LIFT would reveal, and the planned grasp."""
        for arrow in stage.arrows:
            radius_m = _THINNEST_M + (_THICKEST_M - _THINNEST_M) * arrow.share
            yield self._scene.add_arrows(
                f"/hides/{arrow.hider.number}_{arrow.hidden.number}",
                arrow.ends_m[None].astype(np.float32),
                np.array(ARROW, dtype=np.uint8),
                shaft_radius=radius_m,
                head_radius=2.5 * radius_m + 0.002,
                head_length=0.022,
            )
        revealed_m = stage.revealed_m.astype(np.float32)
        if len(revealed_m):
            ghosts: Any = {"point_size": 0.004, "point_shape": "circle"}
            yield self._scene.add_point_cloud("/reveals/points", revealed_m, GHOST, **ghosts)
        if stage.hand is not None:
            way_m = np.stack([stage.hand.way_m[:-1], stage.hand.way_m[1:]], axis=1)
            for name, lines_m, thick_m in (("way", way_m, _WAY_M), ("hand", stage.hand.lines_m, _FINGER_WIDE_M)):
                colour = np.array(HAND, dtype=np.uint8)
                lines_m = lines_m.astype(np.float32)
                yield self._scene.add_line_segments(f"/grasp/{name}", lines_m, colour, thickness=thick_m)


def look_from_aside(server: "ViserServer", watched: Watched) -> None:
    """Look at a run from where shadows are seen from aside."""
    camera: Any = server.initial_camera
    camera.position, camera.look_at = (tuple(place_m.tolist()) for place_m in watched.stages[0].viewpoint)


def local_server(port: int) -> "ViserServer":
    """Start a server of the viewer that only this machine reaches; raises what `Page` does."""
    try:
        import viser
    except ImportError as error:
        raise ArgumentError(f"the viewer is not installed ({error}); run: {command_for('watch')}") from error

    class _OfThisMachine(viser.ViserServer):
        """A server that nobody else can look at: the viewer's own can be shared by way of a public one."""

        def request_share_url(self, verbose: bool = True) -> None:
            """Share nothing."""

    with contextlib.redirect_stdout(io.StringIO()):
        server = _OfThisMachine(host=HERE, port=port, label="halfseen watch", verbose=False)
    # The viewer goes on to the next port where one is taken.
    if port and server.get_port() != port:
        stop(server)
        raise ArgumentError(f"--port is {port}, and something else is served there; choose another port, or 0 for any")
    return server


def stop(server: "ViserServer") -> None:
    """Serve no longer, without a word on standard output."""
    with contextlib.redirect_stdout(io.StringIO()):
        server.stop()


def write_html(watched: Watched, file: str | os.PathLike[str]) -> None:
    """Write a run as one page that opens in a browser without a server, and asks for nothing.

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
    page = Template(files("halfseen.view").joinpath("standalone.html").read_text(encoding="utf-8"))
    filled = page.substitute(
        source=watched.source.replace("<", "&lt;"),
        stages=_script([stage_html(stage) for stage in watched.stages]),
        begins=_script(begins),
        scene=_script(scene),
    )
    write_file(Path(file), filled)


def _played(server: "ViserServer", watched: Watched) -> tuple[list[float], str]:
    """When each stage begins in the viewer's recording [s], and the viewer with its recording."""
    look_from_aside(server, watched)
    scene, is_still = Scene(server.scene), len(watched.stages) == 1 and len(watched.stages[0].poses) < 2
    recorded = server.get_scene_serializer()
    now_s, begins = 0.0, []
    for stage in watched.stages:
        begins.append(round(now_s, 3))
        scene.show(stage, watched.parts)
        for moment in range(1, len(stage.poses)):
            recorded.insert_sleep(_MOMENT_S)
            now_s += _MOMENT_S
            scene.place(stage.poses, moment)
        if not is_still:
            recorded.insert_sleep(_STAGE_S)
            now_s += _STAGE_S
    return begins, recorded.as_html()


def _script(value: Any) -> str:
    """A value for a script of the page: no text in it ends the script."""
    return json.dumps(value).replace("</", "<\\/").replace("<!--", "<\\!--")
