"""A stage in the viewer: layers of its scene, each of which can be hidden."""

from typing import TYPE_CHECKING, Any

import numpy as np

from halfseen.arrays import Points
from halfseen.shapes import Float
from halfseen.watch.stage_view import Hand, Part, Poses, Shown, StageView
from halfseen.watch.wording import dirty_colour

if TYPE_CHECKING:
    from viser import SceneApi

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
_SHADOW, _ARROW, _GHOST, _HAND, _EYE = (40, 40, 60), (20, 20, 20), (0, 158, 115), (204, 121, 167), (30, 30, 30)
_ABOVE_M = 0.10
_LARGER = 1.05
_FINGER_M, _FINGER_WIDE_M, _WAY_M = 0.06, 0.010, 0.004
_SMALLEST_ARROW_SHARE = 0.02
_THINNEST_M, _THICKEST_M = 0.0015, 0.006


class Drawing:
    """Draws stages into a scene, one in place of another.

    Parameters
    ----------
    scene
        Of a `viser.ViserServer`.
    """

    def __init__(self, scene: "SceneApi") -> None:
        self._scene = scene
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
        """Draw a stage.

        Parameters
        ----------
        stage
            The stage.
        parts
            Bodies of the cell.
        """
        old, self._drawn = self._drawn, []
        for handle in old:
            handle.remove()
        self._add_cloud(stage)
        for shown in stage.objects:
            self._add_object(shown)
        self._add_arrows(stage)
        self._add_revealed(stage)
        if stage.hand is not None:
            self._add_hand(stage.hand)
        self._set_parts(parts if len(stage.poses) else ())
        self.place(stage.poses, 0)

    def place(self, poses: Poses, moment: int) -> None:
        """Put the bodies of the cell where they are at a moment."""
        for handle, pose in zip(self._bodies, poses[moment] if len(poses) else [], strict=True):
            handle.position, handle.wxyz = tuple(pose[:3].tolist()), tuple(pose[3:].tolist())

    def _add_cloud(self, stage: StageView) -> None:
        points_m, scene = stage.points_m.astype(np.float32), self._scene
        self._drawn.append(
            scene.add_point_cloud(
                "/cloud/points",
                points_m,
                stage.colours,
                point_size=_POINT_M,
                precision="float32",
                point_shading="flat",
            )
        )
        at = tuple(stage.eye_m.tolist())
        self._drawn.append(scene.add_icosphere("/cloud/camera", 0.015, _EYE, position=at))
        self._drawn.append(scene.add_label("/cloud/camera_name", "camera", position=at))

    def _add_object(self, shown: Shown) -> None:
        scene, name = self._scene, str(shown.number)
        if shown.solid is not None and shown.shadow is not None:
            for layer, mesh, colour, opacity in (
                ("shapes", shown.solid, dirty_colour(shown.is_dirty), 0.6),
                ("shadows", shown.shadow, _SHADOW, 0.3),
            ):
                vertices_m = mesh.vertices_m
                if layer == "shapes":  # a little larger, so that the points of its walls do not cover it
                    vertices_m = shown.middle_m + _LARGER * (vertices_m - shown.middle_m)
                handle = scene.add_mesh_simple(
                    f"/{layer}/{name}",
                    vertices_m.astype(np.float32),
                    mesh.faces.astype(np.uint32),
                    color=colour,
                    opacity=opacity,
                    cast_shadow=False,
                    receive_shadow=False,
                )
                self._drawn.append(handle)
        above = tuple((shown.middle_m + np.array([0.0, 0.0, _ABOVE_M])).tolist())
        words = f"{name}: {shown.is_dirty:.2f}" + ("" if shown.solid is not None else ", out of view")
        self._drawn.append(scene.add_label(f"/shapes/{name}_name", words, position=above, anchor="bottom-center"))

    def _add_arrows(self, stage: StageView) -> None:
        for hidden, hider in np.argwhere(stage.hides >= _SMALLEST_ARROW_SHARE).tolist():
            share = float(stage.hides[hidden, hider])
            radius_m = _THINNEST_M + (_THICKEST_M - _THINNEST_M) * share
            ends_m = np.stack([stage.objects[k].middle_m for k in (hider, hidden)])
            handle = self._scene.add_arrows(
                f"/hides/{stage.objects[hider].number}_{stage.objects[hidden].number}",
                _raised(ends_m)[None].astype(np.float32),
                np.array(_ARROW, dtype=np.uint8),
                shaft_radius=radius_m,
                head_radius=2.5 * radius_m + 0.002,
                head_length=0.022,
            )
            self._drawn.append(handle)

    def _add_revealed(self, stage: StageView) -> None:
        """Ghosts of what a LIFT of the target would reveal; of each object that hides, where no other is the target."""
        lifted = [each for each in stage.objects if each.number == stage.target] or list(stage.objects)
        points_m = np.concatenate([np.zeros((0, 3)), *(each.revealed_m for each in lifted)])
        if len(points_m):
            handle = self._scene.add_point_cloud(
                "/reveals/points", points_m.astype(np.float32), _GHOST, point_size=0.004, point_shape="circle"
            )
            self._drawn.append(handle)

    def _add_hand(self, hand: Hand) -> None:
        for name, lines_m, thick_m in (
            ("way", np.stack([hand.way_m[:-1], hand.way_m[1:]], axis=1), _WAY_M),
            ("hand", fingers_m(hand), _FINGER_WIDE_M),
        ):
            handle = self._scene.add_line_segments(
                f"/grasp/{name}", lines_m.astype(np.float32), np.array(_HAND, dtype=np.uint8), thickness=thick_m
            )
            self._drawn.append(handle)

    def _set_parts(self, parts: tuple[Part, ...]) -> None:
        if parts is self._parts:
            return
        for handle in self._bodies:
            handle.remove()
        self._parts = parts
        self._bodies = [
            self._scene.add_mesh_simple(
                f"/cell/{number}",
                part.solid.vertices_m.astype(np.float32),
                part.solid.faces.astype(np.uint32),
                color=part.colour,
                opacity=0.85,
                cast_shadow=False,
                receive_shadow=False,
            )
            for number, part in enumerate(parts)
        ]


def fingers_m(hand: Hand) -> Float[np.ndarray, "lines 2 3"]:
    """Lines of a hand where it is to close: two fingers, and the palm between them."""
    aside, back = 0.5 * hand.opening_m * hand.axes[:, 1], -_FINGER_M * hand.axes[:, 2]
    tips = [hand.at_m - aside, hand.at_m + aside]
    roots = [tip + back for tip in tips]
    palm = hand.at_m + back
    lines = [(tips[0], roots[0]), (tips[1], roots[1]), (roots[0], roots[1]), (palm, palm + back)]
    return np.array(lines, dtype=np.float64)


def _raised(ends_m: Points) -> Points:
    """An arrow over the objects, where it can be seen."""
    return ends_m + np.array([0.0, 0.0, 0.8 * _ABOVE_M])


def viewpoint(stage: StageView) -> tuple[Points, Points]:
    """Where to look from and at, so that shadows are seen from aside: two places [m], one row each."""
    middles_m = np.array([shown.middle_m for shown in stage.objects] or [stage.points_m.mean(axis=0)])
    middle_m = middles_m.mean(axis=0)
    away_m = stage.eye_m - middle_m
    turn = np.deg2rad(40.0)
    turned_m = np.array(
        [
            np.cos(turn) * away_m[0] - np.sin(turn) * away_m[1],
            np.sin(turn) * away_m[0] + np.cos(turn) * away_m[1],
            0.9 * away_m[2],
        ]
    )
    return (middle_m + 0.75 * turned_m)[None], middle_m[None]
