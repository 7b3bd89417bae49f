"""Logs as Minari datasets, written and read with Minari itself.

What stands where in those of halfseen is in `minari_steps`; in those of others, observations become columns, and steps
become seconds. An ending is never a bare boolean here: an episode that terminated is a trajectory that finished, one
that was truncated is a trajectory that was cut.
"""

import json
import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from halfseen.errors import ArgumentError, HalfseenError, LogError
from halfseen.installation import command_for
from halfseen.logs.columns import CUT, FINISHED, UNKNOWN_CAUSE
from halfseen.logs.formats.column_types import MINARI, refuse_lost
from halfseen.logs.formats.extras import extra
from halfseen.logs.formats.minari_steps import Schema, StoredEpisode, episodes_of, logs_of, schema_of
from halfseen.logs.formats.steps import (
    Ending,
    Episode,
    StepRules,
    columns_of,
    ends_of,
    even_ends,
    logs_of_episodes,
    refuse_early,
)
from halfseen.logs.logs import Logs
from halfseen.reading import TABLE, check_file, reason_of
from halfseen.shapes import Float, Shaped
from halfseen.writing import placed

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
    step_s = rules.step_in(name)
    return logs_of_episodes(name, [_episode(episode, name, rules, step_s) for episode in dataset])


def _episode(episode: Any, name: str, rules: StepRules, step_s: float) -> Episode:
    place = f"{name}, episode {episode.id}"
    num_steps = len(episode)
    return Episode(
        name=int(episode.id),
        observed=_observations(episode.observations, num_steps, place),
        actions=np.asarray(episode.actions).astype(np.int64),
        rewards=np.asarray(episode.rewards, dtype=np.float64),
        ends_s=even_ends(num_steps, step_s) if rules.clock is None else _clock(episode, rules.clock, place),
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


def _clock(episode: Any, clock: str, place: str) -> Float[np.ndarray, " T"]:
    """Time from the beginning to the end of each step [s]."""
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
    return ends_of(values.astype(np.float64), num_steps)


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
