"""Minari's datasets that others wrote: observations become columns, and steps become seconds.

An ending is never a bare boolean here: an episode that terminated is a trajectory that finished, one that was truncated
is a trajectory that was cut.
"""

from typing import Any

import numpy as np

from halfseen.errors import ArgumentError, LogError
from halfseen.logs.formats.steps import (
    Ending,
    StepRules,
    StepTable,
    columns_of,
    ends_by_steps,
    even_ends,
    refuse_early,
)
from halfseen.logs.logs import Logs
from halfseen.shapes import Float, Shaped


def read_foreign(dataset: Any, name: str, rules: StepRules) -> Logs:
    """Read a dataset of which halfseen knows no more than Minari does; `halfseen.logs.formats.read_minari` says how."""
    _check_spaces(dataset, name)
    episodes = list(dataset)
    seen = [_observations(each.observations, len(each), f"{name}, episode {each.id}") for each in episodes]
    begins = np.cumsum([0, *(len(each) + 1 for each in episodes)])
    is_step = np.ones(begins[-1], dtype=bool)
    is_step[begins[1:] - 1] = False
    names = [int(each.id) for each in episodes]
    table = StepTable(
        names=names,
        begins=begins,
        is_step=is_step,
        observed={column: np.concatenate([each[column] for each in seen]) for column in (seen or [{}])[0]},
        actions=np.concatenate([[], *(each.actions for each in episodes)]).astype(np.int64),
        rewards=np.concatenate([[], *(each.rewards for each in episodes)]).astype(np.float64),
        ends_s=_ends(episodes, name, rules),
        endings=_endings(episodes, names, name, rules),
    )
    return table.logs(name)


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


def _ends(episodes: list[Any], name: str, rules: StepRules) -> Float[np.ndarray, " M"]:
    """Time from the beginning of its episode to the end of each step [s]."""
    step_s, clock, sizes = rules.step_in(name), rules.clock, [len(episode) for episode in episodes]
    if clock is None or not any(sizes):
        return even_ends(np.cumsum([0, *sizes]), step_s)
    times_s = {k: _clock(each, clock, f"{name}, episode {each.id}") for k, each in enumerate(episodes) if len(each)}
    of_steps = [k for k in times_s if len(times_s[k]) == sizes[k]]
    ids = [int(episodes[k].id) for k in of_steps]
    ends_s = {k: times[1:] - times[0] for k, times in times_s.items()}
    ends_s |= zip(of_steps, ends_by_steps(name, clock, ids, [times_s[k] for k in of_steps]), strict=True)
    return np.concatenate(list(ends_s.values()))


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


def _endings(episodes: list[Any], names: list[int], name: str, rules: StepRules) -> list[Ending]:
    for each in episodes:
        if not len(each):
            raise LogError(f"{name}, episode {each.id}: it has no step; leave the episode out")
    begins = np.cumsum([0, *map(len, episodes)])
    is_terminated, is_truncated = (
        np.concatenate([[], *(getattr(each, flags) for each in episodes)]).astype(bool)
        for flags in ("terminations", "truncations")
    )
    refuse_early(name, names, begins, is_terminated | is_truncated)
    last = begins[1:] - 1
    return rules.endings(is_terminated[last], is_truncated[last])
