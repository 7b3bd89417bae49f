"""What a log holds, what looks wrong, and what its weights rest on, ready for JSON."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from halfseen.censoring import KaplanMeier, positivity_report, stage_weights, weight_diagnostics
from halfseen.censoring.positivity import PositivityReport
from halfseen.logs import Logs
from halfseen.logs.breakdown import by_action, by_cause, by_robot, by_stage
from halfseen.logs.suspicions import suspicions
from halfseen.report.endings import endings
from halfseen.shapes import Float, Int

NUM_RISK_TIMES = 7


@dataclass(frozen=True, eq=False)
class Watched:
    """How long trajectories were watched, as Kaplan–Meier tells it with the cuts for events."""

    time_s: Float[np.ndarray, " k"]
    """Where Ĝ steps, from 0 to the last observed end [s]."""
    survival: Float[np.ndarray, " k"]
    """Ĝ from each of these times on."""
    ends_s: dict[str, Float[np.ndarray, " e"]]
    """Ends [s] of the trajectories that finished, and of those that each cause cut, the most frequent first."""
    risk_time_s: Float[np.ndarray, " r"]
    num_watched: Int[np.ndarray, " r"]
    """Trajectories that were still watched just before these times [s]."""


def log_findings(logs: Logs, positivity: PositivityReport) -> dict[str, Any]:
    """Collect what there is to say of a log; times in seconds."""
    summary = logs.summary()
    weights = stage_weights(logs.elapsed_s(), logs.end_s, logs.is_finished, trajectory_ids=logs.trajectory_ids)
    stages = [weight_diagnostics(column) for column in weights.T]
    return {
        "sentence": str(summary),
        **asdict(summary),
        "reward_unit": logs.reward_unit,
        "covariates": logs.stage_covariates,
        "object_covariates": []
        if logs.objects is None
        else [*logs.objects.columns.drop(["trajectory", "stage", "object"])],
        "trajectory_columns": logs.trajectory_columns,
        "suspicions": [asdict(suspicion) for suspicion in suspicions(logs)],
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


def positivity_of(logs: Logs) -> PositivityReport:
    """Report what the weights of the trajectories of a log rest on, by Kaplan–Meier."""
    return positivity_report(logs.end_s, logs.is_finished, trajectory_ids=logs.trajectory_ids)


def watched(logs: Logs) -> Watched:
    """Say how long the trajectories of a log were watched."""
    curve = KaplanMeier().fit(logs.end_s, logs.is_finished)
    risk_time_s = _round_times(curve.last_time_)
    return Watched(
        time_s=np.concatenate([[0.0], curve.times_, [curve.last_time_]]),
        survival=np.concatenate([[1.0], curve.survival_, curve.survival_[-1:] if len(curve.survival_) else [1.0]]),
        ends_s={name: np.sort(logs.end_s[is_own]) for name, is_own in endings(logs).items()},
        risk_time_s=risk_time_s,
        num_watched=len(logs.end_s) - np.searchsorted(np.sort(logs.end_s), risk_time_s, side="left"),
    )


def _finishes(logs: Logs) -> dict[str, Any]:
    """When and in which stages trajectories finished; None where none did."""
    ends_s = logs.end_s[logs.is_finished]
    last: Any = logs.stages.groupby("trajectory")["stage"].max().reindex(logs.trajectory_ids)[logs.is_finished]
    names = ("earliest_s", "median_s", "latest_s", "first_stage", "last_stage")
    if not len(ends_s):
        return dict.fromkeys(names)
    times = (float(of(ends_s)) for of in (np.min, np.median, np.max))
    return dict(zip(names, (*times, int(last.min()), int(last.max())), strict=True))


def _round_times(last_s: float) -> Float[np.ndarray, " r"]:
    """Some round times from 0 on that do not go beyond the last end."""
    step = last_s / (NUM_RISK_TIMES - 1)
    scale = 10.0 ** np.floor(np.log10(step))
    step = next(factor * scale for factor in (1.0, 2.0, 2.5, 5.0, 10.0) if factor * scale >= step)
    return np.arange(0.0, last_s + step / 1e6, step)
