"""Step tables like those of RLDS, as Parquet, CSV or Arrow: one row a step, its fields as columns.

A row has ``observation`` (or what begins so: structs are taken apart), ``action``, ``reward``, ``is_first``,
``is_last`` and ``is_terminal``. Episodes are told apart by a column ``episode_id``, ``episode_index`` or ``episode``,
or begin where ``is_first`` is true. In the last row of an episode nothing was done any more: its action and reward say
nothing, and are not read. An episode whose last row is not ``is_last`` broke off.
"""

from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow as pa

from halfseen.errors import LogError
from halfseen.logs.columns import CUT, FINISHED, UNKNOWN_CAUSE, shown
from halfseen.logs.formats.arrow_tables import as_array, flattened, read_tables
from halfseen.logs.formats.episodes import (
    StepColumns,
    StepRules,
    ends_of,
    even_ends,
    logs_of_episodes,
    refuse_early,
    step_of,
)
from halfseen.logs.formats.step_values import (
    actions_of,
    flags_of,
    observed_columns,
    require,
    rewards_of,
    times_of,
    warn,
)
from halfseen.logs.logs import Logs
from halfseen.shapes import Bool, Float, Int, Shaped

SEEN = "observation"
EPISODES = ("episode_id", "episode_index", "episode")
FIRST, LAST, TERMINAL = "is_first", "is_last", "is_terminal"


def read_steps(files: str | Path | Sequence[str | Path], rules: StepRules | None = None) -> Logs:
    """Read a step table.

    Parameters
    ----------
    files
        A ``.parquet``, ``.csv``, ``.arrow`` or ``.feather`` file, or several that follow one another.
    rules
        Which columns hold the action (default: ``action``), the reward (``reward``), whether the episode reached its
        own end (``is_terminal``) and the time of each row (by default every step counts as 1 s, with a warning); and
        what becomes of an episode that did not.

    Returns
    -------
    Logs
        Each episode a trajectory, each step a stage. A cut falls into the stage of the last row.

    Raises
    ------
    ArgumentError
        A column is not there, or the actions are not finitely many.
    LogError
        A file is missing or broken, the flags contradict one another, or the log breaks an invariant.
    """
    paths = [Path(files)] if isinstance(files, str | Path) else [Path(file) for file in files]
    rules = StepRules() if rules is None else rules
    place = ", ".join(map(str, paths[:3])) + (f" and {len(paths) - 3} more" if len(paths) > 3 else "")
    table = flattened(place, read_tables(paths))
    named = {"action": "action", "reward": "reward", "done": TERMINAL} | rules.named
    require(place, table.column_names, LAST, "end of an episode", "add it")
    for role, name in named.items():
        require(place, table.column_names, name, role)
    columns = {name: as_array(place, table, name) for name in (*named.values(), LAST)}
    is_last, is_terminal = (flags_of(place, name, columns[name]) for name in (LAST, named["done"]))
    names, begins = _episodes(place, table)
    ends = begins[1:] - 1
    is_step = np.ones(len(is_last), dtype=bool)
    is_step[ends] = ~is_last[ends]
    seen = [name for name in table.column_names if name.startswith(SEEN)]
    steps = StepColumns(
        observed_columns(place, {name: as_array(place, table, name) for name in seen}),
        actions_of(place, named["action"], _of_steps(columns[named["action"]], is_step)),
        rewards_of(place, named["reward"], columns[named["reward"]]),
    )
    _tell_unread(place, table, {*named.values()}, steps.rewards[~is_step])
    step_s = step_of(place, rules)
    times_s = None if rules.clock is None else times_of(place, rules.clock, columns[rules.clock])
    episodes = []
    for name, (begin, end) in zip(names, pairwise(begins.tolist()), strict=True):
        has_last = not is_step[end - 1]
        stop = end - has_last
        ending = _ending(place, name, is_last[begin:end], is_terminal[begin:end], rules)
        ends_s = even_ends(stop - begin, step_s) if times_s is None else _ends(times_s[begin:end], stop - begin)
        after = {column: values[end - 1] for column, values in steps.observed.items()} if has_last else None
        episodes.append(steps.episode(name, slice(begin, stop), ends_s, ending, after=after))
    return logs_of_episodes(place, episodes)


def _episodes(place: str, table: pa.Table) -> tuple[list[int | str], Int[np.ndarray, " E1"]]:
    """Names of the episodes, the rows in which they begin, and the number of rows."""
    is_first = flags_of(place, FIRST, as_array(place, table, FIRST)) if FIRST in table.column_names else None
    column = next((name for name in EPISODES if name in table.column_names), None)
    if column is None and is_first is None:
        require(place, table.column_names, FIRST, "beginning of an episode", f"add it, or {EPISODES[0]}")
    if column is None and is_first is not None:
        if len(is_first) and not is_first[0]:
            raise LogError(f"{place}, row 0: {FIRST} is false, so that it belongs to no episode; mend it")
        at = np.flatnonzero(is_first)
        return list(range(len(at))), np.append(at, len(is_first))
    labels = as_array(place, table, str(column))
    if labels.ndim != 1 or labels.dtype.kind not in "iuO" or any(label is None for label in labels.tolist()):
        raise LogError(f"{place}: {column} holds {labels.dtype}, or null, and not names; give whole numbers or text")
    begins_here = np.append(True, labels[1:] != labels[:-1])[: len(labels)].astype(bool)
    if is_first is not None and (is_first != begins_here).any():
        row = int(np.argmax(is_first != begins_here))
        raise LogError(
            f"{place}, row {row}: {FIRST} is {bool(is_first[row])}, yet {column} is {shown(labels[row])}; mend one of "
            "the two"
        )
    at = np.flatnonzero(begins_here)
    found = labels[at].tolist()
    if len(set(found)) < len(found):
        twice = next(name for k, name in enumerate(found) if name in found[:k])
        raise LogError(f"{place}: the rows of episode {shown(twice)} do not stand together; sort them")
    return found, np.append(at, len(labels))


def _of_steps(values: Shaped[np.ndarray, "N ..."], is_step: Bool[np.ndarray, " N"]) -> Shaped[np.ndarray, "N ..."]:
    """Give rows in which nothing was done the action of one in which something was, so that they decide nothing."""
    kept = values.copy()
    if is_step.any():
        kept[~is_step] = values[int(np.argmax(is_step))]
    return kept


def _tell_unread(place: str, table: pa.Table, read: set[str], last_rewards: Float[np.ndarray, " E"]) -> None:
    known = {*read, *EPISODES, FIRST, LAST, TERMINAL}
    left_out = [name for name in table.column_names if name not in known and not name.startswith(SEEN)]
    if left_out:
        warn(place, f"left out are {', '.join(left_out)}: nobody saw them before the action")
    num_lost = int(np.count_nonzero(np.nan_to_num(last_rewards)))
    if num_lost:
        warn(
            place,
            f"{num_lost} rewards other than 0 stand in rows that are {LAST}, in which nothing was done any more: they "
            "are not read",
        )


def _ends(times_s: Float[np.ndarray, " O"], num_steps: int) -> Float[np.ndarray, " T"]:
    """Ends of the steps by the times of the rows; that the last step ended is known where a row follows it."""
    is_torn = len(times_s) == num_steps
    return ends_of(np.append(times_s, times_s[-1:]) if is_torn else times_s, num_steps)


def _ending(
    place: str,
    name: int | str,
    is_last: Bool[np.ndarray, " O"],
    is_terminal: Bool[np.ndarray, " O"],
    rules: StepRules,
) -> tuple[str, str | None]:
    refuse_early(place, name, is_last | is_terminal)
    if is_terminal[-1] and not is_last[-1]:
        raise LogError(
            f"{place}, episode {shown(name)}: its last row terminates it and is not {LAST}; mend one of the two"
        )
    if is_terminal[-1]:
        return FINISHED, None
    return rules.of_truncated if is_last[-1] else (CUT, UNKNOWN_CAUSE)
