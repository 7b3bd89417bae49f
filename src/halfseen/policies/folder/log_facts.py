"""Facts for policy.json about the log of a policy, gathered in one pass over its parts."""

import hashlib
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from itertools import zip_longest
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pyarrow as pa

from halfseen.lazy import Frame
from halfseen.logs import Logs, LogsSummary
from halfseen.logs.joining import RUN, RUN_TRAJECTORY
from halfseen.logs.logs import SummaryTally
from halfseen.policies.folder.kinds import PolicyKind
from halfseen.policies.folder.stored import TABLE_RANGES
from halfseen.policies.ranges import margin, most_with_margin
from halfseen.shapes import Float, Int


def log_facts(
    parts: Iterable[Logs], kind: PolicyKind, policy: Any, is_by_stage: bool
) -> tuple[LogsSummary, str, dict[str, Any], dict[str, Any]]:
    """Gather the facts that are kept of a log.

    Parameters
    ----------
    parts
        The log, whole or in parts of whole trajectories, in order.
    kind
        Kind of the policy.
    policy
        The learned policy.
    is_by_stage
        Whether each stage has a Q of its own.

    Returns
    -------
    summary : LogsSummary
        Counts of the log.
    sha256 : str
        Digest of the log.
    prior : dict
        For kinds of policies with a prior: the prior of DIRTY, whether looks were counted, the least reward of each
        verb.
    facts : dict
        ``seen``, the ranges of the states; ``stages_left``, the mean number of stages from each to the end of a
        trajectory; ``reward_spread``, the standard deviation of the rewards of completed stages; ``actions_taken``, the
        counts of actions by stage, empty for tables, whose actions refer to objects.
    """
    digest, summary, priors = LogDigest(), SummaryTally(), []
    taken: list[Counter[str]] = []
    num_ranges = len(policy.covariates) if kind.is_flat else 0
    seen, counts, spread = [], [], _Spread(0, 0.0, 0.0)
    for part in parts:
        digest.add(part)
        summary.add(part)
        if kind.has_prior:
            priors.append(_prior(part))
        here = _seen_named(part, policy, is_by_stage) if kind.is_flat else _seen_tables(part)
        pairs = zip_longest(seen, here)
        seen = [_joined(one, other, num_ranges) if one and other else one or other for one, other in pairs]
        counts = [one + other for one, other in zip_longest(counts, stage_counts(part), fillvalue=0)]
        taken = [one + other for one, other in zip_longest(taken, actions_taken(part), fillvalue=Counter())]
        spread = spread.plus(_spread_of(part))
    if kind.is_flat:
        seen = [_with_margins(each, num_ranges) for each in seen]
    facts = {
        "seen": seen,
        "stages_left": stages_left(np.array(counts)),
        "reward_spread": spread.deviation,
        "actions_taken": [dict(sorted(each.items())) for each in taken] if kind.is_flat else [],
    }
    return summary.summary(), digest.hexdigest(), _priors_joined(priors) if priors else {}, facts


def log_digest(logs: Logs) -> str:
    """Return the SHA-256 of the content of a log: names of tables and columns, and every value, row by row.

    The same trajectories have the same digest, in memory, in parts and from any format on disk.
    """
    digest = LogDigest()
    digest.add(logs)
    return digest.hexdigest()


class LogDigest:
    """The digest of a log that comes in parts, in the order of its trajectories."""

    def __init__(self) -> None:
        self._columns: dict[str, Any] = {}

    def add(self, part: Logs) -> None:
        """Add the next part."""
        for name, table in part.tables.items():
            for column in table.columns:
                for k, data in enumerate(_bytes_of(table[column])):
                    self._columns.setdefault(f"{name}.{column}.{k}", hashlib.sha256()).update(data)

    def hexdigest(self) -> str:
        """Return the SHA-256 of the digests of the columns."""
        columns = sorted(self._columns.items())
        return hashlib.sha256("".join(f"{name}:{of.hexdigest()}\n" for name, of in columns).encode()).hexdigest()


def _bytes_of(values: Any) -> Iterator[bytes]:
    if pd.api.types.is_numeric_dtype(values.dtype):
        yield _number_bytes(values.to_numpy(dtype=np.float64, na_value=np.nan))
        return
    arrow = pa.array(values, from_pandas=True)
    if pa.types.is_list(arrow.type):
        yield _number_bytes(np.asarray(arrow.value_lengths().fill_null(-1), dtype=np.float64))
        yield from _bytes_of(arrow.flatten().to_pandas())
        return
    texts = values.astype(object).map(lambda value: repr(str(value)), na_action="ignore").fillna("null")
    yield "".join(f"{text}\n" for text in texts).encode()


def _number_bytes(values: np.ndarray) -> bytes:
    # One NaN and one zero, whatever their bits.
    return np.where(np.isnan(values), np.nan, values + 0.0).astype("<f8").tobytes()


def _seen_named(logs: Logs, policy: Any, is_by_stage: bool) -> list[dict[str, Any]]:
    """Ranges of the covariates of named actions, and counts of categories, by stage or over all stages."""
    frame: Any = logs.stages
    parts = [(1, logs.horizon, frame)]
    if is_by_stage:
        parts = [(stage, stage, frame[frame["stage"] == stage]) for stage in range(1, logs.horizon + 1)]
    return [
        _entry(
            first,
            last,
            len(part),
            {name: _shown(part[name], policy.categories.get(name)) for name in policy.covariates},
        )
        | {"extremes": _extremes(part, policy)}
        for first, last, part in parts
    ]


def _extremes(part: Any, policy: Any) -> dict[str, Float[np.ndarray, "n 2"]]:
    """The minimum and maximum of each number in each trajectory, as trajectories are independent."""
    numbers = [name for name in policy.covariates if name not in policy.categories]
    if not numbers:
        return {}
    each = part.groupby("trajectory", sort=False)[numbers].agg(["min", "max"])
    return {name: each[name].to_numpy(dtype=np.float64) for name in numbers}


def _with_margins(entry: dict[str, Any], num_ranges: int) -> dict[str, Any]:
    """Replace extremes by margins."""
    each = entry.pop("extremes")
    sides = {name: (-values[:, 0], values[:, 1]) for name, values in each.items()}
    return entry | {"margins": {name: tuple(margin(side, num_ranges) for side in both) for name, both in sides.items()}}


def _shown(values: Any, categories: Sequence[str] | None) -> Any:
    if categories is None:
        return [min(_end(values.min())), max(_end(values.max()))]
    counts = values.astype(str).value_counts()
    return {name: int(counts[name]) for name in categories if name in counts}


def _end(value: Any) -> tuple[float, ...]:
    """An end of a range; in single precision also as written, since 0.1 is then more than the 0.1 of a client."""
    is_single = getattr(value, "dtype", None) == np.float32
    return (float(value), float(str(value))) if is_single else (float(value),)


def _seen_tables(logs: Logs) -> list[dict[str, Any]]:
    """Ranges over all stages: tables are alike in every stage."""
    from halfseen.world.log_checks import TABLE

    objects: Any = logs.objects
    there = objects[objects["location"] == TABLE]
    num_objects = there.groupby(["trajectory", "stage"]).size()
    each = (num_objects, there["occlusion"], there["log_odds"], there["attempt_occlusions"].map(len))
    ranges = {name: _shown(values, None) for name, values in zip(TABLE_RANGES, each, strict=True)}
    return [_entry(1, logs.horizon, logs.num_stages, ranges)]


def _entry(first: int, last: int, num_states: int, ranges: dict[str, Any]) -> dict[str, Any]:
    return {"stages": [first, last], "num_states": num_states, "ranges": ranges}


def _joined(one: dict[str, Any], other: dict[str, Any], num_ranges: int) -> dict[str, Any]:
    """Merge what two parts of a log show of the same stages."""
    ranges = {name: _wider(seen, other["ranges"][name]) for name, seen in one["ranges"].items()}
    last = max(one["stages"][1], other["stages"][1])
    joined = _entry(one["stages"][0], last, one["num_states"] + other["num_states"], ranges)
    if "extremes" not in one:
        return joined
    both = {name: np.concatenate([each, other["extremes"][name]]) for name, each in one["extremes"].items()}
    return joined | {"extremes": {name: each[: most_with_margin(num_ranges)] for name, each in both.items()}}


def _wider(one: Any, other: Any) -> Any:
    if isinstance(one, dict):
        # In the order of the categories, as in a log of one part.
        return {name: one.get(name, 0) + other.get(name, 0) for name in sorted({*one, *other})}
    return [min(one[0], other[0]), max(one[1], other[1])]


def _prior(logs: Logs) -> tuple[Any, bool, dict[str, float]]:
    from halfseen.tables.present import prior_facts

    done: Any = logs.stages[logs.stages["reward"].notna()]
    least = done.groupby("action", observed=True)["reward"].min()
    # If a recorder counted how much of an object has been in view, a second look may show nothing new.
    counts_views = logs.objects is not None and "seen" in logs.objects.columns and (logs.objects["seen"] > 0.0).any()
    return prior_facts(logs), bool(counts_views), {str(verb): float(paid) for verb, paid in least.items()}


def _priors_joined(priors: Sequence[tuple[Any, bool, dict[str, float]]]) -> dict[str, Any]:
    from halfseen.tables.present import dirty_share
    from halfseen.world.actions import Verb

    facts, counts_views, paid = zip(*priors, strict=True)
    least = {verb.name: [each[verb.name] for each in paid if verb.name in each] for verb in Verb}
    return {
        "dirty_share": dirty_share(list(facts)),
        "counts_views": any(counts_views),
        "least_rewards": {verb: min(each) for verb, each in least.items() if each},
    }


def stage_counts(logs: Logs) -> Int[np.ndarray, "T 2"]:
    """Numbers of trajectories that began and that completed each stage; those of parts of a log add up."""
    stage = logs.stages["stage"].to_numpy(dtype=np.int64)
    is_done = logs.stages["elapsed_s"].notna().to_numpy(dtype=bool)
    return np.stack([np.bincount(each, minlength=logs.horizon + 1)[1:] for each in (stage, stage[is_done])], axis=1)


def actions_taken(logs: Logs) -> list[Counter[str]]:
    """Count how often each action was taken, by stage and name; counts of parts of a log add up."""
    taken: Any = logs.stages[["stage", "action"]].dropna()
    names = taken["action"].map(str).groupby(taken["stage"])
    by_stage = {stage: Counter(of.tolist()) for stage, of in names}
    return [by_stage.get(stage, Counter()) for stage in range(1, logs.horizon + 1)]


def stages_left(counts: Int[np.ndarray, "T 2"]) -> list[float]:
    """Mean number of stages from each to the end, by Kaplan–Meier, which corrects for cuts.

    Only trajectories that completed a stage show whether they went on to the next; a cut within a stage does not. The
    errors of Q add up over this number of stages.

    Parameters
    ----------
    counts
        Counts of the whole log, as returned by `stage_counts`.

    Examples
    --------
    Of three trajectories, one was cut in stage 1; one of the two others went on.

    >>> stages = {"trajectory": [0, 1, 1, 2], "stage": [1, 1, 2, 1], "elapsed_s": [1.0, 1.0, 2.0, None]}
    >>> stages["action"] = ["A"] * 4
    >>> trajectories = {"trajectory": [0, 1, 2], "end_s": [1.0, 2.0, 0.5], "ending": ["finished", "finished", "cut"]}
    >>> stages_left(stage_counts(Logs(stages | {"reward": [1.0, 1.0, 1.0, None]}, trajectories)))
    [1.5, 1.0]
    """
    begun, done = counts.T
    left = np.ones(len(begun))
    for k in range(len(left) - 2, -1, -1):
        left[k] += left[k + 1] * begun[k + 1] / max(int(done[k]), 1)
    return left.tolist()


class _Spread(NamedTuple):
    count: int
    mean: float
    squares: float
    """Σ (reward − mean)²."""

    def plus(self, other: "_Spread") -> "_Spread":
        if not (self.count and other.count):
            return self if self.count else other
        count, apart = self.count + other.count, other.mean - self.mean
        squares = self.squares + other.squares + apart**2 * self.count * other.count / count
        return _Spread(count, self.mean + apart * other.count / count, squares)

    @property
    def deviation(self) -> float:
        return float(np.sqrt(self.squares / self.count)) if self.count else float("nan")


def _spread_of(part: Logs) -> _Spread:
    rewards = part.stages["reward"].dropna().to_numpy(dtype=np.float64)
    if not len(rewards):
        return _Spread(0, 0.0, 0.0)
    return _Spread(len(rewards), float(rewards.mean()), float(((rewards - rewards.mean()) ** 2).sum()))


def sources_of(trajectories: Frame, name: str | None = None) -> list[dict[str, Any]]:
    """List the source logs of a log, in order.

    Parameters
    ----------
    trajectories
        Its table of trajectories; if it joins several folders, the table names them (`halfseen.logs.compact`).
    name
        Name of a log that does not state its source.

    Returns
    -------
    list of dict
        ``name``, ``num_trajectories``, and the original names of its ``first`` and ``last`` one.
    """
    is_joined = RUN in trajectories.columns and RUN_TRAJECTORY in trajectories.columns
    names: Any = trajectories[RUN_TRAJECTORY if is_joined else "trajectory"]
    each = names.groupby(trajectories[RUN], sort=False) if is_joined else [(name, names)]
    return [
        {"name": run, "num_trajectories": len(some), "first": some.iloc[0], "last": some.iloc[-1]} for run, some in each
    ]
