"""Logs as Minari datasets, written and read with Minari itself.

What stands where is in `minari_steps`; datasets that others wrote are read in `minari_foreign`. An ending is never a
bare boolean here: an episode that terminated is a trajectory that finished, one that was truncated is a trajectory that
was cut.
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
from halfseen.logs.columns import CUT
from halfseen.logs.formats.episodes import StepRules
from halfseen.logs.formats.extras import extra
from halfseen.logs.formats.losses import MINARI, refuse_lost
from halfseen.logs.formats.minari_foreign import read_foreign
from halfseen.logs.formats.minari_steps import Schema, Steps, logs_of, schema_of, steps_of
from halfseen.logs.logs import Logs
from halfseen.reading import TABLE, check_file, reason_of
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
    episodes = list(steps_of(logs, schema))
    metadata = {
        "version": VERSION,
        **asdict(schema),
        "reward_unit": logs.reward_unit,
        "without_steps": [asdict(p) for p in episodes if not len(p.actions)],
    }
    with placed(target) as fresh, _datasets_in(fresh), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Minari misses an author, a licence and an environment
        _create(
            minari, dataset_id, schema, [trajectory for trajectory in episodes if len(trajectory.actions)], metadata
        )
        _lift(fresh, dataset_id)


def read_minari(
    dataset: Any,
    *,
    clock: str | None = None,
    step_s: float | None = None,
    truncated: str = CUT,
) -> Logs:
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
        return read_foreign(dataset, f"dataset {name}", rules)
    except (HalfseenError, MemoryError):
        raise
    except Exception as error:  # h5py raises nearly anything
        raise LogError(
            f"dataset {name}: it is broken ({type(error).__name__}: {reason_of(error)}); write or download it again"
        ) from error


def _create(minari: Any, dataset_id: str, schema: Schema, episodes: list[Steps], metadata: dict[str, Any]) -> None:
    spaces = extra("gymnasium.spaces", "minari")
    dataset = minari.create_dataset_from_buffers(
        dataset_id,
        [_buffer(minari, trajectory) for trajectory in episodes],
        observation_space=spaces.Box(-np.inf, np.inf, (max(1, len(schema.observations)),), np.float64),
        action_space=spaces.Discrete(len(schema.actions)),
        description="Trajectories of a robot, written by halfseen: terminated means finished, truncated means cut.",
    )
    dataset.storage.update_metadata({KEY: json.dumps(metadata, default=np.ndarray.tolist)})
    dataset.storage.update_episode_metadata([{KEY: json.dumps(trajectory.trajectory)} for trajectory in episodes])


def _buffer(minari: Any, trajectory: Steps) -> Any:
    num_steps = len(trajectory.actions)
    is_last = np.arange(num_steps) == num_steps - 1
    numbers = np.arange(1.0, num_steps + 2)[:, None]
    return minari.data_collector.EpisodeBuffer(
        observations=trajectory.observations if trajectory.observations.shape[1] else numbers,
        actions=trajectory.actions,
        rewards=list(trajectory.rewards),
        terminations=list(is_last & trajectory.is_finished),
        truncations=list(is_last & (not trajectory.is_finished)),
        infos={"elapsed_s": trajectory.clock_s, "stage": [json.dumps(stage) for stage in trajectory.stages]},
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


def _steps(episode: Any, note: dict[str, Any], schema: Schema) -> Steps:
    trajectory = json.loads(note[KEY])
    is_finished = bool(episode.terminations[-1])
    if is_finished != (trajectory["ending"] == "finished"):
        raise ValueError(
            f"episode {episode.id} and the note of its trajectory {trajectory['trajectory']} disagree about the ending"
        )
    return Steps(
        trajectory=trajectory,
        observations=np.asarray(episode.observations, dtype=np.float64)[:, : len(schema.observations)],
        actions=np.asarray(episode.actions, dtype=np.int64),
        rewards=np.asarray(episode.rewards, dtype=np.float64),
        clock_s=np.asarray(episode.infos["elapsed_s"], dtype=np.float64),
        stages=[json.loads(stage) for stage in episode.infos["stage"]],
    )


def _stepless(noted: dict[str, Any]) -> Steps:
    arrays = {name: np.array(noted[name], dtype=np.float64) for name in ("observations", "rewards", "clock_s")}
    return Steps(noted["trajectory"], actions=np.zeros(0, dtype=np.int64), stages=noted["stages"], **arrays)


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
