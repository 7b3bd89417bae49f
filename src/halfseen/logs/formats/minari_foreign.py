"""Minari datasets that others wrote: observations become columns, and steps become seconds."""

from typing import Any

import numpy as np

from halfseen.errors import ArgumentError, LogError
from halfseen.logs.columns import CUT, FINISHED, UNKNOWN_CAUSE
from halfseen.logs.formats.episodes import (
    Episode,
    StepRules,
    ends_of,
    even_ends,
    logs_of_episodes,
    refuse_early,
    step_of,
)
from halfseen.logs.formats.step_values import columns_of
from halfseen.logs.logs import Logs
from halfseen.shapes import Float, Shaped


def read_foreign(dataset: Any, name: str, rules: StepRules) -> Logs:
    """Read a dataset of which halfseen knows no more than Minari does.

    Parameters
    ----------
    dataset
        A ``minari.MinariDataset``.
    name
        What to call it in messages.
    rules
        As in `read_minari`.

    Raises
    ------
    ArgumentError
        The actions are not finitely many, or the observations are of a kind that stages cannot hold.
    LogError
        An episode is broken, or has no such clock.
    """
    _check_spaces(dataset, name)
    step_s = step_of(name, rules)
    return logs_of_episodes(name, [_episode(episode, name, rules, step_s) for episode in dataset])


def _episode(episode: Any, name: str, rules: StepRules, step_s: float) -> Episode:
    place = f"{name}, episode {episode.id}"
    num_steps = len(episode)
    ending, cause = _ending(episode, name, rules)
    return Episode(
        name=int(episode.id),
        observed=_observations(episode.observations, num_steps, place),
        actions=np.asarray(episode.actions).astype(np.int64),
        rewards=np.asarray(episode.rewards, dtype=np.float64),
        ends_s=even_ends(num_steps, step_s) if rules.clock is None else _clock(episode, rules.clock, place),
        ending=ending,
        cause=cause,
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


def _ending(episode: Any, name: str, rules: StepRules) -> tuple[str, str | None]:
    terminated, truncated = (np.asarray(flags, dtype=bool) for flags in (episode.terminations, episode.truncations))
    if not len(terminated):
        raise LogError(f"{name}, episode {episode.id}: it has no step; leave the episode out")
    refuse_early(name, int(episode.id), terminated | truncated)
    if terminated[-1]:
        return FINISHED, None
    return rules.of_truncated if truncated[-1] else (CUT, UNKNOWN_CAUSE)
