"""Runs in 3-D: as a scene, as one file that opens without a server, and as a page served to this machine only.

The viewer is viser. MuJoCo's own viewer is no alternative: each of 300,000 points would be a geom, its controls are in
the canvas, which does not adapt to narrow screens, and it needs its server.
"""

import contextlib
import io
import json
import os
import threading
from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path
from string import Template
from typing import TYPE_CHECKING, Any

import numpy as np

from halfseen.errors import ArgumentError
from halfseen.installation import command_for
from halfseen.view import stage_view
from halfseen.view.shapes import Mesh
from halfseen.view.stage_view import Colour, Part, Poses, Shown, StageView, Watched, dirty_colour, stage_html
from halfseen.writing import write_file

if TYPE_CHECKING:
    from viser import SceneApi, ViserServer

HERE = "127.0.0.1"  # the only address that is served
LAYERS = {
    "cloud": "cloud",
    "shapes": "completed shapes, by P(DIRTY)",
    "shadows": "hidden space",
    "hides": "who hides whom",
    "reveals": "what LIFT would reveal",
    "cell": "arm and table",
    "grasp": "planned grasp",
}
"""Names of the layers, and their content in words."""

_POINT_M = 0.0022
_CAMERA = (30, 30, 30)
_ABOVE_M = np.array([0.0, 0.0, 0.10])
_LARGER = 1.05
_FINGER_WIDE_M, _WAY_M = 0.010, 0.004
_THINNEST_M, _THICKEST_M = 0.0015, 0.006
_MOMENT_S, _STAGE_S = 0.2, 3.0


class ViewerScene:
    """Draws stages into a scene of the viewer, each replacing the last, in layers that can be hidden."""

    def __init__(self, scene: "SceneApi") -> None:
        self._scene: Any = scene
        scene.configure_default_lights(cast_shadow=False)
        # The viewer's environment map takes most of the time of a renderer without a GPU.
        scene.configure_environment_map(None)
        scene.add_light_ambient("/light", intensity=2.2)
        self.layers = {name: scene.add_frame(f"/{name}", show_axes=False) for name in LAYERS}
        self._drawn: list[Any] = []
        self._bodies: list[Any] = []
        self._parts: tuple[Part, ...] = ()

    def show(self, stage: StageView, parts: tuple[Part, ...]) -> None:
        """Draw a stage, and the bodies of the cell if it has poses."""
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
        """Move the bodies of the cell to their poses at a moment."""
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
            yield self._mesh(f"/shadows/{name}", shown.shadow, stage_view.SHADOW, 0.3)
        above = tuple((shown.middle_m + _ABOVE_M).tolist())
        words = f"{name}: {shown.is_dirty:.2f}" + ("" if shown.solid is not None else ", out of view")
        yield self._scene.add_label(f"/shapes/{name}_name", words, position=above, anchor="bottom-center")

    def _relations(self, stage: StageView) -> Iterator[Any]:
        """Occlusions, what a LIFT would reveal, and the planned grasp."""
        for arrow in stage.arrows:
            radius_m = _THINNEST_M + (_THICKEST_M - _THINNEST_M) * arrow.share
            yield self._scene.add_arrows(
                f"/hides/{arrow.hider.number}_{arrow.hidden.number}",
                arrow.ends_m[None].astype(np.float32),
                np.array(stage_view.ARROW, dtype=np.uint8),
                shaft_radius=radius_m,
                head_radius=2.5 * radius_m + 0.002,
                head_length=0.022,
            )
        revealed_m = stage.revealed_m.astype(np.float32)
        if len(revealed_m):
            ghosts: Any = {"point_size": 0.004, "point_shape": "circle"}
            yield self._scene.add_point_cloud("/reveals/points", revealed_m, stage_view.GHOST, **ghosts)
        if stage.hand is not None:
            way_m = np.stack([stage.hand.way_m[:-1], stage.hand.way_m[1:]], axis=1)
            for name, lines_m, thick_m in (("way", way_m, _WAY_M), ("hand", stage.hand.lines_m, _FINGER_WIDE_M)):
                colour = np.array(stage_view.HAND, dtype=np.uint8)
                lines_m = lines_m.astype(np.float32)
                yield self._scene.add_line_segments(f"/grasp/{name}", lines_m, colour, thickness=thick_m)


def look_from_aside(server: "ViserServer", watched: Watched) -> None:
    """Place the camera to the side, where shadows are visible."""
    camera: Any = server.initial_camera
    camera.position, camera.look_at = (tuple(place_m.tolist()) for place_m in watched.stages[0].viewpoint)


def local_server(port: int) -> "ViserServer":
    """Start a server of the viewer that only this machine reaches; raises the errors of `Page`."""
    try:
        import viser
    except ImportError as error:
        raise ArgumentError(f"the viewer is not installed ({error}); run: {command_for('watch')}") from error

    class _OfThisMachine(viser.ViserServer):
        """A server that cannot be shared: the viewer's own can be, through a public server."""

        def request_share_url(self, verbose: bool = True) -> None:
            """Share nothing."""

        def stop(self) -> None:
            """Stop serving, without output."""
            with contextlib.redirect_stdout(io.StringIO()):
                super().stop()

    with contextlib.redirect_stdout(io.StringIO()):
        server = _OfThisMachine(host=HERE, port=port, label="halfseen watch", verbose=False)
    # The viewer would use the next port if this one is taken.
    if port and server.get_port() != port:
        server.stop()
        raise ArgumentError(f"--port is {port}, which is in use; choose another port, or 0 for any")
    return server


def write_html(watched: Watched, file: str | os.PathLike[str]) -> None:
    """Write a run as one page that opens in a browser without a server or network access.

    Raises
    ------
    ArgumentError
        The viewer is not installed, or the file cannot be written.
    """
    server = local_server(0)
    try:
        begins, scene = _played(server, watched)
    finally:
        server.stop()
    filled = Template(files("halfseen.view").joinpath("standalone.html").read_text(encoding="utf-8")).substitute(
        source=watched.source.replace("<", "&lt;"),
        stages=_script([stage_html(stage) for stage in watched.stages]),
        begins=_script(begins),
        scene=_script(scene),
    )
    write_file(Path(file), filled)


def _played(server: "ViserServer", watched: Watched) -> tuple[list[float], str]:
    """Start of each stage in the viewer's recording [s], and the viewer with its recording."""
    look_from_aside(server, watched)
    scene, is_still = ViewerScene(server.scene), len(watched.stages) == 1 and len(watched.stages[0].poses) < 2
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
    """A value for a script of the page, escaped so that its text cannot end the script."""
    return json.dumps(value).replace("</", "<\\/").replace("<!--", "<\\!--")


_LIVE_MOMENT_S, _LIVE_STAGE_S = 0.12, 2.0
_EMPTY = '<div class="halfseen-stage" style="padding:0 0.75em"><p>looking …</p></div>'


class Page:
    """A page at `url` until it is closed: a stage in 3-D, its reasons beside it, and a slider over the stages.

    Raises
    ------
    ArgumentError
        The viewer is not installed, or the port (0 for any that is free) is taken.
    """

    def __init__(self, port: int) -> None:
        self._server = local_server(port)
        self.url = f"http://{HERE}:{self._server.get_port()}"
        self._lock = threading.RLock()
        self._watched: Watched | None = None
        self._index, self._is_playing = 0, False
        self._stop = threading.Event()
        self._scene = ViewerScene(self._server.scene)
        self._add_controls()

    def close(self) -> None:
        """Stop serving."""
        self._stop.set()
        self._server.stop()

    def wait(self) -> None:
        """Serve until interrupted."""
        with contextlib.suppress(KeyboardInterrupt):
            while not self._stop.wait(3600):
                pass

    def show(self, watched: Watched) -> None:
        """Show a run; if the same run grew, keep the stage shown, or follow the newest stage if the last was shown."""
        with self._lock:
            num_before = 0 if self._watched is None else len(self._watched.stages)
            was_last = self._index + 1 >= num_before
            self._watched = watched
            num_stages = len(watched.stages)
            self._slider.max = max(num_stages, 2)
            self._slider.visible = self._buttons.visible = num_stages > 1
            self._play.visible = num_stages > 1 or len(watched.stages[0].poses) > 1
            if num_before == 0:
                look_from_aside(self._server, watched)
            self.go_to(num_stages - 1 if num_before and was_last else min(self._index, num_stages - 1))

    def go_to(self, index: int) -> None:
        """Show the stage of this number, from 0; the nearest if there is none."""
        with self._lock:
            if self._watched is None:
                return
            self._index = max(0, min(index, len(self._watched.stages) - 1))
            if self._slider.value != self._index + 1:
                self._slider.value = self._index + 1
            stage = self._watched.stages[self._index]
            with self._server.atomic():
                self._scene.show(stage, self._watched.parts)
                self._words.content = stage_html(stage)

    def _add_controls(self) -> None:
        gui = self._server.gui
        gui.configure_theme(control_width="large", show_logo=False, show_share_button=False)
        gui.main_panel.dock_right()
        self._slider: Any = gui.add_slider("stage", min=1, max=2, step=1, initial_value=1, visible=False)
        self._buttons: Any = gui.add_button_group("step", ("back", "on"), visible=False)
        self._play: Any = gui.add_button("play", visible=False)
        self._words: Any = gui.add_html(_EMPTY)
        with gui.add_folder("layers", expand_by_default=False):
            for layer, words in LAYERS.items():
                box: Any = gui.add_checkbox(words, True)
                box.on_update(lambda _, layer=layer, box=box: setattr(self._scene.layers[layer], "visible", box.value))

        @self._slider.on_update
        def _(event: Any) -> None:
            if event.client is not None:
                self.go_to(int(self._slider.value) - 1)

        @self._buttons.on_click
        def _(_: Any) -> None:
            self.go_to(self._index + (1 if self._buttons.value.startswith("on") else -1))

        @self._play.on_click
        def _(_: Any) -> None:
            self._set_playing(not self._is_playing)

    def _set_playing(self, is_playing: bool) -> None:
        with self._lock:
            self._is_playing = is_playing
            self._play.label = "pause" if is_playing else "play"
        if is_playing:
            threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        """Play from the stage shown; from the first if that is the last."""
        assert self._watched is not None, "a recording is shown before it is played"
        if self._index + 1 == len(self._watched.stages) > 1:
            self.go_to(0)
        while self._is_playing:
            index = self._index
            if not self._moved(self._watched.stages[index].poses, index) or not self._is_playing:
                return
            if index != self._index:
                continue
            if index + 1 >= len(self._watched.stages):
                self._set_playing(False)
                return
            self.go_to(index + 1)

    def _moved(self, poses: Poses, index: int) -> bool:
        """Move the arm through a stage, or wait; False if the page was closed or paused in the meantime.

        It ends early if the user goes to another stage.
        """
        if len(poses) < 2:
            return not self._stop.wait(_LIVE_STAGE_S) and self._is_playing
        for moment in range(len(poses)):
            with self._lock:
                if self._index == index and self._is_playing:
                    with self._server.atomic():
                        self._scene.place(poses, moment)
            if self._index != index:
                return True
            if not self._is_playing or self._stop.wait(_LIVE_MOMENT_S):
                return False
        return True
