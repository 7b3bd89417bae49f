"""What is simulated: times with a known median, and cuts that are uniform or depend on a covariate.

The settings are this project's own; that weighted SVMs are compared with Cox's model on simulated times follows
[GoldbergKosorok2017]_.

========  ==============================================================================================
symbol    here
========  ==============================================================================================
z         covariates, independent and uniform on [0, 1]; only the first, z1, matters
m(z)      median of the time [s]: 2 + 2 z1 (linear) or 2 + 8 (z1 − ½)² (quadratic), both from 2 to 4 s
T         time [s]: m(z) · (E / ln 2)^(1/k), E ~ Exp(1), k = 3: Weibull, so that Cox's model of it is nearly right
          where the median is linear
C         cut [s]: uniform on (0, c); or exponential with the hazard r · exp(2 z1), so that cuts come 7 times as fast
          at z1 = 1 as at z1 = 0, and Cox's model of them is right
τ         4.5 s: what is estimated is the median of min(T, τ), which is m(z), since m(z) < τ. Under uniform cuts no time
          beyond c is ever seen, so this much is identified and the mean, say, is not
========  ==============================================================================================
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Any, Literal

import numpy as np
from jaxtyping import Float
from scipy.optimize import brentq

from halfseen.arrays import RowMask, Rows

TAU = 4.5
SHAPE = 3.0
CUT_SLOPE = 2.0
CUT_SHARES = (0.3, 0.5)

MedianName = Literal["linear", "quadratic"]
CutName = Literal["uniform", "dependent"]


@dataclass(frozen=True)
class Sample:
    """Rows as they are seen: covariates, the end of each, and whether it was its own."""

    covariates: Float[np.ndarray, "n F"]
    time: Rows
    is_finished: RowMask

    @property
    def cut_share(self) -> float:
        """Share of the rows that were cut."""
        return float(1.0 - self.is_finished.mean())


@dataclass(frozen=True)
class Setting:
    """One simulated world.

    Attributes
    ----------
    median
        Shape of m.
    num_covariates
        How many covariates there are.
    cuts
        What the cuts depend on.
    cut_share
        P(C < T), in (0, 1).
    """

    median: MedianName
    num_covariates: int
    cuts: CutName
    cut_share: float

    def medians(self, covariates: Float[np.ndarray, "m F"]) -> Float[np.ndarray, " m"]:
        """m(z) [s]."""
        first = covariates[:, 0]
        return 2.0 + 2.0 * first if self.median == "linear" else 2.0 + 8.0 * (first - 0.5) ** 2

    @property
    def best_constant(self) -> float:
        """Median of m(z) over z [s]: of all constants the nearest to m(z)."""
        return 3.0 if self.median == "linear" else 2.5

    def cut_survival(self, u: Float[np.ndarray, " m"], covariates: Float[np.ndarray, "m F"]) -> Float[np.ndarray, " m"]:
        """P(C ≥ u | z) at u [s], the truth."""
        return self._cut_survival(u, covariates[:, 0], self.cut_scale)

    @cached_property
    def cut_scale(self) -> float:
        """The length that gives the wanted share: c, or 1/r [s]."""
        middles = (np.arange(200) + 0.5) / 200
        first, level = (grid.ravel() for grid in np.meshgrid(middles, middles))
        times = self.medians(first[:, None]) * _stretch(-np.log(level))

        def surplus(log_scale: float) -> float:
            return float(1.0 - self._cut_survival(times, first, np.exp(log_scale)).mean()) - self.cut_share

        root: Any = brentq(surplus, -5.0, 10.0)
        return float(np.exp(root))

    def sample(self, num_rows: int, rng: np.random.Generator) -> Sample:
        """Draw rows.

        Parameters
        ----------
        num_rows
            n.
        rng
            Draws.
        """
        covariates = rng.uniform(size=(num_rows, self.num_covariates))
        times = self.medians(covariates) * _stretch(rng.exponential(size=num_rows))
        if self.cuts == "uniform":
            cut = self.cut_scale * (1.0 - rng.uniform(size=num_rows))
        else:
            cut = self.cut_scale * np.exp(-CUT_SLOPE * covariates[:, 0]) * rng.exponential(size=num_rows)
        return Sample(covariates, np.minimum(times, cut), times <= cut)

    def _cut_survival(self, u: Rows, first: Rows, scale: float) -> Rows:
        if self.cuts == "uniform":
            return np.clip(1.0 - u / scale, 0.0, 1.0)
        return np.exp(-u * np.exp(CUT_SLOPE * first) / scale)


@dataclass(frozen=True)
class TrueCuts:
    """The true P(C ≥ u | z) as a `halfseen.censoring.CensoringModel`: nothing is fitted."""

    setting: Setting
    uses_covariates: bool = True

    def fit(self, time: Any, is_finished: Any, covariates: Any = None) -> "TrueCuts":
        """Do nothing; the truth is known."""
        return self

    def survival(self, u: Any, covariates: Any = None) -> Float[np.ndarray, " m"]:
        """P(C ≥ u | z)."""
        return self.setting.cut_survival(np.asarray(u), np.asarray(covariates))


def _stretch(exponential: Rows) -> Rows:
    """Time as a multiple of its median."""
    return (exponential / np.log(2.0)) ** (1.0 / SHAPE)
