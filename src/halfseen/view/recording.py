"""Runs in files: a folder of stages, and an animated picture drawn without a viewer. Reading runs no code.

::

    recording/
      recording.json      format, source, number of stages
      parts.npz           bodies of the cell
      stage-0001.npz …    arrays of a stage, and its text as JSON
"""

import io
import json
import os
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageDraw, ImageFont
from scipy.spatial import ConvexHull, QhullError

from halfseen.arrays import Points
from halfseen.errors import ArgumentError
from halfseen.perception.clouds import Vector
from halfseen.reading import json_of, read_arrays, read_text, reason_of
from halfseen.scene.poses import Pose
from halfseen.shapes import Float, UInt8
from halfseen.view import stage_view
from halfseen.view.shapes import Mesh
from halfseen.view.stage_view import Hand, Option, Part, Shown, StageView, Watched, dirty_colour
from halfseen.writing import placed, write_file

MARKER = "recording.json"  # present in every recording
_FORMAT = 1
_PARTS = "parts.npz"
_STAGE = "stage-{:04d}.npz"

Arrays = dict[str, Any]


def write_recording(watched: Watched, folder: str | os.PathLike[str], *, overwrite: bool = False) -> None:
    """Write a run to a folder, all or nothing.

    Parameters
    ----------
    watched
        The run.
    folder
        Destination.
    overwrite
        Replace an existing recording.

    Raises
    ------
    ArgumentError
        Something is there already and may not be replaced, or the folder cannot be written.
    """
    with placed(Path(folder), overwrite=overwrite, marker=MARKER, kind="recording") as fresh:
        head = {"format": _FORMAT, "source": watched.source, "num_stages": len(watched.stages)}
        (fresh / MARKER).write_text(json.dumps(head, indent=1), encoding="utf-8")
        _write(fresh / _PARTS, _arrays_of_parts(watched.parts))
        for number, stage in enumerate(watched.stages, start=1):
            _write(fresh / _STAGE.format(number), _arrays_of_stage(stage))


def read_recording(folder: str | os.PathLike[str]) -> Watched:
    """Read a run from a folder.

    Parameters
    ----------
    folder
        A folder written by `write_recording`.

    Raises
    ------
    ArgumentError
        The folder is no recording, of a later format, or damaged.
    """
    folder = Path(folder)
    try:
        head = json_of(read_text(folder / MARKER))
        if head["format"] != _FORMAT:
            raise ArgumentError(
                f"{folder}: its format is {head['format']}, but this halfseen reads {_FORMAT}; use a later halfseen"
            )
        parts = _parts_of(read_arrays(folder / _PARTS))
        files = [folder / _STAGE.format(number) for number in range(1, head["num_stages"] + 1)]
        return Watched(head["source"], tuple(_stage_of(read_arrays(file)) for file in files), parts)
    except ArgumentError:
        raise
    except (OSError, ValueError, KeyError, TypeError, IndexError, AttributeError) as error:
        raise ArgumentError(f"{folder}: not a complete recording ({reason_of(error)}); record it again") from error


def _write(file: Path, arrays: Arrays) -> None:
    content = io.BytesIO()
    np.savez_compressed(content, **arrays)
    file.write_bytes(content.getvalue())


def _arrays_of_parts(parts: Sequence[Part]) -> Arrays:
    colours = np.array([part.colour for part in parts], dtype=np.int64).reshape(-1, 3)
    is_robot = np.array([part.is_robot for part in parts], dtype=bool)
    return {"colours": colours, "is_robot": is_robot, **_arrays_of_meshes("part", [part.solid for part in parts])}


def _parts_of(arrays: Arrays) -> tuple[Part, ...]:
    about = enumerate(zip(arrays["colours"].tolist(), arrays["is_robot"].tolist(), strict=True))
    parts = [(_mesh_of("part", number, arrays), colour, is_robot) for number, (colour, is_robot) in about]
    return tuple(Part(solid, tuple(colour), is_robot) for solid, colour, is_robot in parts if solid is not None)


def _arrays_of_meshes(name: str, meshes: Sequence[Mesh | None]) -> Arrays:
    arrays = {}
    for number, mesh in enumerate(meshes):
        if mesh is not None:
            arrays[f"{name}_{number}_vertices_m"] = mesh.vertices_m.astype(np.float32)
            arrays[f"{name}_{number}_faces"] = mesh.faces.astype(np.int32)
    return arrays


def _mesh_of(name: str, number: int, arrays: Arrays) -> Mesh | None:
    key = f"{name}_{number}_vertices_m"
    if key not in arrays:
        return None
    return Mesh(arrays[key].astype(np.float64), arrays[f"{name}_{number}_faces"].astype(np.int64))


def _arrays_of_stage(stage: StageView) -> Arrays:
    words = {
        **{name: getattr(stage, name) for name in ("title", "action", "reason", "notes", "events")},
        "options": [[each.name, each.value, each.low, each.high, each.chance_best] for each in stage.options],
        "objects": [[each.number, each.is_dirty, each.occlusion, *each.middle_m.tolist()] for each in stage.objects],
        "opening_m": None if stage.hand is None else stage.hand.opening_m,
    }
    arrays: Arrays = {
        "words": np.frombuffer(json.dumps(words, allow_nan=False).encode(), dtype=np.uint8),
        "points_m": stage.points_m.astype(np.float32, copy=False),
        "colours": stage.colours,
        "eye_m": stage.eye_m,
        "hides": stage.hides,
        "poses": stage.poses.astype(np.float32),
        **_arrays_of_meshes("solid", [each.solid for each in stage.objects]),
        **_arrays_of_meshes("shadow", [each.shadow for each in stage.objects]),
        **{f"revealed_{number}_m": each.revealed_m.astype(np.float32) for number, each in enumerate(stage.objects)},
    }
    if stage.hand is not None:
        arrays |= {name: getattr(stage.hand, name) for name in ("way_m", "at_m", "axes")}
    return arrays


def _stage_of(arrays: Arrays) -> StageView:
    words = json_of(arrays["words"].tobytes())
    objects = tuple(
        Shown(
            int(number),
            is_dirty,
            occlusion,
            np.array(middle_m, dtype=np.float64),
            _mesh_of("solid", row, arrays),
            _mesh_of("shadow", row, arrays),
            arrays[f"revealed_{row}_m"].astype(np.float64),
        )
        for row, (number, is_dirty, occlusion, *middle_m) in enumerate(words["objects"])
    )
    seen, opening_m = (arrays["points_m"], arrays["colours"], arrays["eye_m"]), words["opening_m"]
    options = tuple(Option(*each) for each in words["options"])
    decided = words["action"], words["reason"], tuple(words["notes"]), tuple(words["events"])
    hand = None if opening_m is None else Hand(arrays["way_m"], arrays["at_m"], arrays["axes"], opening_m)
    poses = arrays["poses"].astype(np.float64)
    return StageView(words["title"], *seen, objects, arrays["hides"], options, *decided, poses, hand)


_WIDTH_PX, _HEIGHT_PX, _CAPTION_PX, _MARGIN_PX = 640, 420, 52, 10
_FOCAL_PX = 0.75 * _WIDTH_PX
_NEAREST_M = 0.05
_MOMENT_MS, _STAGE_MS = 300, 1800
_NUM_COLOURS = 96
_EVERY = 5  # every fifth moment is drawn
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
    # One palette for all frames, so that what does not move is stored once.
    palette = pictures[len(pictures) // 2].quantize(_NUM_COLOURS, Image.Quantize.MAXCOVERAGE)
    reduced = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    reduced[0].save(content, "GIF", save_all=True, append_images=reduced[1:], duration=held_ms, loop=0, optimize=True)
    write_file(Path(file), content.getvalue())


class _Lens:
    """A pinhole camera at a position, pointed at another."""

    def __init__(self, from_m: Vector, at_m: Vector) -> None:
        ahead = (at_m - from_m) / np.linalg.norm(at_m - from_m)
        right = np.cross(ahead, [0.0, 0.0, 1.0])
        right /= np.linalg.norm(right)
        self._from_m, self._axes = from_m, np.stack([right, np.cross(ahead, right), ahead])

    def seen(self, points_m: Points) -> tuple[Pixels, Float[np.ndarray, " n"]]:
        """Coordinates of points in the picture [px], and their depth [m]."""
        camera_m = (points_m - self._from_m) @ self._axes.T
        ahead_m = np.maximum(camera_m[:, 2], 1e-3)
        middle_px = np.array([0.5 * _WIDTH_PX, 0.7 * _HEIGHT_PX])
        return middle_px + _FOCAL_PX * camera_m[:, :2] / ahead_m[:, None], camera_m[:, 2]

    def pixels(self, points_m: Points) -> list[tuple[float, float]]:
        """Coordinates of points in the picture [px], for a pen."""
        return [(x, y) for x, y in self.seen(points_m)[0].tolist()]


def _with_points(lens: _Lens, stage: StageView) -> UInt8[np.ndarray, "H W 3"]:
    """Draw the cloud: the nearest point of each pixel, and of the adjacent pixels."""
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
    """Draw a moment, from back to front."""
    whole = Image.new("RGB", (_WIDTH_PX, _HEIGHT_PX + _CAPTION_PX), (255, 255, 255))
    whole.paste(Image.fromarray(behind))
    pen, font = ImageDraw.Draw(whole, "RGBA"), ImageFont.load_default(13)
    for shown in stage.objects:
        _fill(pen, lens, shown.shadow, (*stage_view.SHADOW, 70))
    for shown in sorted(stage.objects, key=lambda each: -float(lens.seen(each.middle_m[None])[1][0])):
        _fill(pen, lens, shown.solid, (*dirty_colour(shown.is_dirty), 150))
    for x, y in lens.pixels(stage.revealed_m):
        pen.ellipse((x - 1.5, y - 1.5, x + 1.5, y + 1.5), fill=(*stage_view.GHOST, 255))
    for arrow in stage.arrows:
        _arrow(pen, *lens.seen(arrow.ends_m)[0])
    for part, pose in zip(parts, stage.poses[moment], strict=True) if len(stage.poses) else ():
        if part.is_robot:
            _fill(pen, lens, _placed(part, pose), (*part.colour, 170))
    for line_m in [] if stage.hand is None else stage.hand.lines_m:
        pen.line(lens.pixels(line_m), fill=(*stage_view.HAND, 255), width=3)
    for shown in stage.objects:
        (at,) = lens.pixels(shown.middle_m[None])
        pen.text(at, f"{shown.number}: {shown.is_dirty:.2f}", (0, 0, 0, 255), font, anchor="mm")
    pen.rectangle((0, _HEIGHT_PX, _WIDTH_PX, _HEIGHT_PX + _CAPTION_PX), fill=(255, 255, 255, 255))
    pen.text((_MARGIN_PX, _HEIGHT_PX + 6), stage.title, _WORDS, ImageFont.load_default(15))
    pen.text((_MARGIN_PX, _HEIGHT_PX + 28), _fitting(stage.reason, font), _WORDS, font)
    return whole


def _fitting(words: str, font: "ImageFont.FreeTypeFont | ImageFont.ImageFont") -> str:
    """The beginning of a sentence, as wide as the picture."""
    kept, end = words, ""
    while font.getlength(kept + end) > _WIDTH_PX - 2 * _MARGIN_PX:
        kept, end = kept.rsplit(" ", 1)[0] if end else kept, " …"
    return kept + end


def _placed(part: Part, pose: Float[np.ndarray, " 7"]) -> Mesh:
    x_m, y_m, z_m, *turn = (float(value) for value in pose / np.array([1, 1, 1, *[np.linalg.norm(pose[3:])] * 4]))
    w, x, y, z = turn
    return part.solid.moved(Pose((x_m, y_m, z_m), (w, x, y, z)).matrix)


def _fill(pen: ImageDraw.ImageDraw, lens: _Lens, mesh: Mesh | None, colour: Colour) -> None:
    """Fill the silhouette of a convex solid, if there is one: the hull of its corners in the picture."""
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
    pen.line([tuple(begin.tolist()), tuple(end.tolist())], fill=(*stage_view.ARROW, 255), width=2)
    along = (end - begin) / max(float(np.linalg.norm(end - begin)), 1e-6)
    across = np.array([-along[1], along[0]])
    tip = [end, end - 9 * along + 4 * across, end - 9 * along - 4 * across]
    pen.polygon([tuple(corner.tolist()) for corner in tip], fill=(*stage_view.ARROW, 255))
