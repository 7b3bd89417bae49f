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
from halfseen.watch.drawing import fingers_m, viewpoint
from halfseen.watch.shapes import Mesh, moved
from halfseen.watch.stage_view import Part, StageView, Watched
from halfseen.watch.wording import dirty_colour
from halfseen.writing import write_file

_WIDTH_PX, _HEIGHT_PX, _CAPTION_PX, _MARGIN_PX = 640, 420, 52, 10
_FOCAL_PX = 0.75 * _WIDTH_PX
_MOMENT_MS, _STAGE_MS = 300, 1800
_NUM_COLOURS = 96
_EVERY = 5
"""Every so manyth moment is drawn."""
_SHADOW, _GHOST, _HAND, _ARROW = (40, 40, 60, 70), (0, 158, 115, 255), (204, 121, 167, 255), (20, 20, 20, 255)
_SMALLEST_ARROW_SHARE = 0.02

Pixels = Float[np.ndarray, "n 2"]


def write_gif(watched: Watched, file: str | os.PathLike[str]) -> None:
    """Write a run as an animated GIF.

    Parameters
    ----------
    watched
        The run.
    file
        Where to.

    Raises
    ------
    ArgumentError
        The file cannot be written.
    """
    from_m, at_m = viewpoint(watched.stages[0])
    lens = _Lens(from_m[0], at_m[0])
    pictures, held_ms = [], []
    for stage in watched.stages:
        behind = _with_points(lens, stage)
        moments = range(0, max(len(stage.poses), 1), _EVERY)
        pictures += [_drawn(lens, behind, stage, watched.parts, moment) for moment in moments]
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


def _with_points(lens: _Lens, stage: StageView) -> UInt8[np.ndarray, "H W 3"]:
    """The cloud: the nearest point of each pixel, and of the pixels beside it."""
    picture = np.full((_HEIGHT_PX, _WIDTH_PX, 3), 255, dtype=np.uint8)
    pixels, ahead_m = lens.seen(stage.points_m)
    order = np.argsort(-ahead_m, kind="stable")
    order = order[ahead_m[order] > 0.05]
    column, row = np.floor(pixels[order]).astype(np.int64).T
    for down, along in (*product((-1, 0, 1), repeat=2), (0, 0)):
        inside = (row + down >= 0) & (row + down < _HEIGHT_PX) & (column + along >= 0) & (column + along < _WIDTH_PX)
        picture[row[inside] + down, column[inside] + along] = stage.colours[order][inside]
    return picture


def _drawn(
    lens: _Lens, behind: UInt8[np.ndarray, "H W 3"], stage: StageView, parts: tuple[Part, ...], moment: int
) -> Image.Image:
    whole = Image.new("RGB", (_WIDTH_PX, _HEIGHT_PX + _CAPTION_PX), (255, 255, 255))
    whole.paste(Image.fromarray(behind))
    pen = ImageDraw.Draw(whole, "RGBA")
    for shown in stage.objects:
        if shown.shadow is not None:
            _fill(pen, lens, shown.shadow, _SHADOW)
    font = ImageFont.load_default(13)
    for shown in sorted(stage.objects, key=lambda each: -float(lens.seen(each.middle_m[None])[1][0])):
        if shown.solid is not None:
            _fill(pen, lens, shown.solid, (*dirty_colour(shown.is_dirty), 150))
    lifted = [each for each in stage.objects if each.number == stage.target] or list(stage.objects)
    for x, y in lens.seen(np.concatenate([np.zeros((0, 3)), *(each.revealed_m for each in lifted)]))[0].tolist():
        pen.ellipse((x - 1.5, y - 1.5, x + 1.5, y + 1.5), fill=_GHOST)
    for hidden, hider in np.argwhere(stage.hides >= _SMALLEST_ARROW_SHARE).tolist():
        _arrow(pen, lens, np.stack([stage.objects[k].middle_m for k in (hider, hidden)]))
    if len(stage.poses):
        for part, pose in zip(parts, stage.poses[moment], strict=True):
            if part.is_robot:
                _fill(pen, lens, _placed(part, pose), (*part.colour, 170))
    if stage.hand is not None:
        for line_m in fingers_m(stage.hand):
            pen.line([tuple(pixel) for pixel in lens.seen(line_m)[0].tolist()], fill=_HAND, width=3)
    for shown in stage.objects:
        ((x, y),) = lens.seen(shown.middle_m[None])[0].tolist()
        pen.text((x, y), f"{shown.number}: {shown.is_dirty:.2f}", (0, 0, 0, 255), font, anchor="mm")
    pen.rectangle((0, _HEIGHT_PX, _WIDTH_PX, _HEIGHT_PX + _CAPTION_PX), fill=(255, 255, 255, 255))
    pen.text((_MARGIN_PX, _HEIGHT_PX + 6), stage.title, (40, 40, 45, 255), ImageFont.load_default(15))
    pen.text((_MARGIN_PX, _HEIGHT_PX + 28), _fitting(stage.reason, font), (40, 40, 45, 255), font)
    return whole


def _fitting(words: str, font: "ImageFont.FreeTypeFont | ImageFont.ImageFont") -> str:
    """As much of a sentence as is as wide as the picture."""
    if font.getlength(words) <= _WIDTH_PX - 2 * _MARGIN_PX:
        return words
    kept = words
    while font.getlength(f"{kept} …") > _WIDTH_PX - 2 * _MARGIN_PX:
        kept = kept.rsplit(" ", 1)[0]
    return f"{kept} …"


def _placed(part: Part, pose: Float[np.ndarray, " 7"]) -> Mesh:
    x_m, y_m, z_m, *quaternion = (float(value) for value in pose / np.array([1, 1, 1, *[np.linalg.norm(pose[3:])] * 4]))
    w, x, y, z = quaternion
    return part.solid.moved(Pose((x_m, y_m, z_m), (w, x, y, z)).matrix)


def _fill(pen: ImageDraw.ImageDraw, lens: _Lens, mesh: Mesh, colour: tuple[int, int, int, int]) -> None:
    """Fill the outline of a convex solid: that of its corners in the picture."""
    pixels, ahead_m = lens.seen(mesh.vertices_m)
    if ahead_m.min() < 0.05:
        return
    try:
        outline = pixels[ConvexHull(pixels).vertices]
    except QhullError:
        return
    pen.polygon([tuple(pixel) for pixel in outline.tolist()], fill=colour)


def _arrow(pen: ImageDraw.ImageDraw, lens: _Lens, ends_m: Points) -> None:
    begin, end = lens.seen(moved(ends_m, _RAISED))[0]
    pen.line([tuple(begin.tolist()), tuple(end.tolist())], fill=_ARROW, width=2)
    along = (end - begin) / max(float(np.linalg.norm(end - begin)), 1e-6)
    across = np.array([-along[1], along[0]])
    tip = [end, end - 9 * along + 4 * across, end - 9 * along - 4 * across]
    pen.polygon([tuple(corner.tolist()) for corner in tip], fill=_ARROW)


_RAISED = np.eye(4)
_RAISED[2, 3] = 0.08
