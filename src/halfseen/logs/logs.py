"""A log: trajectories, their stages, and the objects in each stage."""

from collections import Counter
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from halfseen.arrays import RowMask, Rows
from halfseen.errors import LogError
from halfseen.logs.checked_tables import checked_objects, checked_stages, checked_trajectories, complete_stages
from halfseen.logs.checks import checked_unit
from halfseen.logs.columns import (
    FINISHED,
    TRAJECTORY_COLUMNS,
    chosen_names,
    is_stage_covariate,
    require_columns,
)
from halfseen.logs.frames import FrameLike, as_frame, through_arrow
from halfseen.logs.missing import KEEP, Filling, Missing
from halfseen.logs.parquet import TABLES, write_tables
from halfseen.shapes import Float
from halfseen.writing import path_of


@dataclass(frozen=True)
class LogsSummary:
    """Counts of a log.

    Parameters
    ----------
    num_trajectories, num_finished, num_cut
        Number of trajectories, of those that finished, and of those that were cut.
    cut_share
        Proportion of the trajectories that were cut, in [0, 1].
    num_stages, num_completed
        Number of stages in all trajectories, and of those that were completed.
    horizon
        Number of stages in the longest trajectory.
    shortest_s, longest_s
        The earliest and the latest observed end of a trajectory [s].
    causes, actions
        Number of trajectories for each cause of a cut, and of completed stages for each action, most frequent
        first.
    num_objects
        Number of distinct object names; 0 if the stages have no objects.
    """

    num_trajectories: int
    num_finished: int
    num_cut: int
    cut_share: float
    causes: dict[str, int]
    num_stages: int
    num_completed: int
    horizon: int
    shortest_s: float
    longest_s: float
    actions: dict[str, int]
    num_objects: int

    def __str__(self) -> str:
        trajectories = "trajectory" if self.num_trajectories == 1 else "trajectories"
        stages = "1 stage" if self.horizon == 1 else f"{self.horizon} stages"
        return (
            f"{self.num_trajectories} {trajectories} of up to {stages} and {self.longest_s:.4g} s: {self.num_finished} "
            f"finished, {self.num_cut} cut ({self.cut_share:.0%})."
        )


class Logs:
    """A robot's trajectories, one per episode, each finished or cut. The log is checked once, when it is made.

    The tables are copied and sorted; do not change them in place. `halfseen.logs.checks` has their invariants.

    Parameters
    ----------
    stages
        One row per stage: trajectory, stage (from 1), elapsed_s (clock at the end of the stage [s], null if not
        completed), action, object (null if the action has none; optional), reward (null if not completed),
        probability (of the logged action; optional), and covariates. With several robots also robot (the one that
        decided) and, for each robot r from 0, r_reward (its own reward, null if not completed; optional).
    trajectories
        One row per trajectory: trajectory, end_s [s], ending ("finished" | "cut"), cause (null unless cut; optional),
        and any further columns of the trajectory. Where a robot r may drop out alone, r_out_s and r_out_cause
        (null where it did not).
    objects
        One row per object of a stage: trajectory, stage, object, and covariates of the object, lists included; None
        if the stages have no objects.
    reward_unit
        Unit of the rewards, such as "parts": a short text, for people; None if unknown.
    missing
        What replaces null in covariates of the stages: ``"median+flag"``, ``"last"`` or ``"refuse"``, for all
        or by column (``"*"`` for all others), or the `filling` of another log (see `halfseen.logs.missing`); None to
        refuse null, ``"keep"`` to keep it.

    Raises
    ------
    LogError
        The tables violate an invariant; the message names the trajectory, the stage, the value and the remedy. Or the
        unit is not a short text.
    ArgumentError
        `missing` is not a known rule, or names a column that is not a covariate.

    Examples
    --------
    >>> logs = Logs(
    ...     stages={
    ...         "trajectory": [0, 0, 1],
    ...         "stage": [1, 2, 1],
    ...         "elapsed_s": [1.5, 4.0, None],
    ...         "action": ["A", "B", "A"],
    ...         "reward": [0.0, 1.0, None],
    ...         "x": [0.1, 0.2, 0.3],
    ...     },
    ...     trajectories={
    ...         "trajectory": [0, 1],
    ...         "end_s": [4.0, 2.5],
    ...         "ending": ["finished", "cut"],
    ...     },
    ... )
    >>> logs.elapsed_s()
    array([[1.5, 4. ],
           [nan, nan]])
    """

    trajectories: pd.DataFrame
    """One row per trajectory, sorted by trajectory: trajectory, end_s [s], ending, cause, and any further columns."""
    stages: pd.DataFrame
    """One row per stage, sorted by trajectory and stage."""
    objects: pd.DataFrame | None
    """One row per object of a stage, sorted by trajectory, stage and object; None if there are none."""
    reward_unit: str | None
    missing: Filling | str | None
    """The rule for null, or the filling learned by it. Pass it on to build a part of this log or a similar log."""

    def __init__(
        self,
        stages: FrameLike,
        trajectories: FrameLike,
        objects: FrameLike | None = None,
        *,
        reward_unit: str | None = None,
        missing: Missing = None,
    ) -> None:
        self.reward_unit = checked_unit(reward_unit)
        ends = checked_trajectories(as_frame("trajectories", trajectories))
        rows = checked_stages(as_frame("stages", stages), ends)
        rows, filling = complete_stages(rows, missing)
        self.missing = KEEP if missing == KEEP else filling
        there = None if objects is None else checked_objects(as_frame("objects", objects), rows, ends)
        self.objects = None if there is None else through_arrow("objects", there)
        self.trajectories, self.stages = through_arrow("trajectories", ends), through_arrow("stages", rows)

    def __repr__(self) -> str:
        return f"<Logs: {self.summary()}>"

    @property
    def filling(self) -> Filling | None:
        """Values that replace null in covariates; None if null is refused or kept."""
        return self.missing if isinstance(self.missing, Filling) else None

    def in_unit(self, reward_unit: str | None) -> "Logs":
        """The same log with its rewards labelled with this unit, a short text; no number changes."""
        same = copy(self)
        same.reward_unit = checked_unit(reward_unit)
        return same

    @property
    def tables(self) -> dict[str, pd.DataFrame]:
        """The tables by name: stages, trajectories and, if there are any, objects."""
        return {name: table for name in TABLES if (table := vars(self)[name]) is not None}

    @property
    def num_trajectories(self) -> int:
        """Number of trajectories n."""
        return len(self.trajectories)

    @property
    def num_stages(self) -> int:
        """Number of stages in all trajectories, including those in which a cut fell."""
        return len(self.stages)

    @property
    def horizon(self) -> int:
        """Number of stages T in the longest trajectory."""
        return int(self.stages["stage"].max())

    @property
    def trajectory_ids(self) -> np.ndarray:
        """Names of the trajectories, shape (n,), in the order of every array below."""
        return self.trajectories["trajectory"].to_numpy()

    @property
    def end_s(self) -> Rows:
        """Observed end of each trajectory [s]."""
        return self.trajectories["end_s"].to_numpy()

    @property
    def is_finished(self) -> RowMask:
        """True where the trajectory reached its own end, False where it was cut."""
        return (self.trajectories["ending"] == FINISHED).to_numpy(dtype=bool)

    @property
    def cut_share(self) -> float:
        """Proportion of the trajectories that were cut, in [0, 1]."""
        return float(np.mean(~self.is_finished))

    @property
    def stage_covariates(self) -> list[str]:
        """Names of the stages' covariates."""
        return [column for column in self.stages.columns if is_stage_covariate(column)]

    @property
    def trajectory_columns(self) -> list[str]:
        """Names of the further columns of the trajectories, such as the scene."""
        return [column for column in self.trajectories.columns if column not in TRAJECTORY_COLUMNS]

    def elapsed_s(self) -> Float[np.ndarray, "n T"]:
        """Clock at the end of each stage [s]; NaN where a stage was not completed or does not exist."""
        return self.stage_values("elapsed_s")

    def stage_values(self, column: str) -> Float[np.ndarray, "n T"]:
        """Spread a numeric column of `stages` over trajectories and stages; NaN where a trajectory has no such stage.

        Raises
        ------
        LogError
            There is no such column, or it is not numeric.
        """
        require_columns("stages", self.stages, (column,))
        if not pd.api.types.is_numeric_dtype(self.stages[column].dtype):
            raise LogError(f"stages: column {column!r} holds no numbers; give a numeric column")
        values = np.full((self.num_trajectories, self.horizon), np.nan)
        stage = self.stages["stage"].to_numpy()
        values[np.cumsum(stage == 1) - 1, stage - 1] = self.stages[column].to_numpy(dtype=np.float64, na_value=np.nan)
        return values

    def durations_s(self) -> Float[np.ndarray, " rows"]:
        """Duration of each stage [s]; NaN where it was not completed."""
        return self.stages["elapsed_s"].to_numpy(dtype=np.float64) - self.begun_s()

    def begun_s(self) -> Float[np.ndarray, " rows"]:
        """Clock at which each stage began [s]."""
        elapsed_s = self.stages["elapsed_s"].to_numpy(dtype=np.float64)
        return np.where(self.stages["stage"].to_numpy() == 1, 0.0, np.append(0.0, elapsed_s[:-1]))

    @property
    def has_objects(self) -> bool:
        """Whether the stages have objects."""
        return self.objects is not None

    @property
    def has_all_actions(self) -> bool:
        """Whether the action of every stage is known, including stages in which a trajectory was cut."""
        return bool(self.stages["action"].notna().to_numpy().all())

    def select(self, trajectories: Any) -> "Logs":
        """Keep some of the trajectories, for cross-validation folds and subsampling without replacement.

        Parameters
        ----------
        trajectories
            Names of the trajectories to keep, as in `trajectory_ids`.

        Raises
        ------
        LogError
            A name is unknown or given twice, no name is given, or it is a mask.
        """
        wanted = chosen_names(trajectories, self.trajectory_ids)
        kept: Any = {name: table[pd.Index(table["trajectory"]).isin(wanted)] for name, table in self.tables.items()}
        return Logs(**kept, reward_unit=self.reward_unit, missing=self.missing)

    def summary(self) -> LogsSummary:
        """Count trajectories, endings, causes, stages and actions, and give the range of the clock."""
        tally = SummaryTally()
        tally.add(self)
        return tally.summary()

    def write(self, folder: str | Path, *, overwrite: bool = False) -> None:
        """Write the tables as Parquet into their own folder, all or nothing.

        Parameters
        ----------
        folder
            Target folder; missing parents are created.
        overwrite
            Replace logs that are already there.

        Raises
        ------
        ArgumentError
            It is no folder of this machine, exists, or cannot be written.
        """
        write_tables(path_of(folder), self.tables, overwrite=overwrite, reward_unit=self.reward_unit)


class SummaryTally:
    """Accumulates the summary of a log that arrives in parts."""

    def __init__(self) -> None:
        self._counts: Counter[str] = Counter()
        self._causes: Counter[str] = Counter()
        self._actions: Counter[str] = Counter()
        self._objects: set[Any] = set()
        self._extents: list[tuple[int, float, float]] = []

    def add(self, part: Logs) -> None:
        """Add the counts of a part."""
        actions, num_cut = part.stages["action"][part.stages["elapsed_s"].notna()], int((~part.is_finished).sum())
        self._counts.update(num_trajectories=part.num_trajectories, num_finished=part.num_trajectories - num_cut)
        self._counts.update(num_cut=num_cut, num_stages=part.num_stages, num_completed=len(actions))
        self._causes.update(_counts(part.trajectories["cause"]))
        self._actions.update(_counts(actions))
        self._objects.update(() if part.objects is None else part.objects["object"].unique())
        self._extents.append((part.horizon, float(part.end_s.min()), float(part.end_s.max())))

    def summary(self) -> LogsSummary:
        """The summary of all parts. Ties are ordered by name, so equal logs have equal summaries."""
        horizons, shortest_s, longest_s = zip(*self._extents, strict=True)
        return LogsSummary(
            **self._counts,
            cut_share=1.0 - self._counts["num_finished"] / self._counts["num_trajectories"],
            causes=_ranked(self._causes),
            horizon=max(horizons),
            shortest_s=min(shortest_s),
            longest_s=max(longest_s),
            actions=_ranked(self._actions),
            num_objects=len(self._objects),
        )


def _counts(values: Any) -> dict[str, int]:
    return {str(value): int(count) for value, count in values.value_counts(sort=False).items() if count}


def _ranked(counts: Counter[str]) -> dict[str, int]:
    return dict(sorted(counts.items(), key=lambda pair: (-pair[1], pair[0])))
