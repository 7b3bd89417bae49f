"""The laws of a cell, as they were estimated, and the world that takes them."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from math import exp

import numpy as np
import pandas as pd

from halfseen.arrays import Rows
from halfseen.cell.calibration.grasp_fit import CENTRES, NAMES, SCALES, GraspFit, fit_grasping
from halfseen.cell.calibration.seeing_fit import fit_seeing
from halfseen.cell.calibration.time_fit import TimeFit, fit_times
from halfseen.cell.calibration.trials import FACTS, glances, trials
from halfseen.cell.facts import Facts, facts_of
from halfseen.logs import Logs
from halfseen.perception.view import View
from halfseen.world.config import WorldConfig
from halfseen.world.grasping import FittedGrasping
from halfseen.world.scene import Scene
from halfseen.world.seeing import PersistentSeeing

_NUM_GRIPS, _DIGITS = 100, 6
_CURVES = ("sensitivity", "false_alarms")


@dataclass(frozen=True, eq=False)
class Law:
    """What attempts and looks of a cell told of grasping and seeing.

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
        told = self.coefficients
        return FittedGrasping(
            log_odds=told["log_odds"],
            log_odds_per_occlusion=told["occlusion"],
            offset_std=exp(told["log_offset_std"]),
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
        """Log-odds by which an object is easier to hold than a standing cup of usual width with usual room.

        Parameters
        ----------
        facts
            What is seen of it.
        """
        return float(_grips(self.grasp, pd.DataFrame([asdict(facts)]))[0])

    def scene(self, view: View) -> Scene:
        """Give what a world needs to know of a table, grips included.

        Parameters
        ----------
        view
            What is seen.
        """
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
    horizon
        Stages after which a table ended by itself.
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
    told = dict(zip(NAMES, grasp.estimate.tolist(), strict=True))
    offsets = [told[name] * (facts[name].to_numpy(dtype=np.float64) - CENTRES[name]) / SCALES[name] for name in FACTS]
    return np.sum(offsets, axis=0)


def _rounded(values: np.ndarray | Sequence[float]) -> np.ndarray:
    """Digits far below the errors are dropped: machines differ in the last ones, and a law is the same on all."""
    return np.round(np.asarray(values, dtype=np.float64), _DIGITS)
