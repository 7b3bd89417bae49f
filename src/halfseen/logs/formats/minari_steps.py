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
class Steps:
    """A trajectory as the steps of an episode.

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
    return not pd.api.types.is_integer_dtype(values.dtype) or bool(
        values.between(-_LARGEST_EXACT, _LARGEST_EXACT).all()
    )


def steps_of(logs: Logs, schema: Schema) -> Iterator[Steps]:
    """Turn each trajectory into steps, in the order of the trajectories."""
    stages = logs.stages
    covariates = stages[schema.observations].to_numpy(dtype=np.float64)
    is_completed = stages["elapsed_s"].notna().to_numpy()
    kinds = schema.types["stages"]
    in_steps = {*_IN_STEPS, *schema.observations}
    action_texts = texts(stages["action"], kinds["action"])
    rest = _rows({name: texts(stages[name], kind) for name, kind in kinds.items() if name not in in_steps})
    objects = _objects_by_stage(logs, schema)
    trajectory_rows = _rows(
        {name: texts(logs.trajectories[name], kind) for name, kind in schema.types["trajectories"].items()}
    )
    index_of = {name: index for index, name in enumerate(schema.actions)}
    first = np.flatnonzero(stages["stage"].to_numpy() == 1)
    for trajectory, begin, end in zip(trajectory_rows, first, np.append(first[1:], len(stages)), strict=True):
        rows = np.arange(begin, end)
        done = rows[is_completed[rows]]
        carried: list[dict[str, Any]] = [{"cells": rest[row]} for row in rows]
        if not is_completed[end - 1]:
            carried[-1]["action"] = action_texts[end - 1]
        for row, stage in zip(rows, carried, strict=True):
            if objects is not None:
                stage["objects"] = objects[row]
        is_over = len(done) == len(rows)
        yield Steps(
            trajectory=trajectory,
            observations=covariates[np.append(rows, rows[-1:])] if is_over else covariates[rows],
            actions=np.array([index_of[str(action_texts[row])] for row in done], dtype=np.int64),
            rewards=stages["reward"].to_numpy()[done],
            clock_s=np.concatenate(([0.0], stages["elapsed_s"].to_numpy()[done])),
            stages=[*carried, {}] if is_over else carried,
        )


def logs_of(episodes: list[Steps], schema: Schema) -> Logs:
    """Put trajectories together again; the inverse of `steps_of`."""
    columns: dict[str, list[Any]] = {name: [] for name in schema.types["stages"]}
    numbers: dict[str, list[float]] = {name: [] for name in ("elapsed_s", "reward", *schema.observations)}
    objects: list[Cells] = []
    for episode in episodes:
        _check_lengths(episode)
        for t, stage in enumerate(episode.stages):
            if not stage:
                continue
            is_completed = t < len(episode.actions)
            action = schema.actions[episode.actions[t]] if is_completed else stage.get("action")
            own = {"trajectory": episode.trajectory["trajectory"], "stage": str(t + 1), "action": action}
            for name, cell in {**stage["cells"], **own}.items():
                columns[name].append(cell)
            values = [
                episode.clock_s[t + 1] if is_completed else np.nan,
                episode.rewards[t] if is_completed else np.nan,
                *episode.observations[t],
            ]
            for name, value in zip(numbers, values, strict=True):
                numbers[name].append(value)
            objects += [
                {**cells, "trajectory": own["trajectory"], "stage": own["stage"]} for cells in stage.get("objects", [])
            ]
    stages = {
        name: _typed_numbers(numbers[name], kind) if name in numbers else from_texts(columns[name], kind)
        for name, kind in schema.types["stages"].items()
    }
    return Logs(
        stages=pd.DataFrame(stages),
        trajectories=_frame([episode.trajectory for episode in episodes], schema.types["trajectories"]),
        objects=_frame(objects, schema.types["objects"]) if "objects" in schema.types else None,
    )


def _rows(columns: dict[str, list[str | None]]) -> list[Cells]:
    if not columns:
        return []
    return [dict(zip(columns, cells, strict=True)) for cells in zip(*columns.values(), strict=True)]


def _objects_by_stage(logs: Logs, schema: Schema) -> list[list[Cells]] | None:
    if logs.objects is None:
        return None
    cells = {name: texts(logs.objects[name], kind) for name, kind in schema.types["objects"].items()}
    keys = zip(cells.pop("trajectory"), cells.pop("stage"), strict=True)
    by_stage: dict[tuple[str | None, str | None], list[Cells]] = {}
    for key, row in zip(keys, _rows(cells), strict=True):
        by_stage.setdefault(key, []).append(row)
    kinds = schema.types["stages"]
    stages = zip(
        texts(logs.stages["trajectory"], kinds["trajectory"]), texts(logs.stages["stage"], kinds["stage"]), strict=True
    )
    return [by_stage[key] for key in stages]


def _check_lengths(episode: Steps) -> None:
    counts = len(episode.observations), len(episode.clock_s), len(episode.stages)
    if set(counts) != {len(episode.actions) + 1}:
        raise LogError(
            f"trajectory {episode.trajectory['trajectory']!r}: {counts} observations, clocks and stages do not fit "
            f"{len(episode.actions)} steps; each needs one more than there are steps"
        )


def _typed_numbers(values: list[float], kind: ColumnType) -> pd.Series:
    """Numbers of a column in its own type; null where NaN."""
    column = pd.Series(values, dtype="float64")
    if not isinstance(kind, str):
        raise LogError(f"the type {kind!r} is none of numbers; write the dataset again")
    dtype: Any = _PANDAS_NAMES.get(kind, kind)
    return column.astype(dtype)


def _frame(rows: list[Cells], types: dict[str, ColumnType]) -> pd.DataFrame:
    return pd.DataFrame({name: from_texts([row[name] for row in rows], kind) for name, kind in types.items()})
