"""What is watched beside the reward: of each trajectory its covariates by stage, what its actions brought, its cut.

A covariate of the first stage is held against the log that was learned from: no action has come before it. What comes
later depends on who decides, so it is held against what the policy itself has seen so far; rewards and durations are
held against both, given the state.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import Any, Literal

import numpy as np
import pandas as pd
from pandas.api.types import is_numeric_dtype
from scipy.special import ndtri

from halfseen.learning.covariates import Covariates
from halfseen.logs import Logs
from halfseen.policies.folder.promised_parts import WHATS, expanded_as, moves, outcome_rows, residuals
from halfseen.shapes import Bool, Float, Int

Kind = Literal["input", "reward", "duration", "cut", "swap", "move"]

OFF, MISFIT = 0.01, 0.1
"""What a mean residual may be off: as many standard errors as any of the log's models exceeds with this chance, and a
tenth of the residuals' deviation, by which its line may be bent."""
LEAST_DEVIATION = 0.1
"""Of the largest among the actions: what always brought the same may now bring a little else."""
ZERO_OF = 3.0
"""What never happened in n steps has a chance of at most 3 / n, at 95 %."""
MOST_PAIRS = 15
"""Of covariates that may be swapped; others differ so much that each shows it by itself."""
_NOTHING = (np.zeros(0), np.zeros(0), np.zeros(0, dtype=int))


@dataclass(frozen=True)
class Stream:
    """Values, one a trajectory, in bins that were fixed before.

    Parameters
    ----------
    kind
        What it is of.
    about
        The covariate, or the action, or the two covariates that may be swapped; "" for cuts.
    stage
        Of a covariate.
    values
        NaN where a trajectory has none; of text the number of its bin.
    bins
        −1 where there is none.
    counts
        Values of the reference in each bin; all 0 where there is none.
    is_number
        Whether bins have an order that means something.
    residuals, trajectory
        Of a part: each residual from the log's model, and the place of its trajectory; of a covariate that never
        changed within a trajectory, 1 for each step in which it did.
    tolerance
        What the model may be off there, either way.
    reach
        Where residuals are clipped, either way.
    num_states
        States of the log that the model was fitted to.
    """

    kind: Kind
    about: str
    stage: int | None
    values: Float[np.ndarray, " n"]
    bins: Int[np.ndarray, " n"]
    counts: Float[np.ndarray, " K"]
    is_number: bool = True
    residuals: Float[np.ndarray, " m"] = field(default_factory=lambda: np.zeros(0))
    trajectory: Int[np.ndarray, " m"] = field(default_factory=lambda: np.zeros(0, dtype=int))
    tolerance: Float[np.ndarray, " m"] = field(default_factory=lambda: np.zeros(0))
    reach: float = np.nan
    num_states: int = 0

    @property
    def is_against_log(self) -> bool:
        """Whether the reference is the log that was learned from."""
        return bool(self.counts.any())

    @property
    def name(self) -> str:
        """In words."""
        if self.kind == "input":
            return f"{self.about} in stage {self.stage}"
        if self.kind in {"swap", "move"}:
            return f"{self.about} {'swapped' if self.kind == 'swap' else 'within a trajectory'}"
        return "cuts" if self.kind == "cut" else f"{self.kind} of {self.about}"


def input_streams(promised: Any, logs: Logs) -> list[Stream]:
    """Covariates by stage, as `halfseen.policies.folder.promised_parts.promised_states` describes those of the log."""
    streams = []
    for entry in promised:
        rows: Any = logs.stages[logs.stages["stage"] == entry["stage"]]
        at, first = _places(logs, rows), entry["stage"] == 1
        for name, described in entry["covariates"].items():
            if name not in rows.columns:
                continue
            values, bins, num_bins = _binned(described, rows[name], at, logs.num_trajectories)
            counts = _counts(described, entry["num_states"], num_bins) if first else np.zeros(num_bins)
            is_number = described.get("values") is not None
            streams.append(Stream("input", name, entry["stage"], values, bins, counts, is_number))
    return streams


def part_streams(parts: Any, looks_at: Covariates, logs: Logs) -> list[Stream]:
    """Residuals of rewards and durations of each action, their sum over a trajectory; and whether it was cut."""
    rows, streams = known_rows(looks_at, logs), []
    largest = {what: max(part["deviation"] for part in parts if part["what"] == what) for what in WHATS if parts}
    errors = float(ndtri(1.0 - 0.5 * OFF / max(len(parts), 1)))
    for part in parts:
        some = rows[rows["action"].astype(str) == part["action"]]
        left, trajectory = part_residuals(part, looks_at, some), _places(logs, some)
        total = pd.Series(left).groupby(trajectory).sum()
        values, bins, num_bins = _binned(part["residuals"], total, total.index, logs.num_trajectories)
        deviation = max(float(part["deviation"]), LEAST_DEVIATION * largest[part["what"]], 1e-9)
        reach = max(*np.abs(part["residuals"]["values"]), 3.0 * deviation)
        tolerance = errors * _error(part, looks_at, some, deviation)
        rest = (np.zeros(num_bins), True, left, trajectory, tolerance, reach, part["num_states"])
        streams.append(Stream(part["what"], part["action"], None, values, bins, *rest))
    is_cut = (~logs.is_finished).astype(int)
    return [*streams, Stream("cut", "", None, is_cut.astype(float), is_cut, np.zeros(2))]


def whole_stream(streams: list[Stream], parts: Any, num: int) -> Stream:
    """Rewards of all actions that are not always the same, together: each may fall short by too little to notice."""
    largest = max(part["deviation"] for part in parts if part["what"] == "reward")
    some = [
        (stream, part)
        for stream, part in zip(streams, parts, strict=False)
        if part["what"] == "reward" and part["deviation"] >= LEAST_DEVIATION * largest
    ]
    pieces = [(stream.residuals, stream.tolerance, stream.trajectory) for stream, _ in some]
    knots = np.unique(np.concatenate([part["residuals"]["values"] for _, part in some]))
    reach, num_states = max(stream.reach for stream, _ in some), sum(part["num_states"] for _, part in some)
    return _together("reward", "what is done", pieces, knots, num, reach, num_states)


def swap_streams(streams: list[Stream], parts: Any, looks_at: Covariates, logs: Logs, first: Any) -> list[Stream]:
    """Residuals of rewards, of each two covariates, turned to where a swap of the two would drive them.

    Let the model be off by at most its tolerance ε, and say Δ more of a state, had the two changed places. Then the
    residual r has E[sign(Δ) r | state] ≤ ε; if they did change places, it is |Δ|. Only states with |Δ| > 2ε count.

    Parameters
    ----------
    streams
        Of the parts.
    parts
        Models of the log.
    looks_at
        Covariates that they look at.
    logs
        The log of the service.
    first
        Covariates of the first stage of the log that was learned from, as `input_streams` takes them.
    """
    pairs, rows = zip(parts, streams, strict=False), known_rows(looks_at, logs)
    rewards = [(part, of) for part, of in pairs if part["what"] == "reward" and part["deviation"] > 0.0]
    frames = [rows[rows["action"].astype(str) == part["action"]] for part, _ in rewards]
    reach, num_states = max((of.reach for _, of in rewards), default=1.0), sum(of.num_states for _, of in rewards)
    found = []
    for one, other in swappable(first, looks_at):
        pieces = []
        for (part, stream), some in zip(rewards, frames, strict=True):
            turned = part_residuals(part, looks_at, some.assign(**{one: some[other], other: some[one]}))
            more = stream.residuals - turned
            tells = np.abs(more) > 2.0 * stream.tolerance
            values = (np.sign(more) * stream.residuals, stream.tolerance, stream.trajectory)
            pieces.append(tuple(each[tells] for each in values))
        about = f"{one} and {other}"
        found.append(_together("swap", about, pieces, np.zeros(0), logs.num_trajectories, reach, num_states))
    return found


def move_streams(unmoved: Any, logs: Logs) -> list[Stream]:
    """Whether covariates that never changed within a trajectory of the log do, step by step."""
    streams = []
    for name in [name for name in (unmoved or {}).get("names", ()) if name in logs.stages.columns]:
        trajectory, has_moved = moves(logs, name)
        piece = (has_moved.astype(float), np.full(len(trajectory), ZERO_OF / unmoved["num"]), trajectory)
        streams.append(_together("move", name, [piece], np.zeros(0), logs.num_trajectories, 1.0, unmoved["num"]))
    return streams


def swappable(first: Any, looks_at: Covariates) -> list[tuple[str, str]]:
    """Pairs of numbers that differ from state to state, those first whose distributions are most alike."""
    seen = {name: one for each in first if each["stage"] == 1 for name, one in each["covariates"].items()}
    numbers = [name for name in looks_at.columns if len(seen.get(name, {}).get("values") or ()) > 1]

    def apart(pair: tuple[str, str]) -> float:
        one, other = (seen[name] for name in pair)
        at = np.union1d(one["values"], other["values"])
        below = [np.interp(at, each["values"], each["below"], left=0.0) for each in (one, other)]
        return float(np.abs(below[0] - below[1]).max())

    return sorted(combinations(numbers, 2), key=apart)[:MOST_PAIRS]


def _together(
    kind: Kind, about: str, pieces: Any, knots: np.ndarray, num: int, reach: float, num_states: int
) -> Stream:
    """Residuals, tolerances and trajectories of several parts, in the order of trajectories."""
    left, tolerance, trajectory = (np.concatenate(each) for each in zip(*pieces, strict=True)) if pieces else _NOTHING
    # Within a trajectory the order does not matter.
    order = np.argsort(trajectory, kind="stable")
    left, tolerance, trajectory = left[order], tolerance[order], trajectory[order]
    total = pd.Series(left).groupby(trajectory).sum()
    values = _spread(total, total.index, num, np.nan)
    bins = np.where(np.isnan(values), -1, np.searchsorted(knots, values, side="left"))
    own = (values, bins, np.zeros(len(knots) + 1), True)
    return Stream(kind, about, None, *own, left, trajectory, tolerance, reach, num_states)


def own_alone(streams: list[Stream], is_own: Bool[np.ndarray, " n"]) -> list[Stream]:
    """Leave others' trajectories out of what is held against the service so far, which depends on who decides."""
    return [
        one
        if one.is_against_log
        else replace(one, values=np.where(is_own, one.values, np.nan), bins=np.where(is_own, one.bins, -1))
        for one in streams
    ]


def _error(part: Any, looks_at: Covariates, rows: Any, deviation: float) -> Float[np.ndarray, " m"]:
    """Standard error of the log's model in each of these rows."""
    if not len(rows):
        return np.zeros(0)
    features = np.column_stack([np.ones(len(rows)), expanded_as(part, looks_at.encode(rows))])
    covariance = np.asarray(part["covariance"])
    variance = np.einsum("ij,jk,ik->i", features, covariance, features)
    return np.sqrt(np.maximum(variance, 0.0) + (MISFIT * deviation) ** 2)


def known_rows(looks_at: Covariates, logs: Logs) -> Any:
    """Rows of `outcome_rows` but those of a category that the log never showed, of which no model says anything."""
    rows = outcome_rows(logs)
    return rows[looks_at.knows(rows)]


def part_residuals(part: Mapping[str, Any], looks_at: Covariates, rows: Any) -> Float[np.ndarray, " m"]:
    """What the log's model of a part leaves of these rows of `outcome_rows`."""
    if not len(rows):
        return np.zeros(0)
    return residuals(part, looks_at.encode(rows), rows[part["what"]].to_numpy(dtype=np.float64))


def _places(logs: Logs, rows: Any) -> Int[np.ndarray, " m"]:
    return pd.Index(logs.trajectory_ids).get_indexer(rows["trajectory"])


def _spread(values: Any, at: Any, num: int, empty: float | int) -> Float[np.ndarray, " n"]:
    filled = np.full(num, empty, dtype=np.float64)
    filled[at] = values
    return filled


def _binned(described: Mapping[str, Any], values: Any, at: Any, num: int) -> tuple[np.ndarray, np.ndarray, int]:
    """Of each trajectory, the number that its value is compared by, and its bin; and how many bins there are."""
    places = described.get("values") or described["names"]
    if described.get("values") is None:
        bins = pd.Index(places).get_indexer(values.astype(str))
        bins = numbers = np.where(bins < 0, len(places), bins)
    elif is_numeric_dtype(values.dtype):
        numbers = values.to_numpy(dtype=np.float64)
        bins = np.searchsorted(places, numbers, side="left")
    else:
        # Text where numbers were: beyond all of them.
        numbers, bins = np.nan, len(places)
    return _spread(numbers, at, num, np.nan), _spread(bins, at, num, -1).astype(int), len(places) + 1


def _counts(described: Mapping[str, Any], num_states: int, num_bins: int) -> Float[np.ndarray, " K"]:
    shares = described["shares"] if described.get("values") is None else np.diff(described["below"], prepend=0.0)
    return num_states * np.append(shares, 0.0)[:num_bins]
