"""Steps of other programs' datasets as stages.

A step becomes a stage: the observation, the action taken on it, its reward, and its end time. If a dataset has an
observation after the last step, a cut falls into the stage of that observation. If not, it falls into the last step
itself, and the reward of that step is ignored, since a stage that was not completed has none.

Columns have one row per step. Observations may be arrays, which are split into columns; all else is one value per step.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import prod
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from halfseen.errors import ArgumentError, LogError, warn, within
from halfseen.logs.columns import CUT, FINISHED, UNKNOWN_CAUSE, first_true, shown
from halfseen.logs.formats.step_clocks import refuse_counts, refuse_other_unit, refuse_rounded
from halfseen.logs.logs import Logs
from halfseen.logs.missing import Missing
from halfseen.shapes import Bool, Float, Int, Shaped

TRUNCATED = "truncated"
MOST_NUMBERS = 1000
"""Maximum size of an observation that becomes columns; larger ones are images or the like."""
Ending = tuple[str, str | None]
"""Ending and cause, as in `trajectories` of `Logs`."""
_WORDS = {"true": 1.0, "false": 0.0}
_MEANT = {"reward": "a number", "done": "true or false", "clock": "a time [s]"}


@dataclass(frozen=True)
class StepRules:
    """How to read a dataset of another program; None is the default of its format.

    Parameters
    ----------
    action, reward
        Columns of the action, one of finitely many, and of its reward.
    done
        Column that is true where an episode reached its own end.
    clock
        Column that holds the time [s].
    step_s
        Duration of a step [s] if there is no clock.
    truncated
        Ending of an episode that did not terminate: "cut", or "finished" (at its horizon).

    Raises
    ------
    ArgumentError
        `step_s` is not finite and positive, both `clock` and `step_s` are given, or `truncated` is neither.
    """

    action: str | None = None
    reward: str | None = None
    done: str | None = None
    clock: str | None = None
    step_s: float | None = None
    truncated: str = CUT

    def __post_init__(self) -> None:
        if self.step_s is not None and not (np.isfinite(self.step_s) and self.step_s > 0):
            raise ArgumentError(f"step_s {self.step_s}: a step lasts a finite time above 0 s")
        if self.step_s is not None and self.clock is not None:
            raise ArgumentError(f"step_s {self.step_s} and clock {self.clock!r}: both give the time; give only one")
        if self.truncated not in (CUT, FINISHED):
            raise ArgumentError(f"truncated {self.truncated!r}: it is neither {CUT!r} nor {FINISHED!r}; give one")

    @property
    def named(self) -> dict[str, str]:
        """The named columns, by role."""
        roles = ("action", "reward", "done", "clock")
        return {role: getattr(self, role) for role in roles if getattr(self, role) is not None}

    def endings(
        self, is_finished: Iterable[Any], is_truncated: Iterable[Any], otherwise: Ending = (CUT, UNKNOWN_CAUSE)
    ) -> list[Ending]:
        """Ending and cause of each episode: it reached its own end, was truncated, or ended otherwise."""
        truncated = (FINISHED, None) if self.truncated == FINISHED else (CUT, TRUNCATED)
        return [
            (FINISHED, None) if finished else truncated if stopped else otherwise
            for finished, stopped in zip(is_finished, is_truncated, strict=True)
        ]

    def step_in(self, place: str) -> float:
        """Duration of a step without a clock [s]; 1 s, with a warning, if it is not given."""
        if self.clock is None and self.step_s is None:
            warn(
                place,
                "no clock is named, so every step counts as 1 s; name it as clock, or give step_s",
            )
        return self.step_s or 1.0


@dataclass(frozen=True)
class StepColumns:
    """Columns of a dataset by name, one row per step; `place` names the dataset in messages."""

    place: str
    columns: Mapping[str, Shaped[np.ndarray, "N ..."]]
    counters: ClassVar[tuple[str, ...]] = ("step_id", "step_index", "frame_index")
    """Columns that number the steps of an episode."""

    def refuse_disorder(self, begins: Int[np.ndarray, " E1"]) -> None:
        """Refuse an episode whose rows are not in the order of their numbers (`LogError`)."""
        counted = {name: self.columns[name] for name in self.counters if name in self.columns}
        for name, number in counted.items():
            if number.dtype.kind not in "iu":
                continue
            is_back = number[1:] <= number[:-1]
            is_back[begins[1:-1] - 1] = False
            if (row := first_true(is_back)) is not None:
                trouble = f"{name} is {number[row + 1]} after {number[row]} in one episode"
                raise LogError(f"{self.place}, row {row + 1}: {trouble}; put the rows in order, or export them again")

    def numbers(self, name: str, role: str = "clock") -> Float[np.ndarray, " N"]:
        """Rewards, flags or times, one number per step; true counts as 1, dates from the first; others are refused."""
        values, flat = self.columns[name], self._flat(name)
        if flat.ndim == 1 and flat.dtype == object and (row := _first_text(flat)) is not None:
            trouble = f"{name} is {shown(flat[row])}, not {_MEANT[role]}"
            raise ArgumentError(f"{self.place}, row {row}: {trouble}; fix it, or name another column as {role}")
        if role == "clock" and flat.ndim == 1 and flat.dtype.kind in "mM":
            since = flat[:1] if flat.dtype.kind == "M" else np.timedelta64(0, "ns")
            flat = (flat - since) / np.timedelta64(1, "s")
        if flat.ndim != 1 or flat.dtype.kind not in "biuf":
            raise ArgumentError(
                f"{self.place}: {name} holds {values.dtype} of shape {values.shape[1:]}, not {_MEANT[role]} for "
                f"each step; name another column as {role}"
            )
        if role == "clock":
            refuse_rounded(self.place, name, flat)
            refuse_other_unit(self.place, name, flat)
        return flat.astype(np.float64)

    def flags(self, name: str) -> Bool[np.ndarray, " N"]:
        """Truth values, also given as 1 and 0 or as text; anything else is refused."""
        flat = self._flat(name)
        if flat.ndim == 1 and flat.dtype == object:
            numbers = np.array([_WORDS.get(str(value).lower(), np.nan) for value in flat], dtype=np.float64)
        else:
            numbers = self.numbers(name, "done")
        if (row := first_true(~((numbers == 0) | (numbers == 1)))) is not None:
            raise LogError(f"{self.place}, row {row}: {name} is {shown(flat[row])}, neither true nor false; fix it")
        return numbers.astype(bool)

    def actions(self, name: str, rows: Bool[np.ndarray, " N"] | slice = slice(None)) -> Shaped[np.ndarray, " M"]:
        """Actions of the given rows, each one of finitely many: whole numbers (null as None) or text."""
        values, flat = self.columns[name], self._flat(name)[rows]
        if flat.dtype == object and not _is_strange(flat, bool):
            flat = flat.astype(bool)
        if flat.ndim == 1 and flat.dtype.kind in "biu":
            if flat.dtype.kind == "u" and (flat >= 2**63).any():
                raise LogError(f"{self.place}: {name} is {flat.max()}, beyond 64-bit integers; give names as text")
            return flat.astype(np.int64)
        if flat.ndim == 1 and flat.dtype == object and not _is_strange(flat):
            return flat
        if flat.ndim == 1 and flat.dtype.kind == "f":
            is_null = np.isnan(flat)
            if (is_null | (np.isfinite(flat) & (flat == np.floor(flat)) & (np.abs(flat) < 2**53))).all():
                whole: Any = np.where(is_null, 0, flat).astype(np.int64)
                return np.where(is_null, np.array(None), whole.astype(object)) if is_null.any() else whole
        raise ArgumentError(
            f"{self.place}: {name} holds {values.dtype} of shape {values.shape[1:]}, but the action of a stage is "
            "one of finitely many; discretise it (say, with numpy.digitize), or name another column, of whole "
            "numbers or text, as action"
        )

    def observed(self, names: Iterable[str]) -> dict[str, Shaped[np.ndarray, " N"]]:
        """Columns of observations; those that are too long, or neither numbers nor text, are left out with a warning.

        Two observations that give the same column are refused (`LogError`).
        """
        observed: dict[str, np.ndarray] = {}
        passed_over = []
        for name in names:
            values = self.columns[name]
            if (
                values.dtype.kind not in "biufO"
                or values[:1].size > MOST_NUMBERS
                or _is_strange(values, str | bool | None)
            ):
                passed_over.append(f"{name} ({values.dtype} of shape {values.shape[1:]})")
                continue
            for column, entries in columns_of(name, values).items():
                if column in observed:
                    raise LogError(f"{self.place}: two observations become column {column!r}; rename one")
                observed[column] = entries
        if passed_over:
            warn(self.place, f"{', '.join(passed_over)}: columns of a stage cannot hold it, so it is left out")
        return observed

    def _flat(self, name: str) -> np.ndarray:
        values = self.columns[name]
        return values.reshape(len(values)) if values.ndim > 1 and values[:1].size == 1 else values


@dataclass(frozen=True)
class StepTable:
    """Episodes of a dataset, one below the other, in N rows: steps, or observations after the last step."""

    names: Sequence[int | str]
    """Names of the E trajectories."""
    begins: Int[np.ndarray, " E1"]
    """First row of each episode, and the number of rows, shape (E + 1,)."""
    is_step: Bool[np.ndarray, " N"]
    """Rows with an action: all except, perhaps, the last of an episode, shape (N,)."""
    observed: Mapping[str, Shaped[np.ndarray, " N"]]
    actions: Shaped[np.ndarray, " M"]
    """Actions of the M steps: whole numbers or text, shape (M,)."""
    rewards: Float[np.ndarray, " M"]
    """Reward of each step, shape (M,)."""
    ends_s: Float[np.ndarray, " M"]
    """End of each step since its episode began [s], shape (M,)."""
    endings: Sequence[Ending]

    def logs(self, place: str, missing: Missing = None) -> Logs:
        """Convert each episode to a trajectory; `place` names the dataset in messages, `missing` is as in `Logs`.

        Raises
        ------
        LogError
            There is no episode, an episode has no step, or the log breaks an invariant.
        """
        if not self.names:
            raise LogError(f"{place}: it has no episodes; a log has at least one trajectory")
        num_steps = np.add.reduceat(self.is_step, self.begins[:-1], dtype=np.int64)
        if (without := first_true(num_steps == 0)) is not None:
            name = shown(self.names[without])
            raise LogError(f"{place}, episode {name}: it has no step; leave the episode out")
        end_s = self.ends_s[np.cumsum(num_steps) - 1]
        refuse_counts(place, self.ends_s, num_steps)
        is_first = np.isin(np.arange(len(self.rewards)), np.cumsum(num_steps) - num_steps)
        if (np.isnan(self.rewards) == is_first).all() and not is_first.all():
            raise LogError(
                f"{place}: the first reward of each episode, and no other, is missing, so each seems to be of the "
                "action before; move it up to the row of that action"
            )
        ends: dict[str, Any] = {
            "trajectory": self.names,
            "end_s": end_s,
            "ending": [ending for ending, _ in self.endings],
            "cause": [cause for _, cause in self.endings],
        }
        with within(place):
            return Logs(
                self._stages(np.array([ending == CUT for ending in ends["ending"]])),
                pd.DataFrame(ends),
                missing=missing,
            )

    def _stages(self, is_cut: Bool[np.ndarray, " E"]) -> Any:
        """Build the stages; a cut falls into the last row of its episode, and the reward of that row is ignored."""
        last, sizes = self.begins[1:] - 1, np.diff(self.begins)
        episode = np.repeat(np.arange(len(sizes)), sizes)
        is_stage, is_completed = self.is_step.copy(), self.is_step.copy()
        is_stage[last] |= is_cut
        is_completed[last] &= ~is_cut
        of_steps = {"elapsed_s": self.ends_s, "reward": self.rewards}
        numbers = {name: np.full(len(self.is_step), np.nan) for name in of_steps}
        for name, values in of_steps.items():
            numbers[name][is_completed] = values[is_completed[self.is_step]]
        actions = np.full(len(self.is_step), None, dtype=object)
        actions[self.is_step] = self.actions
        columns = {
            "trajectory": np.array(self.names, dtype=object)[episode],
            "stage": np.arange(len(episode)) - self.begins[episode] + 1,
            "action": pd.array(actions.tolist(), dtype="Int64" if self.actions.dtype.kind == "i" else object),
            **numbers,
            **self.observed,
        }
        return pd.DataFrame(columns)[is_stage]


def begins_of(place: str, rows: str, labels: Shaped[np.ndarray, " N"], remedy: str) -> Int[np.ndarray, " E1"]:
    """Rows in which the label of the episode changes, and the number of rows.

    Raises
    ------
    LogError
        The rows of an episode are not contiguous.
    """
    at = np.flatnonzero(np.append(True, labels[1:] != labels[:-1])[: len(labels)])
    found = labels[at].tolist()
    if len(set(found)) < len(found):
        twice = next(name for k, name in enumerate(found) if name in found[:k])
        raise LogError(f"{place}: the {rows} of episode {shown(twice)} are not adjacent; {remedy}")
    return np.append(at, len(labels)).astype(np.int64)


def refuse_early(place: str, names: Sequence[int | str], begins: Any, ends: Bool[np.ndarray, " N"]) -> None:
    """Refuse an episode that ends before its last row (`LogError`); `begins` as in `StepTable`."""
    for name, (begin, end) in zip(names, pairwise(begins.tolist()), strict=True):
        if ends[begin : end - 1].any():
            raise LogError(
                f"{place}, episode {shown(name)}: step {int(np.argmax(ends[begin:end])) + 1} of {end - begin} ends it; "
                "make two episodes of it"
            )


def columns_of(name: str, values: Shaped[np.ndarray, "N ..."]) -> dict[str, Shaped[np.ndarray, " N"]]:
    """Split an array with one row per step into columns: NAME, or NAME_0, NAME_1, … if it has further axes."""
    if values.ndim == 1:
        return {name: values}
    flat = values.reshape(len(values), prod(values.shape[1:]))
    return {f"{name}_{k}": flat[:, k] for k in range(flat.shape[1])}


def require(place: str, names: Iterable[str], wanted: Mapping[str, str], remedy: str | None = None) -> None:
    """Refuse a dataset that lacks a wanted column (`ArgumentError`); `wanted` maps roles to columns."""
    there = list(names)
    for role, name in wanted.items():
        if name not in there:
            raise ArgumentError(
                f"{place}: there is no {name!r} for the {role} among {', '.join(there[:40]) or 'none'}; "
                f"{remedy or f'name another as {role}'}"
            )


def _first_text(values: np.ndarray) -> int | None:
    """The first text, of those that are no numbers if there is one; None without any text."""
    rows = [row for row, value in enumerate(values) if isinstance(value, str)]
    numbers: Any = pd.to_numeric(pd.Series([values[row] for row in rows], dtype=object), errors="coerce")
    return rows[int(np.argmax(np.isnan(numbers)))] if rows else None


def _is_strange(values: np.ndarray, kinds: Any = str | None) -> bool:
    """Whether an array holds objects of other kinds, by default of others than text and null."""
    return values.dtype == object and not all(isinstance(value, kinds) for value in values.flat)
