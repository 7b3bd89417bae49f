"""The rows of a log of tables as arrays; `log_checks` checks their validity."""

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from halfseen.errors import LogError
from halfseen.logs import Logs
from halfseen.logs.columns import ROBOT, as_floats, as_labels, refuse, shown, value_at
from halfseen.shapes import Bool, Float, Int
from halfseen.world.actions import TARGETED, VERB_NAMES

FREE, PARKED, OUT = "FREE", "PARKED", "OUT"
"""States of an idle robot."""
NOTHING = -1
"""Object of a robot that acts on none."""
IDLE = {FREE: -1, PARKED: -2, OUT: -3}
"""Verbs of idle robots, below those of `Verb`."""
OF_OBJECT = ("trajectory", "stage", "object")
"""Columns that identify a row of the objects table."""
_UNKNOWN = -4


@dataclass(frozen=True)
class Lists:
    """A list column: its entries in order, the row of each entry, and the list length of each row."""

    row: Int[np.ndarray, " entries"]
    values: Float[np.ndarray, " entries"]
    lengths: Int[np.ndarray, " rows"]

    @property
    def place(self) -> Int[np.ndarray, " entries"]:
        """Index of each entry in the list of its row, from 0."""
        return np.arange(len(self.row)) - np.repeat(np.cumsum(self.lengths) - self.lengths, self.lengths)

    def rows_with(self, wrong: Bool[np.ndarray, " entries"]) -> Bool[np.ndarray, " rows"]:
        """Rows with a wrong entry."""
        return np.bincount(self.row[wrong], minlength=len(self.lengths)) > 0


@dataclass(frozen=True)
class TableLog:
    """The rows of a log of tables, stage by stage; every stage lists its objects."""

    logs: Logs
    objects: pd.DataFrame
    num_robots: int
    """0 for a log of one robot that works alone."""
    _lists: dict[str, Lists] = field(default_factory=dict)

    @cached_property
    def target(self) -> Int[np.ndarray, " rows"]:
        """Number of each row's object; see `object_numbers`."""
        return object_numbers(self.objects)

    @property
    def num_objects(self) -> int:
        """Largest number of objects in a trajectory."""
        return int(self.target.max(initial=0)) + 1

    @cached_property
    def first(self) -> Int[np.ndarray, " rows"]:
        """First row of each row's stage."""
        return np.arange(len(self.objects)) - self.objects.groupby(["trajectory", "stage"]).cumcount().to_numpy()

    @cached_property
    def of_stage(self) -> Int[np.ndarray, " rows"]:
        """Index of each row's stage among all stages."""
        return np.cumsum(self.first == np.arange(len(self.first))) - 1

    @cached_property
    def begun(self) -> Int[np.ndarray, " stages"]:
        """Row of the target of each stage's action; −1 if it has none."""
        acted_on = self.logs.stages["object"].to_numpy(dtype=object, na_value=None)[self.of_stage]
        is_it = np.asarray(self.objects["object"].to_numpy(dtype=object) == acted_on, dtype=bool)
        row = np.full(len(self.logs.stages), NOTHING)
        row[self.of_stage[is_it]] = np.flatnonzero(is_it)
        return row

    @cached_property
    def decider(self) -> Int[np.ndarray, " stages"]:
        """Robot that decides in each stage; −1 if it is not a robot of the log."""
        return pd.Index(range(self.num_robots)).get_indexer(self.logs.stages[ROBOT]).astype(np.int32)

    @cached_property
    def does(self) -> Int[np.ndarray, "stages K 2"]:
        """Verb (or a value of `IDLE`) and object of each robot's current action."""
        return np.stack([_doing(self.logs.stages, r) for r in range(self.num_robots)], axis=1)

    def of_robots(self, what: str) -> Float[np.ndarray, "stages K"]:
        """Stage column of each robot, such as since_s."""
        columns = (as_floats("stages", self.logs.stages, f"{r}_{what}") for r in range(self.num_robots))
        return np.stack([column.to_numpy() for column in columns], axis=1)

    @cached_property
    def is_reached(self) -> Bool[np.ndarray, "rows K"]:
        """Which robots reach each object."""
        found, lists = np.zeros((len(self.objects), self.num_robots), dtype=bool), self.lists("reached_by")
        found[lists.row, lists.values.astype(np.int64)] = True
        return found

    def lists(self, column: str) -> Lists:
        """Entries of a column of number lists; null raises an error."""
        if column not in self._lists:
            self._lists[column] = self._parsed(column)
        return self._lists[column]

    def _parsed(self, column: str) -> Lists:
        lists = pa.array(self.objects[column], from_pandas=True)
        if not (pa.types.is_list(lists.type) and _holds_numbers(lists.type.value_type)):
            raise LogError(
                f"objects: column {column!r} holds {lists.type}, not lists of numbers; give a list for each object"
            )
        row, flat = np.array(lists.value_parent_indices(), dtype=np.int64), lists.flatten()
        missing = np.array(lists.is_null(), dtype=bool)
        missing[row[np.array(flat.is_null(), dtype=bool)]] = True
        self.refuse_objects(
            column, missing, "is or holds null; give a list for each object, empty if it has no entries"
        )
        return Lists(row, np.array(flat, dtype=np.float64), np.bincount(row, minlength=len(self.objects)))

    def refuse_objects(self, column: str, wrong: Any, trouble: str) -> None:
        """Raise a `LogError` for the first wrong row of the objects, with its value in the column."""
        frame, wrong = self.objects, np.asarray(wrong, dtype=bool)
        refuse(frame, wrong, lambda row: f"{column} {trouble} (it is {shown(value_at(frame, column, row))})", OF_OBJECT)

    def refuse_stages(self, column: str, wrong: Any, trouble: str) -> None:
        """Raise a `LogError` for the first wrong stage, with its value in the column."""
        stages, wrong = self.logs.stages, np.asarray(wrong, dtype=bool)
        refuse(stages, wrong, lambda row: f"{column} is {shown(value_at(stages, column, row))}, {trouble}")


def _holds_numbers(kind: pa.DataType) -> bool:
    tests = (pa.types.is_floating, pa.types.is_integer, pa.types.is_boolean, pa.types.is_null)
    return any(test(kind) for test in tests)


def _doing(stages: pd.DataFrame, robot: int) -> Int[np.ndarray, "stages 2"]:
    column = f"{robot}_does"
    code, words = pd.factorize(as_labels("stages", stages, column, is_null_allowed=True), use_na_sentinel=False)
    known = np.array([_parsed(str(each)) for each in words], dtype=np.int64).reshape(-1, 2)
    remedy = f"give one of {', '.join((*IDLE, *VERB_NAMES))}, the verbs of an object with its number"
    wrong = known[code, 0] == _UNKNOWN
    refuse(stages, wrong, lambda row: f"{robot}_does is {shown(words[code[row]])}; {remedy}")
    return known[code]


def _parsed(words: str) -> tuple[int, int]:
    verb, _, target = words.partition(" ")
    if words in IDLE:
        return IDLE[words], 0
    if verb not in VERB_NAMES or (target.isdecimal() != (VERB_NAMES.index(verb) in TARGETED)):
        return _UNKNOWN, 0
    return VERB_NAMES.index(verb), int(target or 0)


def object_numbers(objects: pd.DataFrame) -> Int[np.ndarray, " rows"]:
    """Index of each row's object among all objects of its trajectory, from 0, in the order of their names.

    A stage lists only the objects in view so far, so the row position of an object may change between stages.
    """
    trajectory, name = (
        pd.factorize(objects[column], sort=True)[0].astype(np.int64) for column in ("trajectory", "object")
    )
    each, place = np.unique(trajectory * (name.max(initial=0) + 1) + name, return_inverse=True)
    return place - np.searchsorted(each, trajectory * (name.max(initial=0) + 1))


def begun_objects(logs: Logs) -> Int[np.ndarray, " stages"]:
    """Index of the target of each stage's action; −1 if it has none."""
    assert logs.objects is not None
    log = TableLog(logs, logs.objects, 0)
    return np.where(log.begun >= 0, log.target[log.begun], NOTHING)
