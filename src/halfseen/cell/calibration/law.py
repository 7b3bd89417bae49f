"""The laws of a cell, estimated from what it tried: of grasping, of times, of seeing; and a world under them.

Times of attempts are lognormal, for those that hold and those that miss. An object tells what it is at some share V of
its surface: a stain is found when so much has been in view, or never. What is known of V is an interval, from what had
been seen before the label that said DIRTY to what was seen with it; or that V lies beyond all that was seen. The curve
P(V ≤ v) is a straight line between knots; its steps maximise the likelihood, found by self-consistency [Turnbull1976]_.
"""

from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, replace
from math import exp
from typing import NamedTuple

import numpy as np
import pandas as pd

from halfseen.arrays import Rows
from halfseen.cell.calibration.attempts import FACTS, glances, trials
from halfseen.cell.calibration.grasping import CENTRES, NAMES, SCALES, GraspFit, fit_grasping
from halfseen.cell.facts import Facts, facts_of
from halfseen.errors import LogError
from halfseen.logs import Logs
from halfseen.perception.labels import FACING_SHARE
from halfseen.perception.view import View
from halfseen.shapes import Float
from halfseen.tables.grasp_attempts import checked_attempts
from halfseen.world.config import WorldConfig
from halfseen.world.grasping import FittedGrasping
from halfseen.world.scene import Scene
from halfseen.world.seeing import SAME_VIEW, PersistentSeeing

FEWEST_MISSES = 5  # with fewer, a miss is taken to last as long as an attempt that holds


class TimeFit(NamedTuple):
    """Means of the logarithms of the durations of attempts that hold and that miss, and their standard deviation.

    `rest_s` is the mean time of what follows an attempt, until the next decision [s].
    """

    log_held_s: float
    log_missed_s: float
    log_std: float
    rest_s: float


def fit_times(trials: pd.DataFrame) -> TimeFit:
    """Fit the durations, each attempt weighted for those that were cut.

    Parameters
    ----------
    trials
        As `halfseen.cell.calibration.attempts.trials` gives them; attempts that found nothing to try count for the rest
        alone.
    """
    decided = checked_attempts(trials)
    rows = pd.DataFrame(trials[trials["is_finished"].to_numpy(dtype=bool)])
    attempt_s, watched_s = (rows[name].to_numpy(dtype=np.float64) for name in ("attempt_s", "time_s"))
    is_tried = attempt_s > 0.0
    weight, held = decided.weight[is_tried], decided.succeeded[is_tried]
    log_s = np.log(attempt_s[is_tried])
    means = [float(np.average(log_s[which], weights=weight[which])) for which in _groups(held)]
    spread = log_s - np.where(held, *means)
    rest_s = float(np.average(watched_s - attempt_s, weights=decided.weight))
    return TimeFit(means[0], means[1], float(np.sqrt(np.average(spread**2, weights=weight))), rest_s)


def _groups(held: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    missed = ~held
    every = np.ones_like(held)
    return (held if held.any() else every), (missed if missed.sum() >= FEWEST_MISSES else every)


VIEWS = (0.25 * FACING_SHARE, 0.5 * FACING_SHARE, 0.75 * FACING_SHARE, FACING_SHARE, 1.0)
"""Shares of the surface at which curves are fitted: quarters of what a look on the table shows, and all."""
_NUM_STEPS, _SMALLEST_CHANGE = 2000, 1e-10

Interval = tuple[float, float]
"""The label turned DIRTY after the first share had been seen, and by the second; infinite where it never did."""


def fit_seeing(glances: pd.DataFrame) -> PersistentSeeing:
    """Fit both curves.

    Parameters
    ----------
    glances
        One row an object, as `attempts.glances` gives them.

    Raises
    ------
    LogError
        No object is dirty, or none is clean.
    """
    curves = []
    for is_dirty in (True, False):
        rows = pd.DataFrame(glances[glances["is_dirty"] == is_dirty])
        if rows.empty:
            kind = "dirty" if is_dirty else "clean"
            raise LogError(
                f"objects: none of {len(glances)} is {kind}; labels are calibrated on dirty and on clean ones"
            )
        curves.append(tuple(found_by(intervals(rows)).tolist()))
    return PersistentSeeing(FACING_SHARE, VIEWS, curves[0], curves[1])


def intervals(rows: pd.DataFrame) -> list[Interval]:
    """The interval of each object that holds the share at which its label turned DIRTY.

    Parameters
    ----------
    rows
        With `attempts.GLANCES`.
    """
    columns = (rows[name] for name in ("glance_occlusions", "glance_held", "glance_dirty"))
    return [_interval(zip(*each, strict=True)) for each in zip(*columns, strict=True)]


def _interval(labels: Iterable[tuple[float, bool, bool]]) -> Interval:
    seen = 0.0
    for occlusion, is_held, says_dirty in labels:
        shown = 1.0 if is_held else FACING_SHARE * (1.0 - occlusion)
        # What shows no more than was seen before is no news: it repeats itself, or errs by noise.
        if shown <= seen + SAME_VIEW:
            continue
        if says_dirty:
            return seen, shown
        seen = shown
    return seen, np.inf


def found_by(intervals: list[Interval]) -> Float[np.ndarray, " knots"]:
    """P(V ≤ v) at each of `VIEWS`, by maximum likelihood."""
    knots = np.array([0.0, *VIEWS])
    low, high = np.array(intervals, dtype=np.float64).reshape(-1, 2).T
    # How much of each piece an interval holds; the last column is "never".
    begins, ends = np.maximum(knots[:-1], low[:, None]), np.minimum(knots[1:], high[:, None])
    inside = np.clip(ends - begins, 0.0, None) / np.diff(knots)
    share = np.column_stack([inside, np.isinf(high)])
    share = share[share.sum(axis=1) > 0]
    mass = np.full(share.shape[1], 1.0 / share.shape[1])
    for _ in range(_NUM_STEPS):
        weight = share * mass
        after = (weight / weight.sum(axis=1, keepdims=True)).mean(axis=0)
        is_settled = np.abs(after - mass).max() < _SMALLEST_CHANGE
        mass = after
        if is_settled:
            break
    return np.minimum(np.cumsum(mass[:-1]), 1.0)


_NUM_GRIPS, _DIGITS = 100, 6
_CURVES = ("sensitivity", "false_alarms")


@dataclass(frozen=True, eq=False)
class Law:
    """The laws of grasping and seeing, from attempts and looks of a cell.

    Parameters
    ----------
    grasp
        P(held) given what is seen.
    time
        How long attempts take.
    seeing
        What looks tell.
    limit_s
        Longest time of an attempt in that cell [s].
    grips
        Log-odds by which objects on its tables were easier to hold than a standing cup of usual width with usual room,
        as they looked at first: quantiles, rising.
    """

    grasp: GraspFit
    time: TimeFit
    seeing: PersistentSeeing
    limit_s: float
    grips: Rows

    @property
    def coefficients(self) -> dict[str, float]:
        """Of P(held), by name."""
        return dict(zip(NAMES, self.grasp.estimate.tolist(), strict=True))

    @property
    def grasping(self) -> FittedGrasping:
        """The law of grasping of a world."""
        estimates = self.coefficients
        return FittedGrasping(
            log_odds=estimates["log_odds"],
            log_odds_per_occlusion=estimates["occlusion"],
            offset_std=exp(estimates["log_offset_std"]),
            log_held_s=self.time.log_held_s,
            log_missed_s=self.time.log_missed_s,
            log_std=self.time.log_std,
            limit_s=self.limit_s,
        )

    def config(self, base: WorldConfig | None = None) -> WorldConfig:
        """Give a world under this law.

        Parameters
        ----------
        base
            Its rewards, prior and horizon; by default those of the default world.
        """
        world = WorldConfig() if base is None else base
        return replace(world, grasping=self.grasping, seeing=self.seeing, transport_s=self.time.rest_s)

    def grip(self, facts: Facts) -> float:
        """Log-odds by which an object is easier to hold than a standing cup of usual width with usual room."""
        return float(_grips(self.grasp, pd.DataFrame([asdict(facts)]))[0])

    def scene(self, view: View) -> Scene:
        """Give what a world needs to know of a table, grips included."""
        return self.gripped(view.scene(), facts_of(view))

    def gripped(self, scene: Scene, facts: Sequence[Facts]) -> Scene:
        """Add the grips of its objects to a scene, from what is seen of each."""
        return replace(scene, grip=np.array([self.grip(each) for each in facts]))


def fit_law(logs: Logs, horizon: int, limit_s: float) -> Law:
    """Estimate the laws of a cell from its log.

    Parameters
    ----------
    logs
        What a cell tried, with the truth about what is dirty.
    limit_s
        Longest time of an attempt [s].
    """
    tried: pd.DataFrame = trials(logs, horizon)
    assert logs.objects is not None, "trials are read from logs with objects"
    grasp, time, seeing = fit_grasping(tried), fit_times(tried), fit_seeing(glances(logs))
    grasp = replace(
        grasp,
        estimate=_rounded(grasp.estimate),
        covariance=_rounded(grasp.covariance),
        effective_sample_size=round(grasp.effective_sample_size, _DIGITS),
    )
    seeing = replace(seeing, **{name: tuple(_rounded(getattr(seeing, name)).tolist()) for name in _CURVES})
    at_first = _grips(grasp, pd.DataFrame(logs.objects[logs.objects["stage"] == 1]))
    grips = np.quantile(at_first, (np.arange(_NUM_GRIPS) + 0.5) / _NUM_GRIPS)
    return Law(grasp, TimeFit(*_rounded(time).tolist()), seeing, limit_s, _rounded(grips))


def _grips(grasp: GraspFit, facts: pd.DataFrame) -> Rows:
    estimates = dict(zip(NAMES, grasp.estimate.tolist(), strict=True))
    offsets = [
        estimates[name] * (facts[name].to_numpy(dtype=np.float64) - CENTRES[name]) / SCALES[name] for name in FACTS
    ]
    return np.sum(offsets, axis=0)


def _rounded(values: np.ndarray | Sequence[float]) -> np.ndarray:
    """Digits far below the errors are dropped: machines differ in the last ones, and a law is the same on all."""
    return np.round(np.asarray(values, dtype=np.float64), _DIGITS)
