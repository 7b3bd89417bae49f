"""The record of what happened: trajectories, their stages, the objects that stood there."""

from copy import copy
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from halfseen.arrays import RowMask, Rows
from halfseen.errors import LogError
from halfseen.logs.checked_tables import checked_objects, checked_stages, checked_trajectories, complete_stages
from halfseen.logs.columns import (
    FINISHED,
    OBJECT_COLUMNS,
    STAGE_COLUMNS,
    TRAJECTORY_COLUMNS,
    FrameLike,
    as_frame,
    is_stage_covariate,
    require_columns,
    shown,
    through_arrow,
)
from halfseen.logs.folder import write_tables
from halfseen.logs.missing import KEEP, Filling, Missing
from halfseen.logs.summary import LogsSummary, SummaryTally
from halfseen.logs.units import checked_unit
from halfseen.shapes import Float


class Logs:
    """Trajectories of a robot, one an episode, each finished or cut, checked once when the log is made.

    The tables are copied and sorted; do not change them in place. What they must satisfy is in `halfseen.logs.checks`.

    Parameters
    ----------
    stages
        One row a stage: trajectory, stage (from 1), elapsed_s (clock at the end of the stage [s], null if not
        completed), action, object (null where the action has none; may be left out), reward (null if not completed),
        probability (of the logged action; may be left out), and covariates. Of several robots also robot (which
        decided) and, for each robot r from 0, r_reward (what it alone brought, null if not completed; may be left out).
    trajectories
        One row a trajectory: trajectory, end_s [s], ending ("finished" | "cut"), cause (null unless cut; may be left
        out), and whatever else is known of the trajectory. Where a robot r may drop out alone, r_out_s and r_out_cause
        (null where it did not).
    objects
        One row an object of a stage: trajectory, stage, object, and covariates of the object, lists included; None
        where the stages have no objects.
    reward_unit
        What rewards are counted in, such as "parts": a short text, for people; None if nobody has said.
    missing
        What stands for covariates of the stages that are null: ``"median+flag"``, ``"last"`` or ``"refuse"``, for all
        or by column (``"*"`` for all others), or the `filling` of another log (see `halfseen.logs.missing`); None to
        refuse null, ``"keep"`` to let it stand.

    Raises
    ------
    LogError
        The tables break an invariant; the trajectory, the stage, the value and the remedy are named. Or the unit is no
        short text.
    ArgumentError
        `missing` is no rule, or names no covariate.

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
    ...         "cause": [None, "battery"],
    ...     },
    ... )
    >>> logs.elapsed_s()
    array([[1.5, 4. ],
           [nan, nan]])
    """

    def __init__(
        self,
        stages: FrameLike,
        trajectories: FrameLike,
        objects: FrameLike | None = None,
        *,
        reward_unit: str | None = None,
        missing: Missing = None,
    ) -> None:
        self._reward_unit = checked_unit(reward_unit)
        ends = checked_trajectories(as_frame("trajectories", trajectories, TRAJECTORY_COLUMNS))
        rows = checked_stages(as_frame("stages", stages, STAGE_COLUMNS), ends)
        rows, filling = complete_stages(rows, missing)
        self._missing = KEEP if missing == KEEP else filling
        self._objects = None
        if objects is not None:
            there = checked_objects(as_frame("objects", objects, OBJECT_COLUMNS), rows, ends)
            self._objects = through_arrow("objects", there)
        self._trajectories, self._stages = through_arrow("trajectories", ends), through_arrow("stages", rows)

    def __repr__(self) -> str:
        return f"<Logs: {self.summary()}>"

    @property
    def trajectories(self) -> pd.DataFrame:
        """One row a trajectory, sorted by trajectory: trajectory, end_s [s], ending, cause, and what else was given."""
        return self._trajectories

    @property
    def stages(self) -> pd.DataFrame:
        """One row a stage, sorted by trajectory and stage."""
        return self._stages

    @property
    def objects(self) -> pd.DataFrame | None:
        """One row an object of a stage, sorted by trajectory, stage and object; None where there are none."""
        return self._objects

    @property
    def reward_unit(self) -> str | None:
        """What rewards are counted in, such as "parts"; None if nobody has said."""
        return self._reward_unit

    @property
    def filling(self) -> Filling | None:
        """What stands for covariates that were null; None where null is refused, or stands."""
        return self._missing if isinstance(self._missing, Filling) else None

    @property
    def missing(self) -> Filling | str | None:
        """What was said of null, and learned: what a part of this log, or the like of it, is made with."""
        return self._missing

    def in_unit(self, reward_unit: str | None) -> "Logs":
        """The same log with rewards that are said to be counted in this unit; no number changes.

        Raises
        ------
        LogError
            The unit is no short text.
        """
        same = copy(self)
        same._reward_unit = checked_unit(reward_unit)
        return same

    @property
    def tables(self) -> dict[str, pd.DataFrame]:
        """The tables that there are, by name: stages, trajectories and, where there are any, objects."""
        tables = {"stages": self._stages, "trajectories": self._trajectories, "objects": self._objects}
        return {name: table for name, table in tables.items() if table is not None}

    @property
    def num_trajectories(self) -> int:
        """Number of trajectories n."""
        return len(self._trajectories)

    @property
    def num_stages(self) -> int:
        """Number of stages of all trajectories together, those in which a cut fell included."""
        return len(self._stages)

    @property
    def horizon(self) -> int:
        """Number of stages T of the longest trajectory."""
        return int(self._stages["stage"].max())

    @property
    def trajectory_ids(self) -> np.ndarray:
        """Names of the trajectories, shape (n,): the order of every array below."""
        return self._trajectories["trajectory"].to_numpy()

    @property
    def end_s(self) -> Rows:
        """Observed end of each trajectory [s]."""
        return self._trajectories["end_s"].to_numpy()

    @property
    def is_finished(self) -> RowMask:
        """True where the trajectory reached its own end, False where it was cut."""
        return (self._trajectories["ending"] == FINISHED).to_numpy(dtype=bool)

    @property
    def cut_share(self) -> float:
        """Proportion of the trajectories that were cut, in [0, 1]."""
        return float(np.mean(~self.is_finished))

    @property
    def stage_covariates(self) -> list[str]:
        """Names of the stages' covariates."""
        return [column for column in self._stages.columns if is_stage_covariate(column)]

    @property
    def trajectory_columns(self) -> list[str]:
        """Names of what else is known of the trajectories, such as the scene."""
        return [column for column in self._trajectories.columns if column not in TRAJECTORY_COLUMNS]

    def elapsed_s(self) -> Float[np.ndarray, "n T"]:
        """Clock at the end of each stage [s], NaN where it was not completed or there is none."""
        return self.stage_values("elapsed_s")

    def stage_values(self, column: str) -> Float[np.ndarray, "n T"]:
        """Spread a numeric column of `stages` over trajectories and stages; NaN where a trajectory has no such stage.

        Raises
        ------
        LogError
            There is no such column, or it holds no numbers.
        """
        require_columns("stages", self._stages, (column,))
        if not pd.api.types.is_numeric_dtype(self._stages[column].dtype):
            raise LogError(f"stages: column {column!r} holds no numbers; ask for a numeric column")
        values = np.full((self.num_trajectories, self.horizon), np.nan)
        stage = self._stages["stage"].to_numpy()
        values[np.cumsum(stage == 1) - 1, stage - 1] = self._stages[column].to_numpy(dtype=np.float64, na_value=np.nan)
        return values

    def durations_s(self) -> Float[np.ndarray, " rows"]:
        """Duration of each stage [s]; NaN where it was not completed."""
        return self._stages["elapsed_s"].to_numpy(dtype=np.float64) - self.begun_s()

    def begun_s(self) -> Float[np.ndarray, " rows"]:
        """Clock at which each stage began [s]."""
        elapsed_s = self._stages["elapsed_s"].to_numpy(dtype=np.float64)
        return np.where(self._stages["stage"].to_numpy() == 1, 0.0, np.append(0.0, elapsed_s[:-1]))

    @property
    def has_objects(self) -> bool:
        """Whether the stages have objects."""
        return self._objects is not None

    @property
    def has_all_actions(self) -> bool:
        """Whether the action of every stage is known, also where a trajectory was cut."""
        return bool(self.stages["action"].notna().to_numpy().all())

    def select(self, trajectories: Any) -> "Logs":
        """Keep some of the trajectories, for folds and bootstraps without repetition.

        Parameters
        ----------
        trajectories
            Names of the trajectories to keep, as in `trajectory_ids`.

        Raises
        ------
        LogError
            A name is unknown, or none is given.
        """
        wanted = pd.Index(trajectories)
        unknown = wanted[~wanted.isin(self.trajectory_ids)]
        if len(unknown):
            raise LogError(f"trajectory {shown(unknown[0])}: there is no such trajectory; choose among trajectory_ids")

        kept: Any = {name: table[pd.Index(table["trajectory"]).isin(wanted)] for name, table in self.tables.items()}
        return Logs(**kept, reward_unit=self._reward_unit, missing=self.missing)

    def summary(self) -> LogsSummary:
        """Count what is there: trajectories, endings and causes, stages, clock, actions."""
        tally = SummaryTally()
        tally.add(self._trajectories, self._stages, self._objects)
        return tally.summary()

    def write(self, folder: str | Path, *, overwrite: bool = False) -> None:
        """Write the tables as Parquet into a folder of their own, all or nothing.

        Parameters
        ----------
        folder
            Where to; missing parents are made.
        overwrite
            Replace logs that are already there.

        Raises
        ------
        ArgumentError
            The folder exists, or cannot be written.
        """
        write_tables(Path(folder), self.tables, overwrite=overwrite, reward_unit=self._reward_unit)
