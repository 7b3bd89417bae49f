"""Since when something has changed, and which part broke, in words.

Values are taken for normal, with one mean before and another after the change. With S(τ) the sum of squares around the
two means and n values, each place τ has the likelihood S(τ)^(−n/2); the interval holds the likeliest places that have
95 % of all likelihood together, so it is a credible one under a prior that knows nothing. A reference stands for that
many values before the first.

States and outcomes since the change, beside the log that was learned from, are no alarms: they say where to look first
once there is one.
"""

from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from halfseen.evaluation.kept import drifts_of
from halfseen.learning.covariates import Covariates
from halfseen.logs import Logs
from halfseen.monitoring.streams import Stream, known_rows, part_residuals
from halfseen.policies.folder.promised_parts import moves
from halfseen.shapes import Float

LEVEL = 0.95


class ChangePoint(NamedTuple):
    """Where values have changed, counted from 0: the first one of the new kind, and between which it lies."""

    at: int
    low: int
    high: int


def change_point(values: Float[np.ndarray, " n"], mean: float = 0.0, weight: float | int = 0.0) -> ChangePoint:
    """Find where the mean of values has changed; NaN are no values.

    Parameters
    ----------
    values
        In their order.
    mean, weight
        Of a reference: its mean, and how many values it stands for.
    """
    there = np.flatnonzero(~np.isnan(values))
    x = values[there]
    num = len(x)
    if num < 2:
        return ChangePoint(0, 0, max(len(values) - 1, 0))
    before = weight + np.arange(num)
    totals = weight * mean + np.append(0.0, np.cumsum(x)[:-1])
    squares = weight * mean**2 + np.append(0.0, np.cumsum(x * x)[:-1])
    after, rest, rest_squares = num - np.arange(num), x.sum() - (totals - weight * mean), (x @ x) + weight * mean**2
    left = squares - totals**2 / np.maximum(before, 1e-12)
    right = rest_squares - squares - rest**2 / after
    scatter = np.maximum(left + right, 1e-12 * max(rest_squares, 1e-300))
    log_likelihood = -0.5 * (num + min(weight, num)) * np.log(scatter)
    chance = np.exp(log_likelihood - log_likelihood.max())
    order = np.argsort(-chance, kind="stable")
    enough = int(np.searchsorted(np.cumsum(chance[order]) / chance.sum(), LEVEL)) + 1
    held = there[order[:enough]]
    return ChangePoint(int(there[order[0]]), int(held.min()), int(held.max()))


CLEARLY = 4.0
"""Standard errors from which on a part is named."""
SWAPPED, OTHER_UNIT = "look swapped", "as if in another"
"""What causes say of columns that hold something else than they held."""


def differs(part: Stream, at: int) -> str:
    """Say by how much an action differs from what the log says, from one trajectory on."""
    if part.kind == "swap":
        return f"covariates {part.about} {SWAPPED}"
    if part.kind == "move":
        return f"{part.about} changes within a trajectory, as it never did in the log"
    return part_words(part.kind, part.about, float(part.residuals[part.trajectory >= at].mean()))


def part_words(what: str, action: str, mean: float, than: str = "than the log says of the same states") -> str:
    """Say by how much an action brings or takes more or less: a mean reward, or a mean of logarithms of durations."""
    amount = f"{abs(mean):.2g}" if what == "reward" else f"{abs(np.expm1(mean)):.0%}"
    verb, time = ("brings", "") if what == "reward" else ("takes", " time")
    unit = "" if what == "reward" else clock_unit(mean)
    return f"{action} {verb} {amount} {'less' if mean < 0 else 'more'}{time} {than}{unit}"


CLOCKS = {
    60.0: "seconds for minutes",
    1e3: "milliseconds for seconds",
    3600.0: "seconds for hours",
    1e6: "microseconds for seconds",
    1e9: "nanoseconds for seconds",
}
"""What durations may have been multiplied by, and as if they were what; or divided by, the other way round."""
ABOUT = 0.2
"""Logarithm of a factor by which a mean may differ from that of a unit."""


def clock_unit(mean: float) -> str:
    """Say in which other unit a clock seems to be, by the mean change of the logarithms of durations; "" if in none."""
    factor = min(CLOCKS, key=lambda one: abs(abs(mean) - np.log(one)))
    if abs(abs(mean) - np.log(factor)) > ABOUT:
        return ""
    is_longer = mean > 0
    mend = f"{'divide' if is_longer else 'multiply'} the clock by {factor:,g}"
    return f", {OTHER_UNIT} unit ({CLOCKS[factor]}{'' if is_longer else ' the other way round'}): {mend}"


def moved(stream: Stream, at: int) -> str:
    """Say how a stream has changed from one trajectory on."""
    there, at = stream.bins >= 0, max(at, 1)
    after = there & (np.arange(len(there)) >= at)
    now = float(stream.bins[after].mean()) if after.any() else np.nan
    before = there & ~after
    was = float(stream.bins[before].mean()) if before.any() else np.nan
    if stream.is_against_log:
        was = float(stream.counts @ np.arange(len(stream.counts)) / stream.counts.sum())
    than = "than in the log" if stream.is_against_log else "than before"
    if not stream.is_number:
        return f"{stream.name} is distributed otherwise {than}"
    if stream.kind == "cut":
        return f"{'more' if now > was else 'fewer'} trajectories are cut {than}"
    if stream.kind == "input":
        return f"{stream.name} is {'larger' if now > was else 'smaller'} {than}"
    word = {"reward": ("more", "less"), "duration": ("longer", "shorter")}[stream.kind][0 if now > was else 1]
    return f"{stream.about} {'brings' if stream.kind == 'reward' else 'takes'} {word} {than} in the same states"


BEYOND = 10.0
"""Times the most that a trajectory could bring, from which on rewards are in another unit."""


def rewards_in_another_unit(brings: Any, logs: Logs) -> tuple[str, ...]:
    """Report rewards far larger than any that the log could bring.

    Parameters
    ----------
    brings
        The least and the most that a trajectory could bring by the log that was learned from; None if unknown.
    logs
        The log of the service.
    """
    if brings is None or not logs.is_finished.any():
        return ()
    finished = logs.trajectory_ids[logs.is_finished]
    totals: Any = logs.stages.groupby("trajectory", sort=False)["reward"].sum().loc[finished].abs()
    usual, most = float(totals.median()), float(np.abs(brings).max())
    if most == 0.0 or usual <= BEYOND * most:
        return ()
    return (f"rewards are {OTHER_UNIT} unit: a trajectory brings about {usual:.3g}, and {most:.3g} was the most",)


def input_words(promise: Any, logs: Logs, since: int) -> tuple[str, ...]:
    """Say which covariates of the first stage look as if in another unit, swapped, or distributed otherwise.

    Parameters
    ----------
    promise
        Of the policy's folder.
    logs
        The log of its service.
    since
        Trajectory from which on it is looked at, counted from 1.
    """
    first = [each for each in promise["stages"] if each["stage"] == 1]
    units, drifts = drifts_of(_without_nulls(first), logs.select(logs.trajectory_ids[since - 1 :]))
    return (*units, *drifts)


def is_misrecorded(causes: tuple[str, ...]) -> bool:
    """Whether columns, rather than the cell, have changed."""
    return any(words in cause for cause in causes for words in (SWAPPED, OTHER_UNIT))


def broken_parts(promise: Any, looks_at: Covariates, logs: Logs, since: int) -> tuple[str, ...]:
    """Say which actions pay or take something else than the log says of the same states, the clearest first.

    Parameters
    ----------
    promise
        Of the policy's folder.
    looks_at
        The covariates that its models look at.
    logs
        The log of its service.
    since
        Trajectory from which on it is looked at, counted from 1.
    """
    later = logs.select(logs.trajectory_ids[since - 1 :])
    rows, found = known_rows(looks_at, later), []
    for part in promise.get("parts", ()):
        left = part_residuals(part, looks_at, rows[rows["action"].astype(str) == part["action"]])
        if len(left) < 2:
            continue
        spread = max(float(part["deviation"]), float(left.std()), 1e-9)
        z = float(left.mean()) / (spread * np.sqrt(1.0 / len(left) + 1.0 / part["num_states"]))
        if abs(z) > CLEARLY:
            found.append(
                (abs(z), f"{part_words(part['what'], part['action'], float(left.mean()))} ({len(left)} stages)")
            )
    swapped = _swapped_moves(promise, looks_at, later) or _swapped(promise, looks_at, later)
    return (*swapped, *(words for _, words in sorted(found, reverse=True)))


def _swapped_moves(promise: Any, looks_at: Covariates, logs: Logs) -> tuple[str, ...]:
    """Name two columns of which the one that never changed within a trajectory does, and the other no longer."""
    unmoved = (promise.get("unmoved") or {}).get("names", ())
    has_moved = {name: moves(logs, name)[1].any() for name in looks_at.columns if name in logs.stages.columns}
    one = [name for name in unmoved if has_moved.get(name)]
    other = [name for name, moved in has_moved.items() if name not in unmoved and not moved]
    if len(one) != 1 or len(other) != 1:
        return ()
    return (
        f"covariates {one[0]} and {other[0]} {SWAPPED}: within a trajectory the former changes now, not the latter",
    )


def _swapped(promise: Any, looks_at: Covariates, logs: Logs) -> tuple[str, ...]:
    """Name two columns of numbers that the log's models fit clearly better the other way round, and so do states."""
    first = _without_nulls([each for each in promise["stages"] if each["stage"] == 1])
    # What is always the same in the first stage cannot tell.
    differ = {name for each in first for name, one in each["covariates"].items() if len(one.get("values", ())) > 1}
    numbers = [name for name in looks_at.columns if name in differ]
    parts = [part for part in promise.get("parts", ()) if part["what"] == "reward" and part["deviation"] > 0.0]
    rows = known_rows(looks_at, logs)

    def misfit(frame: Any) -> tuple[float, float]:
        """Sum of squares of residuals, and their mean in standard errors."""
        each = [part_residuals(part, looks_at, frame[frame["action"].astype(str) == part["action"]]) for part in parts]
        left = np.concatenate([one / part["deviation"] for one, part in zip(each, parts, strict=True)] or [np.zeros(0)])
        return float(left @ left), float(abs(left.sum()) / np.sqrt(max(len(left), 1)))

    usual, found = misfit(rows)[0], []
    for one, other in combinations(numbers, 2):
        turned = {one: logs.stages[other], other: logs.stages[one]}
        squares, off = misfit(rows.assign(**{one: rows[other], other: rows[one]}))
        if usual - squares > CLEARLY**2 and off < CLEARLY:
            drifts = drifts_of(first, Logs(logs.stages.assign(**turned), logs.trajectories))
            found += [] if any(drifts) else [(squares, one, other)]
    return tuple(
        f"covariates {one} and {other} {SWAPPED}: the log's models fit better the other way round"
        for _, one, other in sorted(found)[:1]
    )


def _without_nulls(stages: Any) -> list[dict[str, Any]]:
    return [
        each | {"covariates": {name: {k: v for k, v in one.items() if v} for name, one in each["covariates"].items()}}
        for each in stages
    ]
