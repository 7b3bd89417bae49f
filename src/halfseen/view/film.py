"""A run as an animated picture: points, outlines and words, drawn without a viewer."""

import io
import os
from itertools import product
from pathlib import Path

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from scipy.spatial import ConvexHull, QhullError

from halfseen.arrays import Points
from halfseen.perception.clouds import Vector
from halfseen.scene.poses import Pose
from halfseen.shapes import Float, UInt8
from halfseen.view.shapes import Mesh
from halfseen.view.stage_view import ARROW, GHOST, HAND, SHADOW, Part, StageView, Watched, dirty_colour
from halfseen.writing import write_file

_WIDTH_PX, _HEIGHT_PX, _CAPTION_PX, _MARGIN_PX = 640, 420, 52, 10
_FOCAL_PX = 0.75 * _WIDTH_PX
_NEAREST_M = 0.05
_MOMENT_MS, _STAGE_MS = 300, 1800
_NUM_COLOURS = 96
_EVERY = 5  # every so manyth moment is drawn
_WORDS = (40, 40, 45, 255)

Colour = tuple[int, int, int, int]
Pixels = Float[np.ndarray, "n 2"]


def write_gif(watched: Watched, file: str | os.PathLike[str]) -> None:
    """Write a run as an animated GIF.

    Raises
    ------
    ArgumentError
        The file cannot be written.
    """
    lens = _Lens(*watched.stages[0].viewpoint)
    pictures, held_ms = [], []
    for stage in watched.stages:
        behind = _with_points(lens, stage)
        moments = range(0, max(len(stage.poses), 1), _EVERY)
        pictures += [_picture(lens, behind, stage, watched.parts, moment) for moment in moments]
        held_ms += [*[_MOMENT_MS] * (len(moments) - 1), _STAGE_MS]
    content = io.BytesIO()
    # One palette for all, so that what stands still is stored once.
    palette = pictures[len(pictures) // 2].quantize(_NUM_COLOURS, Image.Quantize.MAXCOVERAGE)
    reduced = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    reduced[0].save(content, "GIF", save_all=True, append_images=reduced[1:], duration=held_ms, loop=0, optimize=True)
    write_file(Path(file), content.getvalue())


class _Lens:
    """A pinhole camera that looks from a place at another."""

    def __init__(self, from_m: Vector, at_m: Vector) -> None:
        ahead = (at_m - from_m) / np.linalg.norm(at_m - from_m)
        right = np.cross(ahead, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        self._from_m, self._axes = from_m, np.stack([right, np.cross(ahead, right), ahead])

    def seen(self, points_m: Points) -> tuple[Pixels, Float[np.ndarray, " n"]]:
        """Where points are in the picture [px], and how far ahead [m]."""
        camera_m = (points_m - self._from_m) @ self._axes.T
        ahead_m = np.maximum(camera_m[:, 2], 1e-3)
        middle_px = np.array([0.5 * _WIDTH_PX, 0.7 * _HEIGHT_PX])
        return middle_px + _FOCAL_PX * camera_m[:, :2] / ahead_m[:, None], camera_m[:, 2]

    def pixels(self, points_m: Points) -> list[tuple[float, float]]:
        """Where points are in the picture [px], for a pen."""
        return [(x, y) for x, y in self.seen(points_m)[0].tolist()]


def _with_points(lens: _Lens, stage: StageView) -> UInt8[np.ndarray, "H W 3"]:
    """The cloud: the nearest point of each pixel, and of the pixels beside it."""
    picture = np.full((_HEIGHT_PX, _WIDTH_PX, 3), 255, dtype=np.uint8)
    pixels, ahead_m = lens.seen(stage.points_m)
    order = np.argsort(-ahead_m, kind="stable")
    order = order[ahead_m[order] > _NEAREST_M]
    column, row = np.floor(pixels[order]).astype(np.int64).T
    for down, along in (*product((-1, 0, 1), repeat=2), (0, 0)):
        inside = (row + down >= 0) & (row + down < _HEIGHT_PX) & (column + along >= 0) & (column + along < _WIDTH_PX)
        picture[row[inside] + down, column[inside] + along] = stage.colours[order][inside]
    return picture


def _picture(
    lens: _Lens, behind: UInt8[np.ndarray, "H W 3"], stage: StageView, parts: tuple[Part, ...], moment: int
) -> Image.Image:
    """Draw a moment: what lies behind first."""
    whole = Image.new("RGB", (_WIDTH_PX, _HEIGHT_PX + _CAPTION_PX), (255, 255, 255))
    whole.paste(Image.fromarray(behind))
    pen, font = ImageDraw.Draw(whole, "RGBA"), ImageFont.load_default(13)
    for shown in stage.objects:
        _fill(pen, lens, shown.shadow, (*SHADOW, 70))
    for shown in sorted(stage.objects, key=lambda each: -float(lens.seen(each.middle_m[None])[1][0])):
        _fill(pen, lens, shown.solid, (*dirty_colour(shown.is_dirty), 150))
    for x, y in lens.pixels(stage.revealed_m):
        pen.ellipse((x - 1.5, y - 1.5, x + 1.5, y + 1.5), fill=(*GHOST, 255))
    for arrow in stage.arrows:
        _arrow(pen, *lens.seen(arrow.ends_m)[0])
    for part, pose in zip(parts, stage.poses[moment], strict=True) if len(stage.poses) else ():
        if part.is_robot:
            _fill(pen, lens, _placed(part, pose), (*part.colour, 170))
    for line_m in [] if stage.hand is None else stage.hand.lines_m:
        pen.line(lens.pixels(line_m), fill=(*HAND, 255), width=3)
    for shown in stage.objects:
        (at,) = lens.pixels(shown.middle_m[None])
        pen.text(at, f"{shown.number}: {shown.is_dirty:.2f}", (0, 0, 0, 255), font, anchor="mm")
    pen.rectangle((0, _HEIGHT_PX, _WIDTH_PX, _HEIGHT_PX + _CAPTION_PX), fill=(255, 255, 255, 255))
    pen.text((_MARGIN_PX, _HEIGHT_PX + 6), stage.title, _WORDS, ImageFont.load_default(15))
    pen.text((_MARGIN_PX, _HEIGHT_PX + 28), _fitting(stage.reason, font), _WORDS, font)
    return whole


def _fitting(words: str, font: "ImageFont.FreeTypeFont | ImageFont.ImageFont") -> str:
    """As much of a sentence as is as wide as the picture."""
    kept, end = words, ""
    while font.getlength(kept + end) > _WIDTH_PX - 2 * _MARGIN_PX:
        kept, end = kept.rsplit(" ", 1)[0] if end else kept, " …"
    return kept + end


def _placed(part: Part, pose: Float[np.ndarray, " 7"]) -> Mesh:
    x_m, y_m, z_m, *turn = (float(value) for value in pose / np.array([1, 1, 1, *[np.linalg.norm(pose[3:])] * 4]))
    w, x, y, z = turn
    return part.solid.moved(Pose((x_m, y_m, z_m), (w, x, y, z)).matrix)


def _fill(pen: ImageDraw.ImageDraw, lens: _Lens, mesh: Mesh | None, colour: Colour) -> None:
    """Fill the outline of a convex solid, if there is one: that of its corners in the picture."""
    if mesh is None:
        return
    pixels, ahead_m = lens.seen(mesh.vertices_m)
    if ahead_m.min() < _NEAREST_M:
        return
    try:
        outline = pixels[ConvexHull(pixels).vertices]
    except QhullError:
        return
    pen.polygon([tuple(pixel) for pixel in outline.tolist()], fill=colour)


def _arrow(pen: ImageDraw.ImageDraw, begin: Float[np.ndarray, " 2"], end: Float[np.ndarray, " 2"]) -> None:
    pen.line([tuple(begin.tolist()), tuple(end.tolist())], fill=(*ARROW, 255), width=2)
    along = (end - begin) / max(float(np.linalg.norm(end - begin)), 1e-6)
    across = np.array([-along[1], along[0]])
    tip = [end, end - 9 * along + 4 * across, end - 9 * along - 4 * across]
    pen.polygon([tuple(corner.tolist()) for corner in tip], fill=(*ARROW, 255))
