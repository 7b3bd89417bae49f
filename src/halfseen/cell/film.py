"""A film of a running cell: its motion, several times faster, with its decisions as captions."""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

import io
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from math import cos, sin
from pathlib import Path

import mujoco
import numpy as np
from PIL import Image, ImageDraw, ImageFont

from halfseen.cell.live_cell import LiveCell
from halfseen.cell.model import cell_model
from halfseen.cell.workcell import Workcell
from halfseen.perception.clouds import Picture
from halfseen.scene.cups import Stain, Surface
from halfseen.scene.rays import UNSEEN_GROUP
from halfseen.scene.view import cup_name
from halfseen.shapes import Float
from halfseen.writing import write_file

_LIFTED_M, _FLAT_M = 0.0004, 0.0006  # offset of a stain's shape from the wall, and its thickness
_WIDTH_PX, _HEIGHT_PX, _CAPTION_PX, _MARGIN_PX = 600, 400, 28, 10
_PICTURES_PER_S = 8.0
_NUM_FOR_PALETTE = 8
_WOOD, _FLOOR = (0.72, 0.58, 0.42, 1.0), (0.86, 0.87, 0.89, 1.0)


@dataclass(frozen=True)
class Shot:
    """Settings of a film: speed-up, and the camera's target [m], distance [m], azimuth and elevation [°]."""

    speed: float = 8.0
    looks_at_m: tuple[float, float, float] = (0.08, 0.20, 0.80)
    distance_m: float = 1.5
    azimuth_deg: float = 118.0
    elevation_deg: float = -28.0


OF_TWO_ARMS = Shot(looks_at_m=(0.0, 0.16, 0.78), distance_m=1.9, azimuth_deg=97.0, elevation_deg=-30.0)
"""Shows both ends of the table."""


class Film:
    """Records pictures of a running cell; a `halfseen.cell.live_cell.Watch`."""

    def __init__(self, shot: Shot = Shot()) -> None:
        self.shot = shot
        self._caption = ""
        self._kept: list[tuple[Float[np.ndarray, " q"], str]] = []
        self._next_s = 0.0

    def __call__(self, cell: LiveCell) -> None:
        """Record the state of the cell if the next picture is due."""
        if cell.time_s >= self._next_s:
            self._kept.append((cell.data.qpos.copy(), self._caption))
            self._next_s = cell.time_s + self.shot.speed / _PICTURES_PER_S

    def say(self, caption: str) -> None:
        """Set the caption of the following pictures."""
        self._caption = caption

    @property
    def captions(self) -> list[str]:
        """Captions of the pictures so far."""
        return [caption for _, caption in self._kept]

    def write(self, file: Path, cell: Workcell) -> None:
        """Draw the film and write it as an animated GIF.

        Raises
        ------
        ArgumentError
            The file cannot be written.
        """
        pictures = [
            _captioned(picture, caption) for picture, (_, caption) in zip(self._drawn(cell), self._kept, strict=True)
        ]
        reduced = _reduced(pictures)
        held = [*[1000 / _PICTURES_PER_S] * (len(reduced) - 1), 2500]
        content = io.BytesIO()
        reduced[0].save(content, "GIF", save_all=True, append_images=reduced[1:], duration=held, loop=0, optimize=True)
        write_file(file, content.getvalue())

    def _drawn(self, cell: Workcell) -> list[Picture]:
        robots, racks = [each.robot for each in cell.stations], [each.rack for each in cell.stations]
        paint = partial(_paint, cell.surfaces or ())
        model = cell_model(cell.table.cups, cell.table.world_from_cup, robots, racks, paint=paint)
        data, shot = mujoco.MjData(model), self.shot
        # Show furniture, but not the invisible walls by which cups are held.
        shown, camera = mujoco.MjvOption(), mujoco.MjvCamera()
        shown.geomgroup[:] = [group != UNSEEN_GROUP for group in range(len(shown.geomgroup))]
        camera.lookat[:], camera.distance = shot.looks_at_m, shot.distance_m
        camera.azimuth, camera.elevation = shot.azimuth_deg, shot.elevation_deg
        pictures = []
        with mujoco.Renderer(model, _HEIGHT_PX, _WIDTH_PX) as renderer:
            for places, _ in self._kept:
                data.qpos[:] = places
                mujoco.mj_forward(model, data)
                renderer.update_scene(data, camera, shown)
                pictures.append(renderer.render())
        return pictures


def _paint(surfaces: Sequence[Surface], spec: mujoco.MjSpec) -> None:
    """Give a cell its colours: glazes, stains and spots, a wooden table, light from above."""
    spec.visual.global_.offwidth, spec.visual.global_.offheight = 1280, 960
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.45] * 3, [0.25] * 3
    spec.worldbody.add_light(pos=[0.6, -0.9, 2.4], dir=[-0.25, 0.45, -1.0], castshadow=True, diffuse=[0.55] * 3)
    for geom in spec.worldbody.geoms:
        geom.rgba = list(_WOOD if 0.6 < geom.pos[2] < 0.75 else _FLOOR)
    for index, surface in enumerate(surfaces):
        body = spec.body(cup_name(index))
        for geom in body.geoms:
            geom.rgba = [*(channel / 255 for channel in surface.glaze), 1.0]
        for stain in (*surface.stains, *surface.spots):
            _add_disc(body, surface, stain)


def _add_disc(body: mujoco.MjsBody, surface: Surface, stain: Stain) -> None:
    cup = surface.cup
    outward_m = cup.radius_at(stain.height_m) + _LIFTED_M
    away_m = outward_m - cup.wall_m - 2 * _LIFTED_M if stain.is_inside else outward_m
    side = (cos(stain.angle_rad), sin(stain.angle_rad))
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_ELLIPSOID,
        size=[stain.radius_m, stain.radius_m, _FLAT_M],
        pos=[away_m * side[0], away_m * side[1], stain.height_m],
        zaxis=[*side, 0.0],
        rgba=[*(channel / 255 for channel in stain.colour), 1.0],
        mass=0,
        contype=0,
        conaffinity=0,
    )


def _reduced(pictures: list[Image.Image]) -> list[Image.Image]:
    """The pictures in 256 colours with one shared palette, so that static parts are stored once."""
    some = pictures[:: max(1, len(pictures) // _NUM_FOR_PALETTE)]
    width, height = pictures[0].size
    strip = Image.new("RGB", (width, height * len(some)))
    for row, picture in enumerate(some):
        strip.paste(picture, (0, row * height))
    palette = strip.quantize(256, Image.Quantize.MAXCOVERAGE)
    return [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]


def _captioned(picture: Picture, caption: str) -> Image.Image:
    height, width, _ = picture.shape
    whole = Image.new("RGB", (width, height + _CAPTION_PX), (255, 255, 255))
    whole.paste(Image.fromarray(picture))
    ImageDraw.Draw(whole).text((_MARGIN_PX, height + 5), caption, (40, 40, 45), ImageFont.load_default(16))
    return whole
