"""Streams that are watched besides the total: covariates by stage, rewards and durations of actions, and cuts.

A covariate of the first stage is compared with the training log, since no action precedes it. Later covariates depend
on the policy, so they are compared with its own service so far. Rewards and durations, given the state, are compared
with both.
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
from halfseen.policies.folder.promised_parts import WHATS, comparable, expanded_as, moves, outcome_rows, residuals
from halfseen.shapes import Bool, Float, Int

Kind = Literal["input", "reward", "duration", "cut", "swap", "move"]

OFF, MISFIT = 0.01, 0.1
"""Tolerance of a mean residual: the standard errors that any of the log's models exceeds with probability `OFF`, and
`MISFIT` times the residuals' deviation for nonlinearity."""
LEAST_DEVIATION = 0.1
"""Smallest deviation, as a share of the largest among the actions: a reward that was constant may now vary a little."""
LEAST = {"reward": 1e-9, "duration": 0.01}
"""Smallest deviation of rewards, and of log durations, in which a clock's jitter is no change."""
ZERO_OF = 3.0
"""An event that never happened in n steps has a probability of at most 3 / n, at 95 %."""
MOST_PAIRS = 15
"""Most pairs of covariates tested for a swap; in other pairs each covariate shows a swap by itself."""
MOST_PAIRS_OF_STATES, FEWEST_STATES, NUM_KNOTS = 36, 20, 65
"""The same for the states of stage 1; and their fewest reference states, and quantiles of these."""
_NOTHING = (np.zeros(0), np.zeros(0), np.zeros(0, dtype=int))


@dataclass(frozen=True)
class Stream:
    """Values, one per trajectory, in bins that were fixed in advance.

    Parameters
    ----------
    kind
        Kind of the stream.
    about
        The covariate, the action, or the two covariates that may be swapped; "" for cuts.
    stage
        Stage of a covariate.
    values
        NaN for a trajectory without a value; the bin number for text.
    bins
        Bin of each value; −1 without a value.
    counts
        Number of reference values in each bin; all 0 without a reference.
    is_number
        Whether the order of the bins is meaningful.
    residuals, trajectory
        Residuals from the log's model, and the index of the trajectory of each. For a covariate that never changed
        within a trajectory, 1 for each step in which it did.
    tolerance
        Tolerance of the model for each residual, in either direction.
    reach
        Absolute value at which residuals are clipped.
    num_states
        Number of states of the log that the model was fitted to.
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
        """Whether the reference is the training log."""
        return bool(self.counts.any())

    @property
    def name(self) -> str:
        """Name of the stream, in words."""
        if self.kind == "input":
            return f"{self.about} in stage {self.stage}"
        if self.kind in {"swap", "move"}:
            return f"{self.about} {'swapped' if self.kind == 'swap' else 'within a trajectory'}"
        return "cuts" if self.kind == "cut" else f"{self.kind} of {self.about}"


def input_streams(promised: Any, logs: Logs) -> list[Stream]:
    """Streams of covariates by stage, as described by `halfseen.policies.folder.promised_parts.promised_states`."""
    streams = []
    for entry in promised:
        rows: Any = logs.stages[logs.stages["stage"] == entry["stage"]]
        at, first = _places(logs, rows), entry["stage"] == 1
        for name, described in entry["covariates"].items():
            if name not in rows.columns:
                continue
            values, bins, num_bins = _binned(described, rows[name], at, logs.num_trajectories)
            counts = _counts(described, entry["num_states"]) if first else np.zeros(num_bins)
            is_number = described.get("values") is not None
            streams.append(Stream("input", name, entry["stage"], values, bins, counts, is_number))
    return streams


def part_streams(parts: Any, looks_at: Covariates, logs: Logs) -> list[Stream]:
    """Streams of reward and duration residuals of each action, summed over a trajectory; and of cuts."""
    rows, streams = known_rows(looks_at, logs), []
    largest = {what: max(part["deviation"] for part in parts if part["what"] == what) for what in WHATS if parts}
    errors = float(ndtri(1.0 - 0.5 * OFF / max(len(parts), 1)))
    for part in parts:
        some = rows[rows["action"].astype(str) == part["action"]]
        left, trajectory = part_residuals(part, looks_at, some), _places(logs, some)
        knots = part["residuals"]["values"]
        values, bins = _totals(left, trajectory, knots, logs.num_trajectories)
        deviation = max(float(part["deviation"]), LEAST_DEVIATION * largest[part["what"]], LEAST[part["what"]])
        reach = max(*np.abs(knots), 3.0 * deviation)
        tolerance = errors * _error(part, looks_at, some, deviation)
        rest = (np.zeros(len(knots) + 1), True, left, trajectory, tolerance, reach, part["num_states"])
        streams.append(Stream(part["what"], part["action"], None, values, bins, *rest))
    is_cut = (~logs.is_finished).astype(int)
    return [*streams, Stream("cut", "", None, is_cut.astype(float), is_cut, np.zeros(2))]


def whole_stream(streams: list[Stream], parts: Any, num: int) -> Stream:
    """Pooled reward stream of all actions with varying rewards; each shortfall alone may be too small to detect."""
    largest = max(part["deviation"] for part in parts if part["what"] == "reward")
    some = [
        (stream, part)
        for stream, part in zip(streams, parts, strict=False)
        if part["what"] == "reward" and part["deviation"] >= LEAST_DEVIATION * largest
    ]
    pieces = [(stream.residuals, stream.tolerance, stream.trajectory) for stream, _ in some]
    knots = np.unique(np.concatenate([part["residuals"]["values"] for _, part in some]))
    reach, num_states = max(stream.reach for stream, _ in some), sum(part["num_states"] for _, part in some)
    return _together("reward", "an action", pieces, knots, num, reach, num_states)


def swap_streams(streams: list[Stream], parts: Any, looks_at: Covariates, logs: Logs, first: Any) -> list[Stream]:
    """Streams of reward residuals for each pair of covariates, signed in the direction of a swap.

    Let the model err by at most its tolerance ε, and let swapping the two covariates raise its prediction by Δ. Then
    the residual r has E[sign(Δ) r | state] ≤ ε without a swap, and |Δ| with one. Only states with |Δ| > 2ε count.

    Parameters
    ----------
    streams
        Streams of the parts.
    parts
        Models of the log.
    looks_at
        Covariates of the models.
    logs
        The log of the service.
    first
        Covariates of the first stage of the training log, as in `input_streams`.
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


def swapped_states(promise: Any, looks_at: Covariates, logs: Logs) -> list[Stream]:
    """Streams of the states of stage 1 for each pair of covariates; a low value says that the two are swapped.

    A value is the log-likelihood ratio of a state as it is to the state with the two swapped. The likelihood is that of
    a normal distribution fitted to every other state of the training log. Ranks among the remaining states are valid
    whatever the distribution is. Correlations with others tell covariates apart that are distributed alike.

    Parameters
    ----------
    promise
        Promise in the policy's folder, with states of the first stage.
    looks_at
        Their covariates.
    logs
        The log of the service.
    """
    fitted, reference = (np.array(promise["first_states"][parity::2]) for parity in (0, 1))
    rows: Any = logs.stages[logs.stages["stage"] == 1]
    rows = rows[looks_at.knows(rows)]
    if len(reference) < FEWEST_STATES or not len(rows):
        return []
    place = {name: k for k, name in enumerate(looks_at.sources)}
    new, at, mean, precision = looks_at.encode(rows), _places(logs, rows), fitted.mean(axis=0), _precision(fitted)

    def ratio(each: Float[np.ndarray, "m F"], pair: list[int]) -> Float[np.ndarray, " m"]:
        turned = each.copy()
        turned[:, pair] = each[:, pair[::-1]]
        usual, swapped = (((one - mean) @ precision * (one - mean)).sum(axis=1) for one in (each, turned))
        return 0.5 * (swapped - usual)

    found = []
    for one, other in swappable(promise["stages"], looks_at, MOST_PAIRS_OF_STATES):
        pair = [place[one], place[other]]
        usual = ratio(reference, pair)
        knots = np.unique(np.quantile(usual, np.linspace(0.0, 1.0, NUM_KNOTS)))
        values = _spread(ratio(new, pair), at, logs.num_trajectories, np.nan)
        bins = np.where(np.isnan(values), -1, np.searchsorted(knots, values))
        counts = np.bincount(np.searchsorted(knots, usual), minlength=len(knots) + 1).astype(np.float64)
        found.append(Stream("swap", f"{one} and {other}", 1, values, bins, counts))
    return found


def _precision(states: Float[np.ndarray, "n F"]) -> Float[np.ndarray, "F F"]:
    """Inverse covariance, with correlations shrunk; 0 along features that do not vary."""
    deviation, share = states.std(axis=0), states.shape[1] / (2 * len(states) + states.shape[1])
    scale = np.where(deviation > 0.0, deviation, np.inf)
    scaled = (states - states.mean(axis=0)) / scale
    shrunk = (1.0 - share) * (scaled.T @ scaled) / len(states) + share * np.eye(len(scale))
    return np.linalg.inv(shrunk) / np.outer(scale, scale)


def move_streams(unmoved: Any, logs: Logs) -> list[Stream]:
    """Streams of the steps that change a covariate which never changed within a trajectory of the training log."""
    streams = []
    for name in [name for name in (unmoved or {}).get("names", ()) if name in logs.stages.columns]:
        trajectory, has_moved = moves(logs, name)
        piece = (has_moved.astype(float), np.full(len(trajectory), ZERO_OF / unmoved["num"]), trajectory)
        streams.append(_together("move", name, [piece], np.zeros(0), logs.num_trajectories, 1.0, unmoved["num"]))
    return streams


def swappable(first: Any, looks_at: Covariates, most: int = MOST_PAIRS) -> list[tuple[str, str]]:
    """Pairs of varying numeric covariates, the most similar distributions first."""
    seen = {name: one for each in first if each["stage"] == 1 for name, one in each["covariates"].items()}
    numbers = [name for name in looks_at.columns if len(seen.get(name, {}).get("values") or ()) > 1]

    def apart(pair: tuple[str, str]) -> float:
        one, other = (seen[name] for name in pair)
        at = np.union1d(one["values"], other["values"])
        below = [np.interp(at, each["values"], each["below"], left=0.0) for each in (one, other)]
        return float(np.abs(below[0] - below[1]).max())

    return sorted(combinations(numbers, 2), key=apart)[:most]


def _together(
    kind: Kind, about: str, pieces: Any, knots: np.ndarray, num: int, reach: float, num_states: int
) -> Stream:
    """Stream of the residuals of several parts, in the order of trajectories."""
    left, tolerance, trajectory = (np.concatenate(each) for each in zip(*pieces, strict=True)) if pieces else _NOTHING
    # Within a trajectory the order does not matter.
    order = np.argsort(trajectory, kind="stable")
    left, tolerance, trajectory = left[order], tolerance[order], trajectory[order]
    own = (*_totals(left, trajectory, knots, num), np.zeros(len(knots) + 1), True)
    return Stream(kind, about, None, *own, left, trajectory, tolerance, reach, num_states)


def _totals(
    left: Float[np.ndarray, " m"], trajectory: Int[np.ndarray, " m"], knots: Any, num: int
) -> tuple[Float[np.ndarray, " n"], Int[np.ndarray, " n"]]:
    """Sum of residuals of each trajectory, NaN if it has none, and its bin."""
    total = pd.Series(left).groupby(trajectory).sum()
    values = _spread(total, total.index, num, np.nan)
    return values, np.where(np.isnan(values), -1, np.searchsorted(knots, values, side="left"))


def own_alone(streams: list[Stream], is_own: Bool[np.ndarray, " n"]) -> list[Stream]:
    """Drop trajectories of others from streams that are compared with the policy's own service so far."""
    return [
        one
        if one.is_against_log
        else replace(one, values=np.where(is_own, one.values, np.nan), bins=np.where(is_own, one.bins, -1))
        for one in streams
    ]


def _error(part: Any, looks_at: Covariates, rows: Any, deviation: float) -> Float[np.ndarray, " m"]:
    """Standard error of the log's model in each row, including its misfit."""
    if not len(rows):
        return np.zeros(0)
    features = np.column_stack([np.ones(len(rows)), expanded_as(part, looks_at.encode(rows))])
    covariance = np.asarray(part["covariance"])
    variance = np.einsum("ij,jk,ik->i", features, covariance, features)
    return np.sqrt(np.maximum(variance, 0.0) + (MISFIT * deviation) ** 2)


def known_rows(looks_at: Covariates, logs: Logs) -> Any:
    """Rows of `outcome_rows` without categories that the training log never showed, which no model covers."""
    rows = outcome_rows(logs)
    return rows[looks_at.knows(rows)]


def part_residuals(part: Mapping[str, Any], looks_at: Covariates, rows: Any) -> Float[np.ndarray, " m"]:
    """Residuals of the log's model of a part in these rows of `outcome_rows`."""
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
    """Numeric value and bin of each trajectory, and the number of bins."""
    # A bin for numbers below the lowest place, if there are any; one for each place; and one for all others.
    places = described.get("values") or described["names"]
    num_bins = len(places) + (2 if described.get("values") else 1)
    if described.get("values") is None:
        bins = pd.Index(places).get_indexer(values.astype(str))
        bins = numbers = np.where(bins < 0, len(places), bins)
    elif is_numeric_dtype(values.dtype):
        knots, numbers = comparable(places, values)
        bins = np.searchsorted(knots, numbers, side="left") + (numbers >= knots[0])
    else:
        # Text instead of numbers goes into the last bin.
        numbers, bins = np.nan, num_bins - 1
    return _spread(numbers, at, num, np.nan), _spread(bins, at, num, -1).astype(int), num_bins


def _counts(described: Mapping[str, Any], num_states: int) -> Float[np.ndarray, " K"]:
    if described.get("values") is None:
        return num_states * np.append(described["shares"], 0.0)
    return num_states * np.diff(described["below"], prepend=[0.0, 0.0], append=described["below"][-1])
