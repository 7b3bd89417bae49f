"""Minari datasets that others wrote: observations become columns, and steps become seconds."""

import warnings
from typing import Any

import numpy as np
import pandas as pd
from jaxtyping import Float, Shaped

from halfseen.errors import ArgumentError, HalfseenWarning, LogError
from halfseen.logs.columns import CUT, FINISHED, UNKNOWN_CAUSE
from halfseen.logs.logs import Logs
from halfseen.logs.refusal import within

TRUNCATED = "truncated"


def read_foreign(dataset: Any, name: str, clock: str | None, step_s: float | None) -> Logs:
    """Read a dataset of which halfseen knows no more than Minari does.

    Parameters
    ----------
    dataset
        A ``minari.MinariDataset``.
    name
        What to call it in messages.
    clock, step_s
        As in `read_minari`.

    Raises
    ------
    ArgumentError
        The actions are not finitely many, or the observations are of a kind that stages cannot hold.
    LogError
        An episode is broken, or has no such clock.
    """
    _check_spaces(dataset, name)
    if clock is None and step_s is None:
        warnings.warn(
            f"{name}: no clock is named, so that every step counts as 1 s; name the info that holds it as clock, or "
            "give step_s",
            HalfseenWarning,
            stacklevel=3,
        )
    paths, stages = [], []
    for episode in dataset:
        place = f"{name}, episode {episode.id}"
        observed = _observations(episode.observations, len(episode), place)
        seconds = _clock(episode, clock, 1.0 if step_s is None else step_s, place)
        ending, cause = _ending(episode, place)
        paths.append({"path": int(episode.id), "end_s": seconds[-1], "ending": ending, "cause": cause})
        stages.append(_stages(episode, observed, seconds, ending))
    if not paths:
        raise LogError(f"{name}: it has no episodes; a log has at least one path")
    with within(name):
        return Logs(stages=pd.concat(stages, ignore_index=True), paths=pd.DataFrame(paths))


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
        flat = values.reshape(len(values), -1)
        columns |= {f"{key}_{i}": flat[:, i] for i in range(flat.shape[1])}
    return columns


def _clock(episode: Any, clock: str | None, step_s: float, place: str) -> Float[np.ndarray, " T"]:
    """Time from the beginning to the end of each step [s]."""
    num_steps = len(episode)
    if clock is None:
        if not (np.isfinite(step_s) and step_s > 0):
            raise ArgumentError(f"step_s {step_s}: a step lasts a finite time above 0 s")
        return step_s * np.arange(1.0, num_steps + 1)
    infos = episode.infos or {}
    if clock not in infos:
        raise LogError(f"{place}: there is no info {clock!r} among {', '.join(infos) or 'none'}; name another clock")
    values = np.asarray(infos[clock])
    if values.shape not in {(num_steps,), (num_steps + 1,)} or values.dtype.kind not in "fiu":
        raise LogError(
            f"{place}: info {clock!r} is {values.dtype} of shape {values.shape}, no time for each of {num_steps} steps "
            "[s]; name another clock"
        )
    seconds = values.astype(np.float64)
    return seconds if len(seconds) == num_steps else seconds[1:] - seconds[0]


def _ending(episode: Any, place: str) -> tuple[str, str | None]:
    terminated, truncated = (np.asarray(flags, dtype=bool) for flags in (episode.terminations, episode.truncations))
    if not len(terminated):
        raise LogError(f"{place}: it has no step; leave the episode out")
    early = (terminated | truncated)[:-1]
    if early.any():
        raise LogError(
            f"{place}: step {int(np.argmax(early)) + 1} of {len(terminated)} ends it; make two episodes of it"
        )
    if terminated[-1]:
        return FINISHED, None
    return CUT, TRUNCATED if truncated[-1] else UNKNOWN_CAUSE


def _stages(episode: Any, observed: dict[str, np.ndarray], seconds: np.ndarray, ending: str) -> pd.DataFrame:
    """Steps as stages; a cut path has one more, that of the last observation."""
    extra = 0 if ending == FINISHED else 1
    num_stages = len(episode) + extra
    missing = np.full(extra, np.nan)
    actions = np.asarray(episode.actions).tolist() + [None] * extra
    return pd.DataFrame(
        {
            "path": int(episode.id),
            "stage": np.arange(1, num_stages + 1),
            "elapsed_s": np.append(seconds, missing),
            "action": pd.array(actions, dtype="Int64"),
            "reward": np.append(np.asarray(episode.rewards, dtype=np.float64), missing),
            **{name: values[:num_stages] for name, values in observed.items()},
        }
    )
