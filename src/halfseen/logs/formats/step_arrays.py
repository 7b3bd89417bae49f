"""Arrays of steps: in an HDF5 file like those of D4RL, and in Minari datasets written by other programs.

In HDF5 all episodes are concatenated, one row per step. ``observations``, ``actions``, ``rewards`` and ``terminals``
are required; ``timeouts`` marks truncated episodes (also ``truncations``, or ``episode_terminals`` of d3rlpy), and
``next_observations`` holds the observation after each step. ``observations`` may be a group of arrays. Arrays in
``infos`` and elsewhere are read only if named as the action, the reward, the end or the clock.

Minari has one more observation than steps. A terminated episode is a finished trajectory, a truncated one is a cut
trajectory.
"""

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from math import prod
from pathlib import Path
from typing import Any

import numpy as np

from halfseen.errors import ArgumentError, LogError, warn
from halfseen.installation import extra
from halfseen.logs.columns import CUT
from halfseen.logs.formats import array_doubts
from halfseen.logs.formats.array_doubts import NEXT_SEEN, SEEN, TIMEOUTS
from halfseen.logs.formats.step_clocks import ends_by_steps, even_ends, refuse_other_unit, refuse_rounded
from halfseen.logs.formats.steps import Ending, StepColumns, StepRules, StepTable, columns_of, refuse_early, require
from halfseen.logs.logs import Logs
from halfseen.logs.missing import Missing
from halfseen.reading import MOST_LEVELS, TABLE, check_file, check_unpacked, refused
from halfseen.shapes import Float, Shaped

END_OF_DATA = "end-of-data"
MOST_GROUPS = 1000
"""Largest number of groups at one level, since groups may contain one another."""


def read_step_arrays(file: str | Path, rules: StepRules | None = None, *, missing: Missing = None) -> Logs:
    """Read an HDF5 file of steps, such as those of D4RL.

    Parameters
    ----------
    file
        The file.
    rules
        Arrays of the action (default: ``actions``), the reward (``rewards``), the episode's own end (``terminals``)
        and the clock at the end of each step (by default every step counts as 1 s, with a warning); and whether a
        timeout is a cut or the horizon.
    missing
        What replaces null in covariates, as in `Logs`.

    Returns
    -------
    Logs
        One trajectory per episode, one stage per row. A cut falls into the stage of the last ``next_observations`` or,
        without these, into the last row. An episode broken off by the end of the file is cut by ``end-of-data``.

    Raises
    ------
    ArgumentError
        h5py is not installed, an array is missing, or the actions are not a finite set.
    LogError
        The file is missing or broken, its arrays differ in length, or the log violates an invariant.
    """
    file, rules = Path(file), StepRules() if rules is None else rules
    place = str(file)
    named = {"action": "actions", "reward": "rewards", "done": "terminals"} | rules.named
    steps = StepColumns(place, _arrays(file, named))
    is_terminal = steps.flags(named["done"])
    is_timeout = np.zeros(len(is_terminal), dtype=bool)
    if (timeouts := next((name for name in TIMEOUTS if name in steps.columns), None)) is not None:
        is_timeout = steps.flags(timeouts)
    else:
        warn(place, f"there are no {TIMEOUTS[0]}, so an episode ends only where it terminated")
    observed = steps.observed([name for name in steps.columns if _is_below(name, SEEN)])
    following = _following(steps, observed)
    array_doubts.warn_of_runs(place, named["done"], is_terminal)
    ends = np.array(sorted({*(np.flatnonzero(is_terminal | is_timeout) + 1), len(is_terminal)} - {0}), dtype=np.int64)
    of_steps = begins = np.append(0, ends).astype(np.int64)
    rows = np.arange(len(is_terminal))
    if following is None:
        array_doubts.warn_of_shifted_ends(place, observed, ends)
    else:
        array_doubts.warn_of_others_below(place, observed, following, ends)
        # Append to each episode the observation after its last step.
        rows, begins = np.insert(rows, ends, len(rows) + ends - 1), begins + np.arange(len(begins))
        observed = {name: np.append(values, following[name])[rows] for name, values in observed.items()}
    step_s = rules.step_in(place)
    if rules.clock is None or not len(ends):
        ends_s = even_ends(of_steps, step_s)
    else:
        times_s = np.split(steps.numbers(rules.clock), ends[:-1])
        ends_s = np.concatenate(ends_by_steps(place, rules.clock, range(len(ends)), times_s))
    table = StepTable(
        names=range(len(ends)),
        begins=begins,
        is_step=rows < len(is_terminal),
        observed=observed,
        actions=steps.actions(named["action"]),
        rewards=steps.numbers(named["reward"], "reward"),
        ends_s=ends_s,
        endings=rules.endings(is_terminal[ends - 1], is_timeout[ends - 1], (CUT, END_OF_DATA)),
    )
    return table.logs(place, missing)


def _arrays(file: Path, names: dict[str, str]) -> dict[str, np.ndarray]:
    """Read the arrays used, and report those left out."""
    with _opened(file) as (root, num_bytes):
        there = _named(file, root)
        are_apart = any(name.endswith(f"/{names['action']}") for name in there)
        apart = "its episodes are groups: give the folder of a Minari dataset, or write one array of all steps"
        require(str(file), there, names, apart if are_apart else None)
        asked = {*names.values(), *TIMEOUTS}
        wanted = [name for name in there if name in asked or _is_below(name, SEEN) or _is_below(name, NEXT_SEEN)]
        if not any(_is_below(name, SEEN) for name in wanted):
            require(str(file), there, {"observations": SEEN}, "rename it")
        check_unpacked(num_bytes, sum(prod(there[name].shape) * there[name].dtype.itemsize for name in wanted))
        num_steps = there[names["done"]].shape[:1]
        for name in wanted:
            if there[name].shape[:1] != num_steps or not num_steps:
                raise LogError(
                    f"{file}: {name} has the shape {there[name].shape}, and {names['done']} "
                    f"{there[names['done']].shape}; every array has one row a step: write the file again"
                )
        left_out = [name for name in there if name not in wanted]
        if left_out:
            more = f" and {len(left_out) - 20} more" if len(left_out) > 20 else ""
            warn(str(file), f"left out are {', '.join(left_out[:20])}{more}: they were not known before the action")
        return {name: _read(file, name, there[name]) for name in wanted}


@contextmanager
def _opened(file: Path) -> Iterator[tuple[Any, int]]:
    h5py = extra("h5py", "hdf5")
    missing = "no such file; give the one that holds the steps"
    with refused(file, "it is not a complete HDF5 file of steps", "copy or write it again", missing):
        num_bytes = check_file(file, TABLE)
        with h5py.File(file, "r") as root:
            yield root, num_bytes


def _named(file: Path, root: Any) -> dict[str, Any]:
    """The arrays of a file by their paths; links out of the file are refused."""
    h5py = extra("h5py", "hdf5")
    found: dict[str, Any] = {}
    level = [("", root)]
    for _ in range(MOST_LEVELS):
        below = []
        for prefix, group in level:
            for key in group:
                name = f"{prefix}{key}"
                if not isinstance(group.get(key, getlink=True), h5py.HardLink):
                    raise LogError(f"{file}: {name} is a link; write its target in its place")
                entry = group[key]
                if isinstance(entry, h5py.Group):
                    below.append((f"{name}/", entry))
                elif isinstance(entry, h5py.Dataset):
                    if entry.external or entry.is_virtual:
                        raise LogError(f"{file}: {name} is stored in another file; write it into this one")
                    found[name] = entry
        level = below
        if not level:
            return found
        if len(level) > MOST_GROUPS:
            break
    raise LogError(f"{file}: it has too many groups, or nests them more than {MOST_LEVELS} levels deep; write fewer")


def _read(file: Path, name: str, array: Any) -> np.ndarray:
    if array.dtype.hasobject:
        strings = extra("h5py", "hdf5").check_string_dtype(array.dtype)
        if strings is None:
            raise LogError(f"{file}: {name} holds {array.dtype}, which is neither numbers nor text; leave it out")
        return np.asarray(array.asstr()[...], dtype=object)
    values = array[...]
    return values.astype(str).astype(object) if values.dtype.kind == "S" else values


def _is_below(name: str, group: str) -> bool:
    return name == group or name.startswith(f"{group}/")


def _following(steps: StepColumns, observed: Mapping[str, Any]) -> dict[str, np.ndarray] | None:
    """Observations after each step, by the names of those before it; None if missing."""
    found = {
        f"{SEEN}{name.removeprefix(NEXT_SEEN)}": values
        for name, values in steps.columns.items()
        if _is_below(name, NEXT_SEEN)
    }
    if not found:
        return None
    following = StepColumns(steps.place, found).observed(found)
    if set(following) != set(observed):
        differing = ", ".join(sorted(set(following) ^ set(observed))[:10])
        raise LogError(f"{steps.place}: {NEXT_SEEN} and {SEEN} differ in {differing}; write both of the same shape")
    return following


# Minari.


def read_episodes(dataset: Any, name: str, rules: StepRules, missing: Missing = None) -> Logs:
    """Read a Minari dataset without halfseen's own metadata; see `halfseen.logs.formats.read_minari`."""
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
        ends_s=_ends_of_episodes(episodes, name, rules),
        endings=_endings_of_episodes(episodes, names, name, rules),
    )
    return table.logs(name, missing)


def _check_spaces(dataset: Any, name: str) -> None:
    from gymnasium import spaces

    if not isinstance(dataset.action_space, spaces.Discrete):
        raise ArgumentError(
            f"{name}: actions are {dataset.action_space}, but a stage takes one of finitely many; discretise them "
            "(say, with numpy.digitize) and write the dataset again with a Discrete action space"
        )
    kinds = (spaces.Box, spaces.Discrete, spaces.MultiDiscrete, spaces.MultiBinary)
    entries = dataset.observation_space
    for space in entries.values() if isinstance(entries, spaces.Dict) else [entries]:
        if not isinstance(space, kinds):
            raise ArgumentError(
                f"{name}: observations are {space}, which columns of numbers cannot hold; flatten them with "
                "gymnasium.wrappers.FlattenObservation and write the dataset again"
            )


def _observations(observed: Any, num_steps: int, place: str) -> dict[str, Shaped[np.ndarray, " T1"]]:
    """Columns of the observation: obs_0, obs_1, …, or key_0, key_1, … if it has parts."""
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


def _ends_of_episodes(episodes: list[Any], name: str, rules: StepRules) -> Float[np.ndarray, " M"]:
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
            f"{place}: info {clock!r} is {values.dtype} of shape {values.shape}, not a time [s] for each of "
            f"{num_steps} steps; name another clock"
        )
    refuse_rounded(place, clock, values)
    refuse_other_unit(place, clock, values)
    return values.astype(np.float64)


def _endings_of_episodes(episodes: list[Any], names: list[int], name: str, rules: StepRules) -> list[Ending]:
    for each in episodes:
        if not len(each):
            raise LogError(f"{name}, episode {each.id}: it has no step; leave the episode out")
    ends_it = [np.logical_or(each.terminations, each.truncations) for each in episodes]
    refuse_early(name, names, np.cumsum([0, *map(len, episodes)]), np.concatenate([[], *ends_it]).astype(bool))
    return rules.endings([each.terminations[-1] for each in episodes], [each.truncations[-1] for each in episodes])
