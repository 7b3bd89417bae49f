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
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import pandas as pd

from halfseen.errors import LogError
from halfseen.logs.formats.column_types import ColumnType, column_types, from_texts, texts
from halfseen.logs.logs import Logs
from halfseen.shapes import Float, Int

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
