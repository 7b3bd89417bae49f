"""Whether a training log comes from one unchanged cell: which part of the cell has changed, and since when.

The test uses only quantities that do not depend on the behaviour policy: covariates of the first stage; the reward,
duration and next state of each action, as residuals of a regression on the state over the whole log; and cuts minus
their cumulative hazard [FlemingHarrington1991]_. For each, the statistic is the largest difference, in standard errors,
between the means before and after any trajectory. Without change the trajectories are exchangeable, so the maximum
over all quantities is compared with that of randomly permuted trajectories [WestfallYoung1993]_. A log is finite, so
this test has more power than anytime-valid bets.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from halfseen.censoring import KaplanMeier
from halfseen.estimator import check_seed
from halfseen.learning.covariates import Covariates, fit_covariates, learned_categories
from halfseen.learning.q_model import checked_log
from halfseen.learning.rows import stage_places
from halfseen.learning.sample import sampled
from halfseen.logs import Logs
from halfseen.monitoring.diagnosis import change_point, part_words
from halfseen.monitoring.monitor import looks_at_of
from halfseen.monitoring.streams import LEAST_DEVIATION
from halfseen.policies.folder.promised_parts import FEWEST, MOST_FEATURES, WHATS, part_of, residuals
from halfseen.shapes import Float, Int

ALPHA, NUM_ORDERS = 0.02, 199


@dataclass(frozen=True)
class Change:
    """A detected change of a part of the cell within a log.

    Parameters
    ----------
    words
        What has changed, and how.
    p_value
        Adjusted for all quantities that are watched.
    since, since_low, since_high
        Name of the first trajectory after the change, and the interval of its estimate.
    num_since
        Number of trajectories from there on.
    """

    words: str
    p_value: float
    since: Any
    since_low: Any
    since_high: Any
    num_since: int

    @property
    def sentence(self) -> str:
        """The change in one sentence."""
        between = f"{self.since_low} to {self.since_high}"
        since = f"since about trajectory {self.since} ({between}), in the last {self.num_since}"
        return f"the cell has changed within the log: {self.words}, {since}"


class WatchedValue(NamedTuple):
    """A value of each trajectory, NaN if it has none, and the description of a change of the mean."""

    scores: Float[np.ndarray, " n"]
    says: Callable[[int], str]
    least: float = 0.0
    """Lower limit of their deviation: a regression may be slightly wrong where nothing else varies."""


def changes_in(logs: Logs, policy: Any = None, seed: int = 0) -> list[Change]:
    """Detect changes within a log, the clearest first; most often there are none.

    Parameters
    ----------
    logs
        The log, with its trajectories in order; of a long one, a sample is compared.
    policy
        Policy that was learned from it, which defines the covariates; None for all of the log. States are not compared
        for policies of tables, nor with more than `MOST_FEATURES` features.
    seed
        Seed of the permutations.

    Raises
    ------
    ArgumentError
        `logs` is not a `Logs`, or `seed` is not a whole number.
    """
    checked_log(logs, Logs)
    check_seed(seed)
    rows, names = sampled(logs.num_trajectories, seed), logs.trajectory_ids
    logs = logs if len(rows) == len(names) else logs.select(names[rows])
    looks_at = _all_covariates(logs) if policy is None else looks_at_of(policy)
    if looks_at.num_features > MOST_FEATURES:
        looks_at = Covariates(())
    watched = [*_first_states(logs, looks_at), *_parts(logs, looks_at), _cuts(logs)]
    scores = np.column_stack([each.scores for each in watched])
    least, rng = np.array([each.least for each in watched]), np.random.default_rng([seed, 6])
    largest = farthest_apart(scores, least)
    num_beyond = np.zeros(len(largest))
    for _ in range(NUM_ORDERS):
        num_beyond += farthest_apart(rng.permutation(scores), least).max() >= largest
        if (1.0 + num_beyond.min()) / (1.0 + NUM_ORDERS) > ALPHA:  # further orders only add to it
            return []
    p = (1.0 + num_beyond) / (1.0 + NUM_ORDERS)
    clearest = np.argsort(-largest, kind="stable")
    found = [_change(logs.trajectory_ids.tolist(), watched[k], float(p[k])) for k in clearest if p[k] <= ALPHA]
    return [replace(each, num_since=int(len(names) - rows[len(rows) - each.num_since])) for each in found]


def _all_covariates(logs: Logs) -> Covariates:
    names = fit_covariates(logs)
    return Covariates(tuple(names), learned_categories([logs], names, {}))


def _change(names: list[Any], watched: WatchedValue, p_value: float) -> Change:
    found, there = change_point(watched.scores), np.flatnonzero(~np.isnan(watched.scores))
    # The most likely change point may be nearer to an end than any tested one.
    at = int(there[np.clip(np.searchsorted(there, found.at), FEWEST, len(there) - FEWEST)])
    low, high = min(found.low, at), max(found.high, at)
    return Change(watched.says(at), p_value, names[at], names[low], names[high], len(names) - at)


def farthest_apart(scores: Float[np.ndarray, "n S"], least: Float[np.ndarray, " S"]) -> Float[np.ndarray, " S"]:
    """Largest difference of the means before and after any trajectory, in each column [standard errors].

    NaN is ignored. With k of m values after a trajectory and their deviation σ, at least `least`, a standard error is
    σ √(m / k(m − k)).
    """
    there = ~np.isnan(scores)
    num = there.sum(axis=0)
    mean = np.where(there, scores, 0.0).sum(axis=0) / np.maximum(num, 1)
    apart = np.where(there, scores - mean, 0.0)
    before, total = np.cumsum(there, axis=0), np.cumsum(apart, axis=0)
    deviation = np.maximum(np.sqrt((apart**2).sum(axis=0) / np.maximum(num, 1)), least)
    may_be = (before >= FEWEST) & (num - before >= FEWEST) & (deviation > 0)
    error = deviation * np.sqrt(before * (num - before) / np.maximum(num, 1))
    return np.where(may_be, np.abs(total) / np.where(may_be, error, 1.0), 0.0).max(axis=0)


def _first_states(logs: Logs, looks_at: Covariates) -> Iterator[WatchedValue]:
    """Ranks of the covariates of the first stage; ranks limit the influence of outliers."""
    first: Any = logs.stages[logs.stages["stage"] == 1]
    states = looks_at.encode(first)
    for name, values, ranks in zip(looks_at.names, states.T, pd.DataFrame(states).rank().to_numpy().T, strict=True):
        yield WatchedValue(ranks, partial(_says_first, name, values, ranks))


def _parts(logs: Logs, looks_at: Covariates) -> Iterator[WatchedValue]:
    """Residuals of each action's reward, duration and next state, given the state, summed by trajectory."""
    states, actions, place = looks_at.encode(logs.stages), logs.stages["action"], stage_places(logs)[0]
    for action in sorted(actions.dropna().unique().tolist()):
        is_taken = (actions == action).to_numpy(dtype=bool, na_value=False)
        for what, values in _outcomes(logs, looks_at, states, place).items():
            rows = np.flatnonzero(is_taken & ~np.isnan(values))
            if len(rows) >= FEWEST:
                left = residuals(part_of(str(action), what, states[rows], values[rows]), states[rows], values[rows])
                says = partial(_says_otherwise, str(action), what, left, place[rows])
                least = LEAST_DEVIATION * float(np.nanstd(values))
                yield WatchedValue(_summed(left, place[rows], logs.num_trajectories), says, least)


def _outcomes(
    logs: Logs, looks_at: Covariates, states: Float[np.ndarray, "m F"], place: Int[np.ndarray, " m"]
) -> dict[str, Float[np.ndarray, " m"]]:
    """Reward, log duration and next state of every stage; NaN if missing."""
    goes_on = np.append(place[1:] == place[:-1], False)
    after = np.where(goes_on[:, None], np.roll(states, -1, axis=0), np.nan)
    reward = logs.stages["reward"].to_numpy(dtype=np.float64, na_value=np.nan)
    values = [reward, np.log(np.maximum(logs.durations_s(), 1e-9)), *after.T]
    return dict(zip((*WHATS, *looks_at.names), values, strict=True))


def _summed(left: Float[np.ndarray, " m"], place: Int[np.ndarray, " m"], num: int) -> Float[np.ndarray, " n"]:
    return np.where(np.bincount(place, minlength=num) > 0, np.bincount(place, left, num), np.nan)


def _cuts(logs: Logs) -> WatchedValue:
    """Whether each was cut, minus the cumulative hazard of cuts until its end; the mean is 0 for any duration."""
    curve = KaplanMeier().fit(logs.end_s, logs.is_finished)
    before, left = (curve.survival(logs.end_s + late_s) for late_s in (0.0, 2.0 * curve.tolerance_s_))
    scores = ~logs.is_finished + np.log(np.where(left > 0, left, before))
    more = partial(_more, scores, np.arange(len(scores)))
    return WatchedValue(scores, lambda at: f"cuts are {'more' if more(at) > 0 else 'less'} frequent than before")


def _says_first(name: str, values: Float[np.ndarray, " n"], ranks: Float[np.ndarray, " n"], at: int) -> str:
    words = _says_larger(f"{name} in stage 1", ranks, np.arange(len(ranks)), at)
    return f"{words} (mean {values[at:].mean():.3g}, before {values[:at].mean():.3g})"


def _says_larger(name: str, values: Float[np.ndarray, " m"], place: Int[np.ndarray, " m"], at: int) -> str:
    return f"{name} is {'larger' if _more(values, place, at) > 0 else 'smaller'} than before"


def _says_otherwise(
    action: str, what: str, left: Float[np.ndarray, " m"], place: Int[np.ndarray, " m"], at: int
) -> str:
    if what in WHATS:
        return part_words(what, action, _more(left, place, at), "than before in the same states")
    return f"{_says_larger(f'after {action}, {what}', left, place, at)} in the same states"


def _more(values: Float[np.ndarray, " m"], place: Int[np.ndarray, " m"], at: int) -> float:
    """Mean from a trajectory on, minus the mean before it."""
    return float(values[place >= at].mean() - values[place < at].mean())
