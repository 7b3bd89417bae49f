"""Diagnosis of an alarm: since when something has changed, and which part broke, in words.

Values are assumed normal, with one mean before the change and another after it. With n values and the sum of squares
S(τ) around the two means, change point τ has the likelihood S(τ)^(−n/2). The interval holds the most likely points
with 95 % of the total likelihood, so it is a credible interval under a flat prior. A reference counts as a number of
values before the first.

Differences in states and outcomes between the training log and the log since the change raise no alarm. They show
where to look first after an alarm.
"""

from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from halfseen.evaluation.kept import drifts_of
from halfseen.learning.covariates import Covariates
from halfseen.logs import Logs
from halfseen.monitoring.outcomes import Outcomes
from halfseen.monitoring.streams import Stream, known_rows, part_residuals
from halfseen.policies.folder.promised_parts import moves
from halfseen.shapes import Float

LEVEL = 0.95


class ChangePoint(NamedTuple):
    """Index of the first value after the change, from 0, and the interval that holds it."""

    at: int
    low: int
    high: int


def change_point(
    values: Float[np.ndarray, " n"], mean: float = 0.0, weight: float | int = 0.0, latest: int | None = None
) -> ChangePoint:
    """Estimate where the mean of values has changed; NaN is ignored.

    Parameters
    ----------
    values
        Values in order.
    mean, weight
        Mean of the reference, and the number of values that it counts as.
    latest
        Index of the alarm, by default of the last value. If a change after it is more likely, values after it are left
        out.
    """
    latest = max(len(values) - 1, 0) if latest is None else latest
    there = np.flatnonzero(~np.isnan(values))
    x = values[there]
    num = len(x)
    if num < 2:
        return ChangePoint(0, 0, latest)
    before = weight + np.arange(num)
    totals = weight * mean + np.append(0.0, np.cumsum(x)[:-1])
    squares = weight * mean**2 + np.append(0.0, np.cumsum(x * x)[:-1])
    after, rest, rest_squares = num - np.arange(num), x.sum() - (totals - weight * mean), (x @ x) + weight * mean**2
    left = squares - totals**2 / np.maximum(before, 1e-12)
    right = rest_squares - squares - rest**2 / after
    scatter = np.maximum(left + right, 1e-12 * max(rest_squares, 1e-300))
    log_likelihood = -0.5 * (num + min(weight, num)) * np.log(scatter)
    if there[log_likelihood.argmax()] > latest:
        return change_point(values[: latest + 1], mean, weight)
    log_likelihood = log_likelihood[there <= latest]
    chance = np.exp(log_likelihood - log_likelihood.max())
    order = np.argsort(-chance, kind="stable")
    enough = int(np.searchsorted(np.cumsum(chance[order]) / chance.sum(), LEVEL)) + 1
    held, first = there[order[:enough]], int(order[:enough].min())
    # It may have changed in a gap before the first value that shows it.
    low = int(there[first - 1]) + 1 if first else 0
    return ChangePoint(int(there[order[0]]), low, int(held.max()))


def moved_at(stream: Stream, alarm: int) -> ChangePoint:
    """Trajectory, up to that of the alarm, at which the bins of a stream have moved."""
    values = np.where(stream.bins >= 0, stream.bins, np.nan).astype(np.float64)
    num = float(stream.counts.sum())
    mean = float(stream.counts @ np.arange(len(stream.counts)) / num) if num else 0.0
    return change_point(values, mean, num, alarm)


def differs_at(part: Stream, alarm: int) -> ChangePoint:
    """Trajectory, up to that of the alarm, from which residuals differ from those of the training log."""
    latest = int(np.searchsorted(part.trajectory, alarm, side="right")) - 1
    found = change_point(np.clip(part.residuals, -part.reach, part.reach), 0.0, part.num_states, latest)
    at, low, high = (int(part.trajectory[k]) for k in found)
    return ChangePoint(at, min(int(part.trajectory[found.low - 1]) + 1, low) if found.low else 0, high)


def earns_less_at(outcomes: Outcomes, value: Any, alarm: int) -> ChangePoint:
    """Trajectory, up to that of the alarm, from which less is earned than promised."""
    spread = float(np.nanstd(outcomes.values))
    error = max(float(value["standard_error"]), 1e-12)
    return change_point(outcomes.values, float(value["value"]), (spread / error) ** 2, alarm)


CLEARLY = 4.0
"""Number of standard errors above which a part is named."""
SWAPPED, OTHER_UNIT = "look swapped", "as if in another"
"""Words in causes for columns whose meaning has changed."""
CHANGED_TOGETHER = "covariates of stage 1 have changed together"


def differs(part: Stream, at: int) -> str:
    """Describe how an action differs from the training log since a trajectory."""
    if part.kind == "swap":
        return f"covariates {part.about} {SWAPPED}"
    if part.kind == "move":
        return f"{part.about} changes within a trajectory, as it never did in the log"
    return part_words(part.kind, part.about, float(part.residuals[part.trajectory >= at].mean()))


def part_words(what: str, action: str, mean: float, than: str = "than in the log in the same states") -> str:
    """Describe a mean change of an action's reward, or of the logarithm of its duration."""
    amount = f"{abs(mean):.2g}" if what == "reward" else _longer(mean)
    verb, time = ("brings", "") if what == "reward" else ("takes", " time")
    unit = "" if what == "reward" else clock_unit(mean)
    return f"{action} {verb} {amount} {'less' if mean < 0 else 'more'}{time} {than}{unit}"


def _longer(mean: float) -> str:
    """How much longer or shorter, from a mean change of log durations."""
    if mean > np.log(MOST_TIMES):
        return f"over {MOST_TIMES:,} times"
    factor = float(np.exp(mean))
    return f"{abs(factor - 1.0):.0%}" if factor < 10.0 else f"{factor:,.0f} times"


MOST_TIMES = 1_000_000
CLOCKS = {
    60.0: "seconds for minutes",
    1e3: "milliseconds for seconds",
    3600.0: "seconds for hours",
    1e6: "microseconds for seconds",
    1e9: "nanoseconds for seconds",
}
"""Factors between units of time, and the mistake that multiplies durations by each; the inverse mistake divides."""
ABOUT = 0.2
"""Largest difference between a mean change of log durations and the logarithm of a factor."""


def clock_unit(mean: float) -> str:
    """Name the wrong unit that explains a mean change of log durations; "" if none does."""
    factor = min(CLOCKS, key=lambda one: abs(abs(mean) - np.log(one)))
    if abs(abs(mean) - np.log(factor)) > ABOUT:
        return ""
    is_longer = mean > 0
    mend = f"{'divide' if is_longer else 'multiply'} the clock by {factor:,g}"
    return f", {OTHER_UNIT} unit ({CLOCKS[factor]}{'' if is_longer else ' the other way round'}): {mend}"


def moved(stream: Stream, at: int) -> str:
    """Describe how a stream has changed since a trajectory."""
    there, at = stream.bins >= 0, max(at, 1)
    after = there & (np.arange(len(there)) >= at)
    now = float(stream.bins[after].mean()) if after.any() else np.nan
    before = there & ~after
    was = float(stream.bins[before].mean()) if before.any() else np.nan
    if stream.is_against_log:
        was = float(stream.counts @ np.arange(len(stream.counts)) / stream.counts.sum())
    than = "than in the log" if stream.is_against_log else "than before"
    if not stream.is_number:
        return f"{stream.name} is distributed differently {than}"
    if stream.kind == "cut":
        return f"{'more' if now > was else 'fewer'} trajectories are cut {than}"
    if stream.kind == "input":
        return f"{stream.name} is {'larger' if now > was else 'smaller'} {than}"
    word = {"reward": ("more", "less"), "duration": ("longer", "shorter")}[stream.kind][0 if now > was else 1]
    return f"{stream.about} {'brings' if stream.kind == 'reward' else 'takes'} {word} {than} in the same states"


BEYOND = 10.0
"""Multiple of the largest possible total above which rewards must be in another unit."""


def rewards_in_another_unit(brings: Any, logs: Logs) -> tuple[str, ...]:
    """Report rewards far larger than the training log allows.

    Parameters
    ----------
    brings
        Smallest and largest possible total of a trajectory, by the training log; None if unknown.
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
    return (f"rewards are {OTHER_UNIT} unit: a trajectory brings about {usual:.3g}, but at most {most:.3g} in the log",)


def input_words(promise: Any, logs: Logs, since: int) -> tuple[str, ...]:
    """Name covariates of the first stage that seem to be in another unit, swapped, or distributed differently.

    Parameters
    ----------
    promise
        Promise in the policy's folder.
    logs
        The log of its service.
    since
        First trajectory to use, counted from 1.
    """
    units, drifts = drifts_of(_first_states(promise), logs.select(logs.trajectory_ids[since - 1 :]))
    return (*units, *drifts)


def swapped_or_changed(pair: str, promise: Any, logs: Logs, at: int) -> str:
    """Say that two covariates look swapped, if the first states fit the training log once they are swapped back.

    Parameters
    ----------
    pair
        The two names, as in `Stream.about`.
    promise
        Promise in the policy's folder.
    logs
        The log of its service.
    at
        Index of the first trajectory to use.
    """
    first = _first_states(promise)
    names = {name for each in first for name in each["covariates"]}
    one, other = next((x, y) for x in names for y in names if f"{x} and {y}" == pair)
    is_alike = _fits_turned(first, logs.select(logs.trajectory_ids[at:]), one, other)
    return f"covariates {pair} {SWAPPED}" if is_alike else CHANGED_TOGETHER


def _fits_turned(first: list[dict[str, Any]], logs: Logs, one: str, other: str) -> bool:
    """Whether no drift of the first states is found once two columns are swapped."""
    turned = {one: logs.stages[other], other: logs.stages[one]}
    return not any(drifts_of(first, Logs(logs.stages.assign(**turned), logs.trajectories)))


def is_misrecorded(causes: tuple[str, ...]) -> bool:
    """Whether the causes point to the recording of columns rather than to the cell."""
    return any(words in cause for cause in causes for words in (SWAPPED, OTHER_UNIT))


def broken_parts(promise: Any, looks_at: Covariates, logs: Logs, since: int) -> tuple[str, ...]:
    """Name actions whose reward or duration differs from the training log in the same states, the clearest first.

    Parameters
    ----------
    promise
        Promise in the policy's folder.
    looks_at
        Covariates of its models.
    logs
        The log of its service.
    since
        First trajectory to use, counted from 1.
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
    """Name two columns that seem swapped: one now changes within trajectories but never did, the other stopped."""
    unmoved = (promise.get("unmoved") or {}).get("names", ())
    has_moved = {name: moves(logs, name)[1].any() for name in looks_at.columns if name in logs.stages.columns}
    one = [name for name in unmoved if has_moved.get(name)]
    other = [name for name, moved in has_moved.items() if name not in unmoved and not moved]
    # Text and a number would have been refused.
    if len(one) != 1 or len(other) != 1 or len(looks_at.categories.keys() & {*one, *other}) == 1:
        return ()
    return (f"covariates {one[0]} and {other[0]} {SWAPPED}: within a trajectory the first changes now, not the second",)


def _swapped(promise: Any, looks_at: Covariates, logs: Logs) -> tuple[str, ...]:
    """Name two numeric columns for which models and first states fit clearly better after a swap."""
    first = _first_states(promise)
    # A covariate that is constant in the first stage carries no information.
    differ = {name for each in first for name, one in each["covariates"].items() if len(one.get("values", ())) > 1}
    numbers = [name for name in looks_at.columns if name in differ]
    parts = [part for part in promise.get("parts", ()) if part["what"] == "reward" and part["deviation"] > 0.0]
    rows = known_rows(looks_at, logs)

    def misfit(frame: Any) -> tuple[float, float]:
        """Sum of squared residuals, and the absolute value of their mean in standard errors."""
        each = [part_residuals(part, looks_at, frame[frame["action"].astype(str) == part["action"]]) for part in parts]
        left = np.concatenate([one / part["deviation"] for one, part in zip(each, parts, strict=True)] or [np.zeros(0)])
        return float(left @ left), float(abs(left.sum()) / np.sqrt(max(len(left), 1)))

    usual, found = misfit(rows)[0], []
    for one, other in combinations(numbers, 2):
        squares, off = misfit(rows.assign(**{one: rows[other], other: rows[one]}))
        if usual - squares > CLEARLY**2 and off < CLEARLY:
            found += [(squares, one, other)] if _fits_turned(first, logs, one, other) else []
    return tuple(
        f"covariates {one} and {other} {SWAPPED}: the log's models fit better the other way round"
        for _, one, other in sorted(found)[:1]
    )


def _first_states(promise: Any) -> list[dict[str, Any]]:
    """Description of the first stage, without nulls."""
    return [
        each | {"covariates": {name: {k: v for k, v in one.items() if v} for name, one in each["covariates"].items()}}
        for each in promise["stages"]
        if each["stage"] == 1
    ]
