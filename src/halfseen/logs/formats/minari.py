"""Logs as Minari's episodes and back: every step is a completed stage, and what steps cannot carry goes along as JSON.

==================  ==================================================================================================
Minari              Logs
==================  ==================================================================================================
observations[t-1]   numeric covariates of stage t, as float64. The last is S of the stage in which the trajectory
                    was cut; after a finished trajectory, where nothing was recorded, it repeats the last stage
actions[t-1]        index of the action of stage t among the dataset's actions
rewards[t-1]        reward of stage t
terminations[-1]    the trajectory finished
truncations[-1]     the trajectory was cut, in the stage of the last observation
infos elapsed_s     clock at each observation [s]: 0, then the end of each completed stage
infos stage         JSON: the rest of the stage (object, probability, covariates that are no numbers; the action where
                    the stage was not completed), and the objects that stood there, row by row
episode metadata    JSON: the row of the trajectory
dataset metadata    names of the actions and of the observation's columns, types of all columns, the unit of rewards,
                    and the trajectories that were cut in their first stage: they have no step, so that Minari has no
                    episode for them
==================  ==================================================================================================

Minari itself writes and reads. In datasets of others observations become columns, and steps become seconds. An ending
is never a bare boolean here: an episode that terminated is a trajectory that finished, one that was truncated is a
trajectory that was cut.
"""

import json
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from halfseen.errors import ArgumentError, HalfseenError, LogError
from halfseen.installation import command_for, extra
from halfseen.logs.columns import CUT, FINISHED, UNKNOWN_CAUSE
from halfseen.logs.formats.clocks import ends_by_observations, ends_by_steps, even_ends
from halfseen.logs.formats.csv_folder import MINARI, ColumnType, column_types, from_texts, refuse_lost, texts
from halfseen.logs.formats.steps import (
    Ending,
    Episode,
    StepRules,
    columns_of,
    logs_of_episodes,
    refuse_early,
)
from halfseen.logs.logs import Logs
from halfseen.reading import TABLE, check_file, reason_of
from halfseen.shapes import Float, Int, Shaped
from halfseen.writing import placed

Cells = dict[str, str | None]
"""Cells of one row, as text."""

# Columns of stages that steps carry in numbers; the action only where the stage was completed.
_IN_STEPS = ("trajectory", "stage", "elapsed_s", "action", "reward")
_LARGEST_EXACT = 2**53
_PANDAS_NAMES = {"float": "float32", "double": "float64"}


@dataclass(frozen=True)
class StoredEpisode:
    """A trajectory as an episode of T steps.

    Parameters
    ----------
    trajectory
        Row of the trajectory.
    observations
        Numeric covariates, shape (T + 1, F).
    actions
        Index of each completed stage's action, shape (T,).
    rewards
        Reward of each completed stage, shape (T,).
    clock_s
        Clock at each observation [s], shape (T + 1,).
    stages
        The rest of each stage and its objects, T + 1 of them; empty after a finished trajectory.
    """

    trajectory: Cells
    observations: Float[np.ndarray, "T1 F"]
    actions: Int[np.ndarray, " T"]
    rewards: Float[np.ndarray, " T"]
    clock_s: Float[np.ndarray, " T1"]
    stages: list[dict[str, Any]]

    @property
    def is_finished(self) -> bool:
        """Whether the trajectory reached its own end."""
        return self.trajectory["ending"] == "finished"


@dataclass(frozen=True)
class Schema:
    """What holds for all episodes of a dataset.

    Parameters
    ----------
    actions
        Names of the actions, as text.
    observations
        Covariates in the order of the observation.
    types
        Type of each column of each table.
    """

    actions: list[str]
    observations: list[str]
    types: dict[str, dict[str, ColumnType]]


def schema_of(logs: Logs) -> Schema:
    """Find out what the observations and actions of logs are."""
    types = column_types(logs.tables)
    taken: Any = logs.stages["action"][logs.stages["elapsed_s"].notna()]
    names = pd.Series(sorted(taken.unique()), dtype=taken.dtype)
    actions = [str(name) for name in texts(names, types["stages"]["action"])]
    numeric = [column for column in logs.stage_covariates if _is_exact(logs.stages[column])]
    return Schema(actions, numeric, types)


def _is_exact(values: Any) -> bool:
    """Whether float64 carries the numbers of a column to the last bit."""
    if not pd.api.types.is_numeric_dtype(values.dtype):
        return False
    is_whole = pd.api.types.is_integer_dtype(values.dtype)
    return not is_whole or bool(values.between(-_LARGEST_EXACT, _LARGEST_EXACT).all())


def episodes_of(logs: Logs, schema: Schema) -> Iterator[StoredEpisode]:
    """Turn each trajectory into an episode, in the order of the trajectories."""
    stages, kinds = logs.stages, schema.types["stages"]
    covariates = stages[schema.observations].to_numpy(dtype=np.float64)
    elapsed_s, rewards = stages["elapsed_s"].to_numpy(), stages["reward"].to_numpy()
    in_steps = {*_IN_STEPS, *schema.observations}
    actions = texts(stages["action"], kinds["action"])
    index_of = {name: index for index, name in enumerate(schema.actions)}
    rest = _rows(stages, {name: kind for name, kind in kinds.items() if name not in in_steps})
    objects = None if logs.objects is None else _objects_by_stage(logs, schema)
    trajectories = _rows(logs.trajectories, schema.types["trajectories"])
    first = np.flatnonzero(stages["stage"].to_numpy() == 1)
    for trajectory, begin, end in zip(trajectories, first, np.append(first[1:], len(stages)), strict=True):
        rows = np.arange(begin, end)
        done = rows[~np.isnan(elapsed_s[rows])]
        is_over = len(done) == len(rows)
        carried: list[dict[str, Any]] = [{"cells": rest[row]} for row in rows]
        if not is_over:
            carried[-1]["action"] = actions[end - 1]
        if objects is not None:
            carried = [{**stage, "objects": objects[row]} for row, stage in zip(rows, carried, strict=True)]
        yield StoredEpisode(
            trajectory=trajectory,
            observations=covariates[np.append(rows, rows[-1:])] if is_over else covariates[rows],
            actions=np.array([index_of[str(actions[row])] for row in done], dtype=np.int64),
            rewards=rewards[done],
            clock_s=np.append(0.0, elapsed_s[done]),
            stages=[*carried, {}] if is_over else carried,
        )


def logs_of(episodes: list[StoredEpisode], schema: Schema) -> Logs:
    """Put trajectories together again; the inverse of `episodes_of`."""
    columns: dict[str, list[Any]] = {name: [] for name in schema.types["stages"]}
    numbers: dict[str, list[float]] = {name: [] for name in ("elapsed_s", "reward", *schema.observations)}
    objects: list[Cells] = []
    for episode in episodes:
        _check_lengths(episode)
        for t, stage in enumerate(episode.stages):
            if not stage:
                continue
            done = t < len(episode.actions)
            key = {"trajectory": episode.trajectory["trajectory"], "stage": str(t + 1)}
            action = schema.actions[episode.actions[t]] if done else stage.get("action")
            for name, cell in {**stage["cells"], **key, "action": action}.items():
                columns[name].append(cell)
            outcome = (episode.clock_s[t + 1], episode.rewards[t]) if done else (np.nan, np.nan)
            for name, value in zip(numbers, (*outcome, *episode.observations[t]), strict=True):
                numbers[name].append(value)
            objects += [{**cells, **key} for cells in stage.get("objects", [])]
    stages = {
        name: _typed_numbers(numbers[name], kind) if name in numbers else from_texts(columns[name], kind)
        for name, kind in schema.types["stages"].items()
    }
    return Logs(
        stages=pd.DataFrame(stages),
        trajectories=_frame([episode.trajectory for episode in episodes], schema.types["trajectories"]),
        objects=_frame(objects, schema.types["objects"]) if "objects" in schema.types else None,
    )


def seen_by_halfseen_alone(logs: Logs) -> list[str]:
    """Name what Minari keeps only as notes that no other program reads."""
    steps = {*_IN_STEPS, *schema_of(logs).observations}
    carried = {"stages": steps, "trajectories": {"trajectory", "ending", "end_s"}}
    notes = [
        f"{table}.{column}"
        for table, names in carried.items()
        for column in logs.tables[table]
        if column not in names and len(logs.tables[table][column].dropna())
    ]
    return notes + (["objects"] if logs.objects is not None else [])


def _rows(table: pd.DataFrame, types: dict[str, ColumnType]) -> list[Cells]:
    columns = [texts(table[name], kind) for name, kind in types.items()]
    return [dict(zip(types, cells, strict=True)) for cells in zip(*columns, strict=True)] or [{} for _ in table.index]


def _objects_by_stage(logs: Logs, schema: Schema) -> list[list[Cells]]:
    by_stage: dict[tuple[str | None, str | None], list[Cells]] = {}
    assert logs.objects is not None
    for row in _rows(logs.objects, schema.types["objects"]):
        by_stage.setdefault((row.pop("trajectory"), row.pop("stage")), []).append(row)
    keys = [texts(logs.stages[name], schema.types["stages"][name]) for name in ("trajectory", "stage")]
    return [by_stage[key] for key in zip(*keys, strict=True)]


def _check_lengths(episode: StoredEpisode) -> None:
    counts = len(episode.observations), len(episode.clock_s), len(episode.stages)
    if set(counts) != {len(episode.actions) + 1}:
        raise LogError(
            f"trajectory {episode.trajectory['trajectory']!r}: {counts} observations, clocks and stages do not fit "
            f"{len(episode.actions)} steps; each needs one more than there are steps"
        )


def _typed_numbers(values: list[float], kind: ColumnType) -> pd.Series:
    """Numbers of a column in its own type; null where NaN."""
    if not isinstance(kind, str):
        raise LogError(f"the type {kind!r} is none of numbers; write the dataset again")
    dtype: Any = _PANDAS_NAMES.get(kind, kind)
    return pd.Series(values, dtype="float64").astype(dtype)


def _frame(rows: list[Cells], types: dict[str, ColumnType]) -> pd.DataFrame:
    return pd.DataFrame({name: from_texts([row[name] for row in rows], kind) for name, kind in types.items()})


KEY = "halfseen"
VERSION = 1
_ROOT = "MINARI_DATASETS_PATH"


def write_minari(logs: Logs, dataset_id: str) -> None:
    """Write logs as a Minari dataset into Minari's own folder, all or nothing; `read_minari` gives them back exactly.

    Observations are the numeric covariates of the stages, or the stage's number where there are none; actions are
    indices into the dataset's actions; terminated means finished, truncated means cut.

    Parameters
    ----------
    logs
        What to write. Where their stages have objects, these go along as JSON in the infos, since their number
        varies and an observation's length does not.
    dataset_id
        Name of the dataset, ``(namespace/)name-v0``; Minari keeps it under ``MINARI_DATASETS_PATH``, by default
        ``~/.minari/datasets``.

    Raises
    ------
    ArgumentError
        Minari is not installed, the name is no name, or it is taken.
    LogError
        No stage was completed, or a column has no form as text.
    """
    minari = extra("minari", "minari")
    extra("h5py", "minari")
    refuse_lost(logs, MINARI)
    schema = schema_of(logs)
    target = _target(dataset_id)
    episodes = list(episodes_of(logs, schema))
    stepless = [asdict(each) for each in episodes if not len(each.actions)]
    metadata = {"version": VERSION, **asdict(schema), "reward_unit": logs.reward_unit, "without_steps": stepless}
    with placed(target) as fresh, _datasets_in(fresh), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Minari misses an author, a licence and an environment
        _create(minari, dataset_id, schema, [each for each in episodes if len(each.actions)], metadata)
        _lift(fresh, dataset_id)


def read_minari(dataset: Any, *, clock: str | None = None, step_s: float | None = None, truncated: str = CUT) -> Logs:
    """Read a Minari dataset that `write_minari` or anybody else wrote.

    Parameters
    ----------
    dataset
        A ``minari.MinariDataset``, the name of one, or the folder of one.
    clock
        Only for datasets of others: the info that holds the time of each observation [s], one more than there are
        steps, or of each step's end.
    step_s
        Only for datasets of others, without `clock`: how long a step lasts [s]; 1 s, with a warning, if neither is
        given.
    truncated
        Only for datasets of others: "cut" or "finished" (at its horizon), what an episode is that was only truncated.

    Returns
    -------
    Logs
        Of another's dataset: ``obs_0``, ``obs_1``, … hold the observation that each action was taken on. An episode
        that terminated finished, also where it was truncated in the same step; one that was only truncated was cut
        (cause ``truncated``) in the stage of its last observation, unless `truncated` says otherwise, and so was one
        that just stops (cause ``unknown``).

    Raises
    ------
    ArgumentError
        Minari is not installed, there is no such dataset, or its actions or observations are of a kind that stages
        cannot hold.
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
            return _read_own(dataset, json.loads(metadata[KEY]))
        return _read_foreign(dataset, f"dataset {name}", rules)
    except (HalfseenError, MemoryError):
        raise
    except Exception as error:  # h5py raises nearly anything
        raise LogError(
            f"dataset {name}: it is broken ({type(error).__name__}: {reason_of(error)}); write or download it again"
        ) from error


def _create(
    minari: Any, dataset_id: str, schema: Schema, episodes: list[StoredEpisode], metadata: dict[str, Any]
) -> None:
    spaces = extra("gymnasium.spaces", "minari")
    dataset = minari.create_dataset_from_buffers(
        dataset_id,
        [_buffer(minari, episode) for episode in episodes],
        observation_space=spaces.Box(-np.inf, np.inf, (max(1, len(schema.observations)),), np.float64),
        action_space=spaces.Discrete(len(schema.actions)),
        description="Trajectories of a robot, written by halfseen: terminated means finished, truncated means cut.",
    )
    dataset.storage.update_metadata({KEY: json.dumps(metadata, default=np.ndarray.tolist)})
    dataset.storage.update_episode_metadata([{KEY: json.dumps(episode.trajectory)} for episode in episodes])


def _buffer(minari: Any, episode: StoredEpisode) -> Any:
    num_steps = len(episode.actions)
    is_last = np.arange(num_steps) == num_steps - 1
    numbers = np.arange(1.0, num_steps + 2)[:, None]
    return minari.data_collector.EpisodeBuffer(
        observations=episode.observations if episode.observations.shape[1] else numbers,
        actions=episode.actions,
        rewards=list(episode.rewards),
        terminations=list(is_last & episode.is_finished),
        truncations=list(is_last & (not episode.is_finished)),
        infos={"elapsed_s": episode.clock_s, "stage": [json.dumps(stage) for stage in episode.stages]},
    )


def _read_own(dataset: Any, metadata: dict[str, Any]) -> Logs:
    if metadata["version"] != VERSION:
        raise ValueError(f"version {metadata['version']} is not the {VERSION} that this halfseen reads")
    schema = Schema(metadata["actions"], metadata["observations"], metadata["types"])
    indices = [int(index) for index in dataset.episode_indices]
    notes = dataset.storage.get_episode_metadata(indices)
    is_whole = len(indices) == dataset.storage.total_episodes
    trajectories = [_steps(episode, note, schema) for episode, note in zip(dataset, notes, strict=True)]
    stepless = [_stepless(trajectory) for trajectory in metadata["without_steps"]] if is_whole else []
    return logs_of([*trajectories, *stepless], schema).in_unit(metadata.get("reward_unit"))


def _steps(episode: Any, note: dict[str, Any], schema: Schema) -> StoredEpisode:
    trajectory = json.loads(note[KEY])
    is_finished = bool(episode.terminations[-1])
    if is_finished != (trajectory["ending"] == "finished"):
        raise ValueError(
            f"episode {episode.id} and the note of its trajectory {trajectory['trajectory']} disagree about the ending"
        )
    return StoredEpisode(
        trajectory=trajectory,
        observations=np.asarray(episode.observations, dtype=np.float64)[:, : len(schema.observations)],
        actions=np.asarray(episode.actions, dtype=np.int64),
        rewards=np.asarray(episode.rewards, dtype=np.float64),
        clock_s=np.asarray(episode.infos["elapsed_s"], dtype=np.float64),
        stages=[json.loads(stage) for stage in episode.infos["stage"]],
    )


def _stepless(noted: dict[str, Any]) -> StoredEpisode:
    arrays = {name: np.array(noted[name], dtype=np.float64) for name in ("observations", "rewards", "clock_s")}
    return StoredEpisode(noted["trajectory"], actions=np.zeros(0, dtype=np.int64), stages=noted["stages"], **arrays)


def _read_foreign(dataset: Any, name: str, rules: StepRules) -> Logs:
    """Read a dataset of which halfseen knows no more than Minari does."""
    _check_spaces(dataset, name)
    episodes = list(dataset)
    each = zip(episodes, _ends(episodes, name, rules), strict=True)
    return logs_of_episodes(name, [_episode(episode, name, rules, ends_s) for episode, ends_s in each])


def _episode(episode: Any, name: str, rules: StepRules, ends_s: Float[np.ndarray, " T"]) -> Episode:
    place = f"{name}, episode {episode.id}"
    num_steps = len(episode)
    return Episode(
        name=int(episode.id),
        observed=_observations(episode.observations, num_steps, place),
        actions=np.asarray(episode.actions).astype(np.int64),
        rewards=np.asarray(episode.rewards, dtype=np.float64),
        ends_s=ends_s,
        ending=_ending(episode, name, rules),
        has_last=True,
    )


def _check_spaces(dataset: Any, name: str) -> None:
    from gymnasium import spaces

    if not isinstance(dataset.action_space, spaces.Discrete):
        raise ArgumentError(
            f"{name}: actions are {dataset.action_space}, and a stage has one of finitely many; discretise them (say, "
            "with numpy.digitize) and write the dataset again with a Discrete action space"
        )
    kinds = (spaces.Box, spaces.Discrete, spaces.MultiDiscrete, spaces.MultiBinary)
    entries = dataset.observation_space
    for space in entries.values() if isinstance(entries, spaces.Dict) else [entries]:
        if not isinstance(space, kinds):
            raise ArgumentError(
                f"{name}: observations are {space}, which no columns of numbers hold; flatten them with "
                "gymnasium.wrappers.FlattenObservation and write the dataset again"
            )


def _observations(observed: Any, num_steps: int, place: str) -> dict[str, Shaped[np.ndarray, " T1"]]:
    """Columns of the observation: obs_0, obs_1, …, or key_0, key_1, … where it has parts."""
    parts = observed if isinstance(observed, dict) else {"obs": observed}
    columns = {}
    for key, part in parts.items():
        values = np.asarray(part)
        if len(values) != num_steps + 1:
            raise LogError(
                f"{place}: {len(values)} observations for {num_steps} steps; Minari keeps one more than there are steps"
            )
        columns |= columns_of(key, values.reshape(len(values), -1))
    return columns


def _ends(episodes: list[Any], name: str, rules: StepRules) -> list[Float[np.ndarray, " _"]]:
    """Time from the beginning of its episode to the end of each step [s], by episode."""
    step_s, clock = rules.step_in(name), rules.clock
    if clock is None:
        return [even_ends(len(episode), step_s) for episode in episodes]
    times_s = {k: _clock(each, clock, f"{name}, episode {each.id}") for k, each in enumerate(episodes) if len(each)}
    of_steps = [k for k in times_s if len(times_s[k]) == len(episodes[k])]
    ids = [int(episodes[k].id) for k in of_steps]
    by_steps = dict(zip(of_steps, ends_by_steps(name, clock, ids, [times_s[k] for k in of_steps]), strict=True))
    return [
        by_steps[k] if k in by_steps else ends_by_observations(times_s.get(k, np.zeros(1)))
        for k in range(len(episodes))
    ]


def _clock(episode: Any, clock: str, place: str) -> Float[np.ndarray, " T"]:
    """Time of each observation, or of the end of each step [s]."""
    num_steps = len(episode)
    infos = episode.infos or {}
    if clock not in infos:
        raise LogError(f"{place}: there is no info {clock!r} among {', '.join(infos) or 'none'}; name another clock")
    values = np.asarray(infos[clock])
    if values.shape not in {(num_steps,), (num_steps + 1,)} or values.dtype.kind not in "fiu":
        raise LogError(
            f"{place}: info {clock!r} is {values.dtype} of shape {values.shape}, no time for each of {num_steps} steps "
            "[s]; name another clock"
        )
    return values.astype(np.float64)


def _ending(episode: Any, name: str, rules: StepRules) -> Ending:
    terminated, truncated = (np.asarray(flags, dtype=bool) for flags in (episode.terminations, episode.truncations))
    if not len(terminated):
        raise LogError(f"{name}, episode {episode.id}: it has no step; leave the episode out")
    refuse_early(name, int(episode.id), terminated | truncated)
    if terminated[-1]:
        return FINISHED, None
    return rules.of_truncated if truncated[-1] else (CUT, UNKNOWN_CAUSE)


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
            f"dataset {dataset}: it cannot be loaded ({reason_of(error)}); `minari list local` names those that there "
            "are"
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
        raise ArgumentError(
            f"dataset {dataset_id!r}: it is no name of a dataset; call it (namespace/)name-v0"
        ) from error
    return get_dataset_path(dataset_id)


@contextmanager
def _datasets_in(folder: Path) -> Iterator[None]:
    """Let Minari keep its datasets elsewhere; it asks the environment."""
    before = os.environ.get(_ROOT)
    os.environ[_ROOT] = str(folder)
    try:
        yield
    finally:
        os.environ.pop(_ROOT) if before is None else os.environ.update({_ROOT: before})


def _lift(folder: Path, dataset_id: str) -> None:
    """Move the dataset from its place below `folder` into `folder`, which becomes the dataset."""
    (folder / dataset_id / "data").rename(folder / "data")
    top = folder / Path(dataset_id).parts[0]
    for leftover in sorted(top.rglob("*"), reverse=True):
        leftover.rmdir() if leftover.is_dir() else leftover.unlink()
    top.rmdir()
