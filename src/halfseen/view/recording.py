"""Stages in a folder: a file of words for all, and a file of arrays for each. Reading one runs no code.

::

    recording/
      recording.json      format, source, number of stages
      parts.npz           bodies of the cell
      stage-0001.npz …    arrays of a stage, and its words as JSON
"""

import json
import os
from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from halfseen.errors import ArgumentError
from halfseen.reading import json_of, read_arrays, read_text, reason_of
from halfseen.view.shapes import Mesh
from halfseen.view.stage_view import Hand, Option, Part, Shown, StageView, Watched
from halfseen.writing import placed

MARKER = "recording.json"  # every recording holds it
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
        Where to.
    overwrite
        Replace a recording that is there.

    Raises
    ------
    ArgumentError
        Something is there already and is not to be replaced, or the folder cannot be written.
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
        Where `write_recording` wrote it.

    Raises
    ------
    ArgumentError
        It is no recording, of a later format, or broken.
    """
    folder = Path(folder)
    try:
        head = json_of(read_text(folder / MARKER))
        if head["format"] != _FORMAT:
            raise ArgumentError(
                f"{folder}: its format is {head['format']}, and {_FORMAT} is read; use a later halfseen"
            )
        parts = _parts_of(read_arrays(folder / _PARTS))
        files = [folder / _STAGE.format(number) for number in range(1, head["num_stages"] + 1)]
        return Watched(head["source"], tuple(_stage_of(read_arrays(file)) for file in files), parts)
    except ArgumentError:
        raise
    except (OSError, ValueError, KeyError, TypeError, IndexError, AttributeError) as error:
        raise ArgumentError(f"{folder}: not a whole recording ({reason_of(error)}); record it again") from error


def _write(file: Path, arrays: Arrays) -> None:
    content = BytesIO()
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
