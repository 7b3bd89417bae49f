"""Logs to and from Minari: each step is a completed stage; data that steps cannot hold are stored as JSON.

==================  ==================================================================================================
Minari              Logs
==================  ==================================================================================================
observations[t-1]   numeric covariates of stage t, as float64. The last is S of the stage in which the trajectory
                    was cut; for a finished trajectory, which has none, it repeats the last stage
actions[t-1]        index of the action of stage t among the dataset's actions
rewards[t-1]        reward of stage t
terminations[-1]    the trajectory finished
truncations[-1]     the trajectory was cut, in the stage of the last observation
infos elapsed_s     clock at each observation [s]: 0, then the end of each completed stage
infos stage         JSON: the row of the stage, and those of its objects
episode metadata    JSON: the row of the trajectory
dataset metadata    names of the actions and of the observation's columns, types of all columns, the unit of rewards,
                    and the trajectories that were cut in their first stage: they have no step, so Minari has no
                    episode for them
==================  ==================================================================================================

Minari itself writes and reads the dataset. `read_minari` builds the log from the rows; their cells are text, as in CSV.
"""

import json
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
import pandas as pd

from halfseen.errors import ArgumentError, HalfseenError, LogError
from halfseen.installation import command_for, extra
from halfseen.logs.columns import CUT, FINISHED
from halfseen.logs.formats.as_text import MINARI, ColumnType, column_types, from_texts, refuse_lost, texts
from halfseen.logs.formats.step_arrays import read_episodes
from halfseen.logs.formats.steps import StepRules
from halfseen.logs.logs import Logs
from halfseen.logs.missing import Missing
from halfseen.reading import TABLE, check_file, reason_of
from halfseen.writing import placed

Cells: TypeAlias = dict[str, str | None]
"""Cells of one row, as text."""
Note: TypeAlias = dict[str, Any]
"""The row of a ``trajectory``, and the rows (``cells``) of its ``stages``, each with the rows of its ``objects``."""

KEY = "halfseen"
VERSION = 2
_ROOT = "MINARI_DATASETS_PATH"
_IN_STEPS = ("trajectory", "stage", "elapsed_s", "action", "reward")
_LARGEST_EXACT = 2**53


def seen_by_halfseen_alone(logs: Logs) -> list[str]:
    """Columns that Minari stores only as notes, which no other program reads."""
    carried = {"stages": {*_IN_STEPS, *_observed(logs)}, "trajectories": {"trajectory", "ending", "end_s"}}
    notes = [
        f"{table}.{column}"
        for table, names in carried.items()
        for column in logs.tables[table]
        if column not in names and len(logs.tables[table][column].dropna())
    ]
    return notes + (["objects"] if logs.objects is not None else [])


def _observed(logs: Logs) -> list[str]:
    """The covariates of the observation: those that float64 represents exactly."""
    return [name for name in logs.stage_covariates if _is_exact(logs.stages[name])]


def _is_exact(values: Any) -> bool:
    if not pd.api.types.is_numeric_dtype(values.dtype):
        return False
    is_whole = pd.api.types.is_integer_dtype(values.dtype)
    return not is_whole or bool(values.between(-_LARGEST_EXACT, _LARGEST_EXACT).all())


def write_minari(logs: Logs, dataset_id: str) -> None:
    """Write logs as a Minari dataset into Minari's own folder, all or nothing; `read_minari` restores them exactly.

    Observations are the numeric covariates of the stages, or the stage number if there are none; actions are
    indices into the dataset's actions; terminated means finished, truncated means cut.

    Parameters
    ----------
    logs
        Logs to write. Objects of stages are stored as JSON in the infos, since their number varies and the length
        of an observation does not.
    dataset_id
        Name of the dataset, ``(namespace/)name-v0``; Minari stores it under ``MINARI_DATASETS_PATH``, by default
        ``~/.minari/datasets``.

    Raises
    ------
    ArgumentError
        Minari is not installed, or the name is invalid or taken.
    LogError
        No stage was completed, or a column has no text form.
    """
    minari, spaces = extra("minari", "minari"), extra("gymnasium.spaces", "minari")
    h5py = extra("h5py", "minari")
    refuse_lost(logs, MINARI)
    target, types, observed = _target(dataset_id), column_types(logs.tables), _observed(logs)
    notes = _notes(logs, types)
    taken = texts(logs.stages["action"], types["stages"]["action"])
    stages: Any = logs.stages
    completed = stages["action"][stages["elapsed_s"].notna()].unique()
    actions = texts(pd.Series(sorted(completed), dtype=completed.dtype), types["stages"]["action"])
    index_of = {name: index for index, name in enumerate(actions)}
    arrays = list(_steps(logs, observed, [index_of.get(name, -1) for name in taken]))
    without = [note for note, steps in zip(notes, arrays, strict=True) if not len(steps["actions"])]
    episodes = [(note, steps) for note, steps in zip(notes, arrays, strict=True) if len(steps["actions"])]
    metadata = {"version": VERSION, "actions": actions, "observations": observed, "types": types}
    metadata |= {"reward_unit": logs.reward_unit, "without_steps": without}
    with placed(target) as fresh, _datasets_in(fresh), _written_at_once(h5py), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # about a missing author, licence and environment
        dataset = minari.create_dataset_from_buffers(
            dataset_id,
            [_buffer(minari, note, steps) for note, steps in episodes],
            observation_space=spaces.Box(-np.inf, np.inf, (max(1, len(observed)),), np.float64),
            action_space=spaces.Discrete(len(actions)),
            description="Trajectories of a robot, written by halfseen: terminated means finished, truncated means cut.",
        )
        dataset.storage.update_metadata({KEY: json.dumps(metadata)})
        dataset.storage.update_episode_metadata([{KEY: json.dumps(note["trajectory"])} for note, _ in episodes])
        _lift(fresh, dataset_id)


def _notes(logs: Logs, types: dict[str, dict[str, ColumnType]]) -> list[Note]:
    """The rows of each trajectory, as text."""
    stages: list[Note] = [{"cells": cells} for cells in _rows(logs.stages, types["stages"])]
    if logs.objects is not None:
        # Both tables have the same order, and every stage has objects.
        stage_row = logs.objects.groupby(["trajectory", "stage"], sort=False).ngroup()
        for row, cells in zip(stage_row, _rows(logs.objects, types["objects"]), strict=True):
            stages[row].setdefault("objects", []).append(cells)
    trajectories = _rows(logs.trajectories, types["trajectories"])
    return [
        {"trajectory": cells, "stages": stages[begin:end]}
        for cells, (begin, end) in zip(trajectories, pairwise(_begins(logs)), strict=True)
    ]


def _rows(table: pd.DataFrame, types: dict[str, ColumnType]) -> list[Cells]:
    columns = [texts(table[name], kind) for name, kind in types.items()]
    return [dict(zip(types, cells, strict=True)) for cells in zip(*columns, strict=True)]


def _begins(logs: Logs) -> list[int]:
    """First row of each trajectory in the stages, and the number of rows."""
    return [*np.flatnonzero(logs.stages["stage"] == 1).tolist(), logs.num_stages]


def _steps(logs: Logs, observed: list[str], actions: list[int]) -> Iterator[dict[str, np.ndarray]]:
    """Observations, actions, rewards and clock of each trajectory: T completed stages give T steps."""
    seen = logs.stages[observed].to_numpy(dtype=np.float64)
    elapsed_s, rewards = logs.stages["elapsed_s"].to_numpy(), logs.stages["reward"].to_numpy()
    for begin, end in pairwise(_begins(logs)):
        num_steps = int(np.count_nonzero(~np.isnan(elapsed_s[begin:end])))
        # A finished trajectory has no observation after its last stage.
        rows = np.minimum(np.arange(begin, begin + num_steps + 1), end - 1)
        yield {
            "observations": seen[rows] if observed else np.arange(1.0, num_steps + 2)[:, None],
            "actions": np.array(actions[begin : begin + num_steps], dtype=np.int64),
            "rewards": rewards[begin : begin + num_steps],
            "elapsed_s": np.append(0.0, elapsed_s[begin : begin + num_steps]),
        }


def _buffer(minari: Any, note: Note, steps: dict[str, np.ndarray]) -> Any:
    num_steps, is_finished = len(steps["actions"]), note["trajectory"]["ending"] == FINISHED
    is_last = np.arange(num_steps) == num_steps - 1
    stages = [*note["stages"], {}][: num_steps + 1]
    return minari.data_collector.EpisodeBuffer(
        observations=steps["observations"],
        actions=steps["actions"],
        rewards=list(steps["rewards"]),
        terminations=list(is_last & is_finished),
        truncations=list(is_last & (not is_finished)),
        infos={"elapsed_s": steps["elapsed_s"], "stage": [json.dumps(stage) for stage in stages]},
    )


def read_minari(
    dataset: Any,
    *,
    clock: str | None = None,
    step_s: float | None = None,
    truncated: str = CUT,
    missing: Missing = None,
) -> Logs:
    """Read a Minari dataset from `write_minari` or another program.

    Parameters
    ----------
    dataset
        A ``minari.MinariDataset``, or the name or folder of one.
    clock, step_s, truncated
        Only for datasets of other programs, as in `StepRules`; the clock is the info with the time of each observation
        [s], one more than there are steps, or of the end of each step.
    missing
        What replaces null in covariates, as in `Logs`.

    Returns
    -------
    Logs
        For a dataset of another program, ``obs_0``, ``obs_1``, … hold the observation before each action. An episode
        that terminated finished, even if it was truncated in the same step. An episode that was only truncated was cut
        (cause ``truncated``) in the stage of its last observation, unless `truncated` is "finished". An episode that
        just stops was cut there, too (cause ``unknown``).

    Raises
    ------
    ArgumentError
        Minari is not installed, there is no such dataset, or stages cannot hold its kind of actions or observations.
    LogError
        The dataset is broken.
    """
    rules = StepRules(clock=clock, step_s=step_s, truncated=truncated)
    name, dataset = dataset, _loaded(dataset)
    try:
        metadata = dataset.storage.metadata
        name = metadata.get("dataset_id", dataset.storage.data_path)
        if KEY in metadata and rules != StepRules():
            raise ArgumentError(
                f"dataset {name}: halfseen wrote it with its own clock and endings; leave clock, step_s and truncated "
                "out"
            )
        if KEY in metadata:
            return _read_own(dataset, json.loads(metadata[KEY]), missing)
        return read_episodes(dataset, f"dataset {name}", rules, missing)
    except (HalfseenError, MemoryError):
        raise
    except Exception as error:  # h5py raises nearly anything
        raise LogError(
            f"dataset {name}: it is broken ({type(error).__name__}: {reason_of(error)}); write or download it again"
        ) from error


def _read_own(dataset: Any, metadata: dict[str, Any], missing: Missing) -> Logs:
    types = metadata["types"]
    if metadata["version"] != VERSION:
        raise ValueError(f"version {metadata['version']} is not the {VERSION} that this halfseen reads")
    if not set(metadata["observations"]) <= set(types["stages"]):
        raise ValueError("observations do not fit in columns of stages")
    indices = [int(index) for index in dataset.episode_indices]
    noted = dataset.storage.get_episode_metadata(indices)
    notes = [_note(episode, json.loads(each[KEY]), metadata) for episode, each in zip(dataset, noted, strict=True)]
    notes += metadata["without_steps"] if len(indices) == dataset.storage.total_episodes else []
    stages = [stage for note in notes for stage in note["stages"]]
    rows = {"trajectories": [note["trajectory"] for note in notes], "stages": [stage["cells"] for stage in stages]}
    rows["objects"] = [cells for stage in stages for cells in stage.get("objects", ())]
    tables: dict[str, Any] = {name: _frame(rows[name], kinds) for name, kinds in types.items()}
    return Logs(**tables, reward_unit=metadata.get("reward_unit"), missing=missing)


def _note(episode: Any, trajectory: Cells, metadata: dict[str, Any]) -> Note:
    """The rows of an episode, which must agree with its steps."""
    stages = [json.loads(stage) for stage in episode.infos["stage"]]
    done = [stage["cells"] for stage in stages[: len(episode.actions)]]
    steps = [metadata["actions"][index] for index in episode.actions], np.asarray(episode.rewards).tolist()
    is_same = steps == ([cells["action"] for cells in done], [float(cells["reward"]) for cells in done])
    if not is_same or bool(episode.terminations[-1]) != (trajectory["ending"] == FINISHED):
        raise ValueError(f"episode {episode.id} and the note of its trajectory {trajectory['trajectory']} disagree")
    return {"trajectory": trajectory, "stages": list(filter(None, stages))}


def _frame(rows: list[Cells], types: dict[str, ColumnType]) -> pd.DataFrame:
    return pd.DataFrame({name: from_texts([row[name] for row in rows], kind) for name, kind in types.items()})


def _loaded(dataset: Any) -> Any:
    minari = extra("minari", "minari")
    if isinstance(dataset, minari.MinariDataset):
        return dataset
    is_folder = Path(dataset).is_dir()
    try:
        for file in (Path(dataset) / "data").iterdir() if is_folder else ():
            check_file(file, TABLE)
        return minari.MinariDataset(Path(dataset) / "data") if is_folder else minari.load_dataset(str(dataset))
    except ImportError as error:
        raise ArgumentError(f"dataset {dataset}: {error}; run: {command_for('minari')}") from error
    except Exception as error:  # a broken dataset raises nearly anything
        raise ArgumentError(
            f"dataset {dataset}: it cannot be loaded ({reason_of(error)}); `minari list local` lists those on this "
            "machine"
        ) from error


def _target(dataset_id: str) -> Path:
    from minari.dataset.minari_dataset import parse_dataset_id
    from minari.namespace import create_namespace, list_local_namespaces
    from minari.storage import get_dataset_path

    try:
        namespace, _, _ = parse_dataset_id(dataset_id)
        if namespace and namespace not in list_local_namespaces():
            create_namespace(namespace)
    except (ValueError, TypeError) as error:  # TypeError where the version is missing
        raise ArgumentError(f"dataset {dataset_id!r}: it is not a dataset name; use (namespace/)name-v0") from error
    return get_dataset_path(dataset_id)


@contextmanager
def _datasets_in(folder: Path) -> Iterator[None]:
    """Make Minari store its datasets in `folder`, by its environment variable."""
    before = os.environ.get(_ROOT)
    os.environ[_ROOT] = str(folder)
    try:
        yield
    finally:
        os.environ.pop(_ROOT) if before is None else os.environ.update({_ROOT: before})


@contextmanager
def _written_at_once(h5py: Any) -> Iterator[None]:
    """Make HDF5 write to memory, and write the file on closing: on a full disk, HDF5 would crash the process."""

    class InMemory(h5py.File):
        def __init__(self, name: Any, mode: str = "r", **given: Any) -> None:
            super().__init__(name, mode, driver="core", backing_store=False, **given)

        def close(self) -> None:
            path, is_changed = Path(self.filename), self.mode != "r"
            self.flush()
            content = self.id.get_file_image()
            super().close()
            if is_changed:
                path.write_bytes(content)

    on_disk, h5py.File = h5py.File, InMemory
    try:
        yield
    finally:
        h5py.File = on_disk


def _lift(folder: Path, dataset_id: str) -> None:
    """Move the dataset from its place below `folder` into `folder`, which becomes the dataset."""
    (folder / dataset_id / "data").rename(folder / "data")
    top = folder / Path(dataset_id).parts[0]
    for leftover in sorted(top.rglob("*"), reverse=True):
        leftover.rmdir() if leftover.is_dir() else leftover.unlink()
    top.rmdir()
