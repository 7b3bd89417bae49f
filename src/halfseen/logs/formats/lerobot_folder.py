"""LeRobot datasets (v2 and v3): a folder of Parquet files with metadata.

::

    FOLDER/
      meta/info.json                          features, frames per second (fps), numbers of episodes and frames
      meta/tasks.parquet                      task_index → instruction to the robot
      meta/episodes/chunk-*/file-*.parquet    number of frames of each episode
      data/chunk-*/file-*.parquet             one row per frame
      videos/…                                not read

In v2 each episode has a file, data/chunk-*/episode_*.parquet, and the metadata are meta/episodes.jsonl and
meta/tasks.jsonl.

A frame is a step. Covariates are the features ``observation…`` and the task; images and videos are skipped, and so are
outcomes of a step (``next…``) and commands in it.

LeRobot's ``next.done`` is true where an episode terminated or was truncated. An episode reached its own end if its
last frame has ``next.terminated`` or ``next.success``, or ``next.done`` without ``next.truncated``.
"""

from pathlib import Path
from typing import Annotated, Any, TypeVar

import msgspec
import numpy as np
import pyarrow as pa

from halfseen.errors import LogError, warn
from halfseen.logs.columns import FINISHED, first_true, shown
from halfseen.logs.formats.step_clocks import ends_by_observations, even_ends
from halfseen.logs.formats.step_tables import as_array, read_tables, whole_table
from halfseen.logs.formats.steps import Ending, StepColumns, StepRules, StepTable, begins_of, refuse_early, require
from halfseen.logs.logs import Logs
from halfseen.logs.missing import Missing
from halfseen.logs.parquet import parquet_file
from halfseen.reading import json_of, read_bytes, read_text, refused
from halfseen.shapes import Float, Int

Line = TypeVar("Line")
INFO = Path("meta") / "info.json"
DATA_OF = {"v2": "chunk-*/episode_*.parquet", "v3": "chunk-*/file-*.parquet"}
"""Versions that are read, and their files of data."""
SEEN = "observation"
DONE, TERMINATED, SUCCESS, TRUNCATED = "next.done", "next.terminated", "next.success", "next.truncated"
FLAGS = (DONE, TERMINATED, SUCCESS, TRUNCATED)
EPISODE, FRAME, TASK_INDEX, TIMESTAMP = "episode_index", "frame_index", "task_index", "timestamp"
_PICTURES = ("image", "video")
_BOOKKEEPING = (EPISODE, FRAME, TASK_INDEX, TIMESTAMP, "index")


def read_lerobot(folder: str | Path, rules: StepRules | None = None, *, missing: Missing = None) -> Logs:
    """Read a LeRobot dataset (v2 or v3) from its folder.

    Parameters
    ----------
    folder
        Folder with ``meta`` and ``data``.
    rules
        Features of the action (default: ``action``), the reward (``next.reward``), the episode's own end (the flags
        above), and the time of each frame (frame number by ``fps``); and the handling of an episode that was truncated
        or has no recorded ending. An episode that has ``next.truncated`` and ends without any flag broke off: it was
        cut (cause ``unknown``).
    missing
        What replaces null in covariates, as in `Logs`.

    Returns
    -------
    Logs
        One trajectory per episode, one stage per frame. A cut falls into the last frame, whose reward is ignored.

    Raises
    ------
    ArgumentError
        A feature is missing, or the actions are not a finite set.
    LogError
        A file is missing or broken, files of two datasets are mixed, or the log violates an invariant.
    """
    folder, rules = Path(folder), StepRules() if rules is None else rules
    place, data, info = str(folder), str(folder / "data"), _info(folder / INFO)
    action, reward = rules.action or "action", rules.reward or "next.reward"
    steps = StepColumns(place, _columns(folder, info, {"action": action, "reward": reward, **rules.named}))
    episode = steps.columns[EPISODE]
    begins = begins_of(data, "frames", episode, "copy the dataset again")
    _check_counts(folder, info, episode, begins)
    steps.refuse_disorder(begins)
    seen = {name: values for name, values in steps.columns.items() if name.startswith(SEEN)}
    tasks = folder / "meta" / ("tasks.jsonl" if info.version == "v2" else "tasks.parquet")
    if TASK_INDEX in steps.columns and tasks.exists():
        seen["task"] = _tasks(tasks, steps.columns[TASK_INDEX])
    table = StepTable(
        names=episode[begins[:-1]].tolist(),
        begins=begins,
        is_step=np.ones(len(episode), dtype=bool),
        observed=StepColumns(place, seen).observed(seen),
        actions=steps.actions(action),
        rewards=steps.numbers(reward, "reward"),
        ends_s=_ends(steps, info.fps, rules, begins),
        endings=_endings(steps, rules, begins),
    )
    return table.logs(place, missing)


class Info(msgspec.Struct):
    """Metadata of a dataset; further keys are ignored."""

    codebase_version: str
    fps: Annotated[float, msgspec.Meta(gt=0.0)]
    """Frames per second."""
    features: dict[str, dict[str, Any]]
    total_frames: int | None = None

    @property
    def version(self) -> str:
        """The version without its second number."""
        return self.codebase_version.partition(".")[0]


class EpisodeLine(msgspec.Struct):
    """A line of ``episodes.jsonl``; further keys are ignored."""

    episode_index: int
    length: int


class TaskLine(msgspec.Struct):
    """A line of ``tasks.jsonl``."""

    task_index: int
    task: str


def _info(file: Path) -> Info:
    remedy = "bring the dataset to v3 with LeRobot, or copy the whole dataset again"
    with refused(file, "it cannot be read", remedy):
        info = msgspec.convert(json_of(read_text(file)), Info)
    if info.version not in DATA_OF:
        versions = " and ".join(DATA_OF)
        raise LogError(
            f"{file}: codebase_version is {shown(info.codebase_version)}, but only {versions} are read; {remedy}"
        )
    return info


def _columns(folder: Path, info: Info, named: dict[str, str]) -> dict[str, np.ndarray]:
    """Read the features used, and report those skipped."""
    features = info.features
    files = _files(folder / "data", DATA_OF[info.version])
    pictures = [name for name, feature in features.items() if feature.get("dtype") in _PICTURES]
    with whole_table(files[0]):
        there = [str(name) for name in parquet_file(files[0]).schema_arrow.names if name not in pictures]
    require(str(folder), there, {**named, "number of each episode": EPISODE})
    seen = [name for name in there if name.startswith(SEEN)]
    known = dict.fromkeys([*seen, *named.values(), EPISODE, FRAME, TIMESTAMP, TASK_INDEX, *FLAGS])
    wanted = [name for name in known if name in there]
    left_out = [name for name in features if name not in (*wanted, *_BOOKKEEPING)]
    if left_out:
        names = ", ".join(f"{name} (pictures)" if name in pictures else name for name in left_out)
        warn(
            str(folder),
            f"left out are {names}: columns of a stage cannot hold them, or they were not known before the action",
        )
    table = read_tables(files, wanted)
    for name in (name for name in (EPISODE, FRAME, TASK_INDEX) if name in wanted):
        _whole(folder / "data", table, name)
    return {name: as_array(str(folder / "data"), table, name) for name in wanted}


def _whole(place: Path, table: pa.Table, name: str) -> list[int]:
    """Values of an integer column; other columns are refused."""
    kind = table.schema.field(name).type
    if not pa.types.is_integer(kind) or table[name].null_count:
        raise LogError(f"{place}: {name} holds {kind} or null, not whole numbers; copy the dataset again")
    return table[name].to_pylist()


def _files(folder: Path, names: str) -> list[Path]:
    files = sorted(folder.glob(names))
    if not files:
        raise LogError(f"{folder}: there is no {names}; copy the whole dataset again")
    return files


def _lines(file: Path, kind: type[Line]) -> list[Line]:
    """Read a file of JSON lines."""
    with whole_table(file):
        return msgspec.json.Decoder(kind).decode_lines(read_bytes(file))


def _lengths(folder: Path, info: Info) -> dict[int, int]:
    """The number of frames of each episode by the metadata."""
    if info.version == "v2":
        return {line.episode_index: line.length for line in _lines(folder / "meta" / "episodes.jsonl", EpisodeLine)}
    episodes = folder / "meta" / "episodes"
    noted = read_tables(_files(episodes, DATA_OF["v3"]), (EPISODE, "length"))
    return dict(zip(*(_whole(episodes, noted, name) for name in (EPISODE, "length")), strict=True))


def _check_counts(folder: Path, info: Info, episode: np.ndarray, begins: np.ndarray) -> None:
    """Refuse data with missing frames, according to the metadata of each episode."""
    lengths = _lengths(folder, info)
    found = dict(zip(episode[begins[:-1]].tolist(), np.diff(begins).tolist(), strict=True))
    for name in sorted({*lengths, *found}, key=str):
        if lengths.get(name, 0) != found.get(name, 0):
            raise LogError(
                f"{folder}, episode {shown(name)}: meta/episodes counts {lengths.get(name, 0)} frames, but data has "
                f"{found.get(name, 0)}; copy the whole dataset again"
            )
    if info.total_frames not in (None, len(episode)):
        raise LogError(
            f"{folder / INFO}: total_frames is {info.total_frames}, but data has {len(episode)}; copy the "
            "whole dataset again"
        )


def _endings(steps: StepColumns, rules: StepRules, begins: Int[np.ndarray, " E1"]) -> list[Ending]:
    """Ending and cause of each episode."""
    names = FLAGS if rules.done is None else (*FLAGS, rules.done)
    flags = {name: steps.flags(name) for name in names if name in steps.columns}
    last, never = begins[1:] - 1, np.zeros(int(begins[-1]), dtype=bool)
    is_truncated = flags.get(TRUNCATED, never)
    own = (TERMINATED, SUCCESS) if TERMINATED in flags else (SUCCESS, DONE)
    own = [name for name in (own if rules.done is None else (rules.done,)) if name in flags]
    if not own and TRUNCATED not in flags:
        became = "finished" if rules.truncated == FINISHED else "was cut (truncated)"
        warn(
            steps.place,
            f"none of {', '.join(FLAGS)} says how an episode ended, so that each {became}; name another feature as "
            "done, or set truncated",
        )
        return rules.endings(last < 0, last >= 0)
    is_done_alone = rules.done is None and DONE in own and TRUNCATED not in flags
    if is_done_alone and len(last) > 1 and flags[DONE][last].all():
        warn(
            steps.place,
            f"every episode ends with {DONE}, which LeRobot also sets for truncated ones, and there is no "
            f"{TRUNCATED}: each counts as finished; name a feature that marks termination as done",
        )
    ends_it = np.any([never, *(flags[name] for name in flags if name != SUCCESS or name == rules.done)], axis=0)
    refuse_early(steps.place, steps.columns[EPISODE][begins[:-1]].tolist(), begins, ends_it)
    is_own_end = np.any([never, *(flags[name] & ~(is_truncated & (name == DONE)) for name in own)], axis=0)
    return rules.endings(is_own_end[last], is_truncated[last] if TRUNCATED in flags else last >= 0)


def _ends(steps: StepColumns, fps: float, rules: StepRules, begins: Int[np.ndarray, " E1"]) -> Float[np.ndarray, " N"]:
    """Time from the beginning of its episode to the end of each frame [s]."""
    step_s = rules.step_s or 1.0 / fps
    if rules.clock is not None:
        return ends_by_observations(steps.numbers(rules.clock), begins, step_s)
    if rules.step_s is None and TIMESTAMP in steps.columns:
        _check_stamps(steps, fps, begins)
    return even_ends(begins, step_s)


def _check_stamps(steps: StepColumns, fps: float, begins: Int[np.ndarray, " E1"]) -> None:
    """Refuse frame counting if the time stamps contradict it."""
    stamps = steps.numbers(TIMESTAMP)
    first = np.repeat(begins[:-1], np.diff(begins))
    counted = (np.arange(len(stamps)) - first) / fps
    if (row := first_true(~(np.abs(stamps - stamps[first] - counted) < 0.5 / fps))) is not None:
        raise LogError(
            f"{steps.place}, episode {shown(steps.columns[EPISODE][row])}: frame {row - first[row]} has the "
            f"{TIMESTAMP} {stamps[row]:g} s, and by {fps:g} frames a second it is {counted[row]:g} s; name {TIMESTAMP} "
            "as clock, or give step_s"
        )


def _tasks(file: Path, numbers: np.ndarray) -> np.ndarray:
    if file.suffix == ".jsonl":
        words_of = {line.task_index: line.task for line in _lines(file, TaskLine)}
    else:
        words_of = _words_of_tasks(file)
    wrong = [number for number in np.unique(numbers).tolist() if number not in words_of]
    if wrong:
        raise LogError(f"{file}: a frame has task {shown(wrong[0])}, which is not listed; copy the dataset again")
    return np.array([words_of[number] for number in numbers.tolist()], dtype=object)


def _words_of_tasks(file: Path) -> dict[int, str]:
    table = read_tables([file])
    words = [
        field.name for field in table.schema if pa.types.is_string(field.type) or pa.types.is_large_string(field.type)
    ]
    if TASK_INDEX not in table.column_names or len(words) != 1:
        raise LogError(f"{file}: it has no {TASK_INDEX} and text for each task; copy the dataset again")
    return dict(zip(_whole(file, table, TASK_INDEX), table[words[0]].to_pylist(), strict=True))
