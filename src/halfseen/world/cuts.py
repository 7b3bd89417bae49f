"""Cuts, which end an episode from outside the task: hazards, their calibration to a wanted share, and cutting.

The hazard of a cut is ``rate · intensity``. There are three intensities, all integrated stage by stage:

``independent``
    1: the cut comes at C ~ Exp(rate), whatever happens on the table.
``occlusion``
    exp(3·mean occlusion of the objects on the table): the camera loses track when much is hidden.
``attempt``
    the age of the action in progress [s]: the operator intervenes when an attempt drags on.

The rate is calibrated so that, in expectation, the wanted share of a policy's trajectories is cut.

A robot of a team that drops out alone cuts nothing. The log records it, and `cut_at_drop_outs` can treat it as a cut.
"""

from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
import pandas as pd

from halfseen.errors import ArgumentError
from halfseen.logs import Logs
from halfseen.logs.columns import CUT, is_own_reward, robots_that_may_drop_out
from halfseen.shapes import Bool, Float
from halfseen.world.rollout import Episodes
from halfseen.world.state import occlusion

CutKind = Literal["independent", "occlusion", "attempt"]
CUT_KINDS: tuple[str, ...] = get_args(CutKind)
CAUSES = {"independent": "operator", "occlusion": "sensor-lost", "attempt": "operator"}
DROP_OUT_CAUSE = "battery"
_OCCLUSION_GAIN = 3.0
_LOWEST_LOG_RATE = -40.0


@dataclass(frozen=True)
class CutEpisodes:
    """Episodes of which some were cut: the data that a recorder would have kept.

    A cut trajectory keeps its completed stages and S_t of the stage in which it was cut.
    """

    episodes: Episodes
    end_s: Float[np.ndarray, " n"]
    """Observed end of each trajectory on its clock [s]."""
    is_finished: Bool[np.ndarray, " n"]
    """True if the trajectory came to its own end, False if it was cut."""
    is_completed: Bool[np.ndarray, "n T"]
    """Stages whose reward was observed."""
    is_begun: Bool[np.ndarray, "n T"]
    """Stages whose S_t was observed: those completed and, on a cut trajectory, the one in which it was cut."""


def unit_hazards(episodes: Episodes, kind: CutKind | str) -> Float[np.ndarray, "n T"]:
    """Integrated hazard of each stage at rate 1."""
    if kind not in CUT_KINDS:
        raise ArgumentError(f"cut kind is {kind!r}; give one of {', '.join(CUT_KINDS)}")
    duration_s = np.asarray(episodes.duration_s, dtype=np.float64)
    if kind == "independent":
        hazard = duration_s
    elif kind == "attempt":
        hazard = duration_s**2 / 2.0
    else:
        is_left = episodes.states.is_on_table
        hidden = np.where(is_left, occlusion(episodes.states), np.float32(0.0)).sum(axis=-1)
        num_left = np.maximum(is_left.sum(axis=-1), 1).astype(np.float32)
        hazard = duration_s * np.exp(np.float32(_OCCLUSION_GAIN) * hidden / num_left).astype(np.float64)
    return np.where(np.asarray(episodes.is_taken), hazard, 0.0)


def check_share(cut_share: float | int) -> None:
    """Check that the share of cut trajectories is in [0, 1)."""
    if not 0.0 <= cut_share < 1.0:
        raise ArgumentError(f"cut share is {cut_share}; give a share of cut trajectories in [0, 1)")


def cut_rate(pilot: Episodes, cut_share: float | int, kind: CutKind | str) -> float:
    """Return the rate that cuts the wanted share of trajectories like those of `pilot`, in expectation.

    Raises
    ------
    ArgumentError
        `cut_share` is outside [0, 1).
    """
    check_share(cut_share)
    if cut_share == 0.0:
        return 0.0
    total = unit_hazards(pilot, kind).sum(axis=1)

    def excess(log_rate: float) -> float:
        return float(np.mean(-np.expm1(-np.exp(log_rate) * total))) - cut_share

    if excess(_LOWEST_LOG_RATE) > 0:  # so rare that 1 − exp(−x) ≈ x: the share is the rate times the mean hazard
        return float(cut_share / np.mean(total))
    low, high = _LOWEST_LOG_RATE, -_LOWEST_LOG_RATE
    while low < (middle := (low + high) / 2.0) < high:  # bisection to the last bit: the share grows with the rate
        low, high = (low, middle) if excess(middle) > 0 else (middle, high)
    return float(np.exp(high))


def cut(episodes: Episodes, rate: float, kind: CutKind | str, rng: np.random.Generator) -> CutEpisodes:
    """Cut episodes at hazard `rate` times the intensity of `kind`.

    A trajectory is cut where the accumulated hazard exceeds an Exp(1) draw. A stage that ends at that very moment
    counts as completed (completions precede cuts).
    """
    is_taken = np.asarray(episodes.is_taken)
    duration_s = np.asarray(episodes.duration_s, dtype=np.float64)
    hazard = rate * unit_hazards(episodes, kind)
    after = np.cumsum(hazard, axis=1)
    budget = rng.exponential(size=len(hazard))
    is_completed = is_taken & (after <= budget[:, None])
    is_finished = is_completed.sum(axis=1) == is_taken.sum(axis=1)
    stage = np.minimum(is_completed.sum(axis=1), hazard.shape[1] - 1)
    rows = np.arange(len(hazard))
    begun_s = np.where(is_completed, duration_s, 0.0).sum(axis=1)
    spent = (budget - (after - hazard)[rows, stage]) / np.where(hazard[rows, stage] > 0, hazard[rows, stage], np.inf)
    age_share = np.sqrt(np.maximum(spent, 0.0)) if kind == "attempt" else spent
    end_s = begun_s + np.where(is_finished, 0.0, age_share * duration_s[rows, stage])
    is_cut_stage = (np.arange(hazard.shape[1]) == stage[:, None]) & ~is_finished[:, None]
    return CutEpisodes(episodes, end_s, is_finished, is_completed, is_completed | is_cut_stage)


def drop_out_columns(cuts: CutEpisodes, cause: str) -> dict[str, Any]:
    """Columns of each robot's drop-out time and cause, null if it did not drop out; no columns if no robot can."""
    if cuts.episodes.out_s is None:
        return {}
    duration_s = np.where(cuts.is_completed, np.asarray(cuts.episodes.duration_s, dtype=np.float64), 0.0)
    at_s = (np.cumsum(duration_s, axis=1) - duration_s)[..., None] + np.asarray(cuts.episodes.out_s, dtype=np.float64)
    out_s = np.where(cuts.is_begun[..., None], at_s, np.inf).min(axis=1)
    is_seen = np.isfinite(out_s) & (out_s <= cuts.end_s[:, None])
    found: dict[str, Any] = {}
    for r in range(is_seen.shape[1]):
        found[f"{r}_out_s"] = np.where(is_seen[:, r], out_s[:, r], np.nan)
        found[f"{r}_out_cause"] = np.where(is_seen[:, r], cause, np.array(None))
    return found


def cut_at_drop_outs(logs: Logs) -> Logs:
    """Cut each trajectory at its first drop-out, with its cause, to estimate the value without drop-outs.

    The stage of the drop-out is not completed, even if it ended then because waiting robots became free: without the
    drop-out it would have gone on.

    Parameters
    ----------
    logs
        The log of a team.
    """
    robots = robots_that_may_drop_out(logs.trajectories)
    if not robots:
        return logs
    out_s = logs.trajectories[[f"{r}_out_s" for r in robots]].to_numpy(dtype=np.float64)
    named = logs.trajectories.reindex(columns=[f"{r}_out_cause" for r in robots]).to_numpy(dtype=object)
    rows, first = np.arange(len(out_s)), np.argmin(np.where(np.isnan(out_s), np.inf, out_s), axis=1)
    first_s, cause = out_s[rows, first], named[rows, first]
    is_out = ~np.isnan(first_s)
    trajectories = logs.trajectories.drop(
        columns=[f"{r}_{what}" for r in robots for what in ("out_s", "out_cause")], errors="ignore"
    )
    trajectories = trajectories.assign(
        end_s=np.where(is_out, first_s, trajectories["end_s"]),
        ending=np.where(is_out, CUT, trajectories["ending"]),
        cause=np.where(is_out, cause, trajectories["cause"].astype(object)),
    )
    trajectory_row, stages = pd.Index(logs.trajectory_ids).get_indexer(logs.stages["trajectory"]), logs.stages
    begin_s, at_s = (
        stages["elapsed_s"].groupby(trajectory_row).shift(fill_value=0.0).to_numpy(),
        first_s[trajectory_row],
    )
    is_after = begin_s >= at_s
    is_in = ~is_after & ~(stages["elapsed_s"].to_numpy() < at_s) & ~np.isnan(at_s)
    outcomes = ["elapsed_s", "reward", *filter(is_own_reward, stages.columns)]
    kept: Any = stages.assign(**{name: stages[name].mask(pd.Series(is_in)) for name in outcomes})[~is_after]
    objects = (
        None if logs.objects is None else logs.objects.merge(kept[["trajectory", "stage"]], on=["trajectory", "stage"])
    )
    return Logs(kept, trajectories, objects, reward_unit=logs.reward_unit)
