"""The content of a log, its problems, and the support of its importance weights."""

from dataclasses import asdict, dataclass
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from halfseen.arrays import RowMask
from halfseen.censoring import KaplanMeier, positivity_report, stage_weights, weight_diagnostics
from halfseen.censoring.positivity import PositivityReport
from halfseen.logs import Logs
from halfseen.logs.data_quality import data_warnings
from halfseen.logs.grouping import by_action, by_cause, by_robot, by_stage
from halfseen.monitoring.training_log import changes_in
from halfseen.shapes import Float, Int

NUM_RISK_TIMES = 7
MOST_CAUSES = 5  # rarer causes are merged into one kind of ending
FINISHED = "finished"
MOST_ROWS = 160  # largest number of trajectories in a timeline
UNKNOWN_ACTION = "not recorded"


def log_findings(logs: Logs, positivity: PositivityReport) -> dict[str, Any]:
    """Collect the findings about a log, ready for JSON; times in seconds."""
    summary, objects = logs.summary(), logs.objects
    weights = stage_weights(logs.elapsed_s(), logs.end_s, logs.is_finished, trajectory_ids=logs.trajectory_ids)
    stages = [weight_diagnostics(column) for column in weights.T]
    return {
        "sentence": str(summary),
        **asdict(summary),
        "reward_unit": logs.reward_unit,
        "covariates": logs.stage_covariates,
        "object_covariates": [] if objects is None else [*objects.columns.drop(["trajectory", "stage", "object"])],
        "trajectory_columns": logs.trajectory_columns,
        "data_warnings": [*_changes(logs), *(asdict(warning) for warning in data_warnings(logs))],
        "finishes": _finishes(logs),
        "cuts": by_cause(logs),
        "choices": by_action(logs),
        "robots": by_robot(logs),
        "clock": by_stage(logs),
        "nothing_seen_beyond_s": summary.longest_s,
        "positivity": {
            "text": str(positivity),
            "is_sound": positivity.is_sound,
            "effective_sample_size": positivity.overall.effective_sample_size,
            "mean_weight": positivity.mean_weight,
            "identified_until_s": positivity.identified_until_s,
            "heaviest": [
                {"trajectory": str(heavy.trajectory), "time_s": heavy.time_s, "weight": heavy.weight}
                for heavy in positivity.heaviest
            ],
        },
        "weights": [
            {
                "stage": stage,
                "num_completed": worth.num_seen,
                "effective_sample_size": worth.effective_sample_size,
                "largest_weight": worth.largest_weight,
            }
            for stage, worth in enumerate(stages, start=1)
        ],
    }


def _changes(logs: Logs) -> list[dict[str, Any]]:
    """Changes of the cell or of a unit within the log, as `halfseen learn` finds them."""
    remedy = "convert a column whose unit changed, or learn with --since"
    sentences = [f"{each.sentence}: {remedy} {each.since}" for each in changes_in(logs)]
    return [{"kind": "changed-within", "sentence": sentence} for sentence in sentences]


def positivity_of(logs: Logs) -> PositivityReport:
    """Report on the positivity of the weights of the trajectories of a log, by Kaplan–Meier."""
    return positivity_report(logs.end_s, logs.is_finished, trajectory_ids=logs.trajectory_ids)


def _finishes(logs: Logs) -> dict[str, Any]:
    """Times and stages at which trajectories finished; None if none did."""
    ends_s = logs.end_s[logs.is_finished]
    last: Any = logs.stages.groupby("trajectory")["stage"].max().reindex(logs.trajectory_ids)[logs.is_finished]
    names = ("earliest_s", "median_s", "latest_s", "first_stage", "last_stage")
    if not len(ends_s):
        return dict.fromkeys(names)
    times = (float(of(ends_s)) for of in (np.min, np.median, np.max))
    return dict(zip(names, (*times, int(last.min()), int(last.max())), strict=True))


def endings(logs: Logs) -> dict[str, RowMask]:
    """Trajectories by kind of ending: finished if any did, then by cause, the most frequent first."""
    causes = [row["cause"] for row in by_cause(logs)]
    named = causes if len(causes) <= MOST_CAUSES else causes[: MOST_CAUSES - 1]
    cause = logs.trajectories["cause"].astype(str).to_numpy()
    ways = {FINISHED: logs.is_finished} if logs.is_finished.any() else {}
    ways |= {f"cut: {name}": ~logs.is_finished & (cause == name) for name in named}
    if len(named) < len(causes):
        ways[f"cut: {len(causes) - len(named)} other causes"] = ~logs.is_finished & ~np.isin(cause, named)
    return ways


@dataclass(frozen=True, eq=False)
class FollowUp:
    """How long trajectories were under observation, by Kaplan–Meier with cuts as events.

    Ĝ is `survival` from each of `time_s` on, where it steps, from 0 to the last observed end [s]. `ends_s` are the ends
    of the trajectories that finished, and of those cut by each cause, the most frequent first. `num_watched`
    trajectories were still under observation just before each of some round times [s].
    """

    time_s: Float[np.ndarray, " k"]
    survival: Float[np.ndarray, " k"]
    ends_s: dict[str, Float[np.ndarray, " e"]]
    risk_time_s: Float[np.ndarray, " r"]
    num_watched: Int[np.ndarray, " r"]


def follow_up(logs: Logs) -> FollowUp:
    """Compute how long the trajectories of a log were under observation."""
    curve = KaplanMeier().fit(logs.end_s, logs.is_finished)
    risk_time_s = _round_times(curve.last_time_)
    return FollowUp(
        time_s=np.concatenate([[0.0], curve.times_, [curve.last_time_]]),
        survival=np.concatenate([[1.0], curve.survival_, curve.survival_[-1:] if len(curve.survival_) else [1.0]]),
        ends_s={name: np.sort(logs.end_s[is_own]) for name, is_own in endings(logs).items()},
        risk_time_s=risk_time_s,
        num_watched=len(logs.end_s) - np.searchsorted(np.sort(logs.end_s), risk_time_s, side="left"),
    )


def _round_times(last_s: float) -> Float[np.ndarray, " r"]:
    """Some round times from 0 on, up to the last end."""
    step = last_s / (NUM_RISK_TIMES - 1)
    scale = 10.0 ** np.floor(np.log10(step))
    step = next(factor * scale for factor in (1.0, 2.0, 2.5, 5.0, 10.0) if factor * scale >= step)
    return np.arange(0.0, last_s + step / 1e6, step)


class EndingRows(NamedTuple):
    """Numbers of trajectories with one kind of ending, in all and in a timeline."""

    name: str
    num_trajectories: int
    num_rows: int


@dataclass(frozen=True, eq=False)
class Timeline:
    """Trajectories over time, one row each, by kind of ending and then by length; of many, an evenly spaced sample.

    `endings` are the kinds of ending in the order of the rows, `end_s` the ends of the rows [s], and `stages` the
    stages of the rows: row, begin_s, until_s [s], action, is_completed.
    """

    num_trajectories: int
    endings: tuple[EndingRows, ...]
    end_s: Float[np.ndarray, " r"]
    stages: pd.DataFrame

    @property
    def num_rows(self) -> int:
        """Number of trajectories shown."""
        return len(self.end_s)


def timeline(logs: Logs) -> Timeline:
    """Lay out the trajectories of a log; of many, evenly spaced ones of each kind of ending."""
    groups, picked = [], []
    for name, is_own in endings(logs).items():
        trajectories = np.flatnonzero(is_own)
        trajectories = trajectories[np.argsort(logs.end_s[trajectories], kind="stable")]
        num = num_own = len(trajectories)
        if logs.num_trajectories > MOST_ROWS:
            num = max(1, round(MOST_ROWS * num_own / logs.num_trajectories))
        at = np.linspace(0, num_own - 1, num) if num > 1 else np.array([(num_own - 1) / 2])
        picked.append(trajectories[np.round(at).astype(np.int64)])
        groups.append(EndingRows(name, num_own, num))
    rows = np.concatenate(picked)
    return Timeline(logs.num_trajectories, tuple(groups), logs.end_s[rows], _stages_of(logs, rows))


def _stages_of(logs: Logs, trajectories: Int[np.ndarray, " r"]) -> pd.DataFrame:
    """Stages of these trajectories, with the row of each, and its times of beginning and of completion or cut [s]."""
    row = pd.Series(np.arange(len(trajectories)), index=logs.trajectory_ids[trajectories])
    stages: Any = logs.stages[logs.stages["trajectory"].isin(list(row.index))]
    own = stages["trajectory"].map(row).to_numpy()
    elapsed_s = stages["elapsed_s"].to_numpy(dtype=np.float64, na_value=np.nan)
    begin_s = stages.groupby("trajectory")["elapsed_s"].shift(fill_value=0.0).to_numpy(dtype=np.float64)
    columns = {
        "row": own,
        "begin_s": begin_s,
        "until_s": np.where(np.isnan(elapsed_s), logs.end_s[trajectories][own], elapsed_s),
        "action": stages["action"].map(str, na_action="ignore").fillna(UNKNOWN_ACTION).to_numpy(dtype=object),
        "is_completed": stages["elapsed_s"].notna().to_numpy(),
    }
    return pd.DataFrame(columns)
