"""The local product-limit curve itself, for many questions at once in bounded memory."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from halfseen.arrays import RowMask, Rows
from halfseen.censoring.partial_likelihood import CutOrder, cut_order
from halfseen.shapes import Float

# Floats in one block of questions × trajectories: 32 MB.
BLOCK_SIZE = 4_000_000
# Beyond this many bandwidths a trajectory says nothing: exp(−8²/2) is 1e-14.
GAUSSIAN_REACH = 8.0


def _gaussian(squared: np.ndarray) -> np.ndarray:
    return np.where(squared <= GAUSSIAN_REACH**2, np.exp(-squared / 2), 0.0)


def _epanechnikov(squared: np.ndarray) -> np.ndarray:
    return np.maximum(1.0 - squared, 0.0)


KERNELS = {"gaussian": _gaussian, "epanechnikov": _epanechnikov}


@dataclass(frozen=True)
class LocalCurve:
    """Trajectories in the order in which they leave.

    Parameters
    ----------
    covariates
        Standardised covariates of the trajectories, in that order.
    trajectories
        The order, and where the cuts stand in it.
    """

    covariates: Float[np.ndarray, "n p"]
    trajectories: CutOrder

    @classmethod
    def of_trajectories(cls, ends: Rows, finished: RowMask, covariates: Float[np.ndarray, "n p"]) -> "LocalCurve":
        """Sort trajectories by their ends [s], finishes before cuts at equal times."""
        trajectories = cut_order(ends, finished)
        return cls(covariates[trajectories.order], trajectories)

    @property
    def times(self) -> Float[np.ndarray, " k"]:
        """Distinct times at which trajectories were cut [s]."""
        return self.trajectories.times

    def survival(
        self, u: Float[np.ndarray, "m q"], covariates: Float[np.ndarray, "m p"], bandwidth: float, kernel: str
    ) -> Float[np.ndarray, "m q"]:
        """Ĝ(u⁻ | z), NaN where nobody near z was watched at some cut before u.

        Parameters
        ----------
        u
            Times asked about [s], a row of them for each question.
        covariates
            Standardised covariates of the questions.
        bandwidth
            In standard deviations.
        kernel
            One of `KERNELS`.
        """
        distinct, question = np.unique(covariates, axis=0, return_inverse=True)
        question = question.reshape(-1)
        step = np.searchsorted(self.times, u, side="left")
        seen = np.ones(u.shape)
        rows = np.argsort(question, kind="stable")
        bounds = np.searchsorted(question[rows], np.arange(len(distinct) + 1))
        for block in _blocks(len(distinct), len(self.covariates)):
            levels = self._levels(distinct[block], bandwidth, kernel)
            mine = rows[bounds[block.start] : bounds[block.stop]]
            seen[mine] = levels[question[mine, None] - block.start, step[mine]]
        return seen

    def _levels(self, covariates: Float[np.ndarray, "b p"], bandwidth: float, kernel: str) -> Float[np.ndarray, "b K"]:
        """Ĝ before the first cut and after each, one row for each question."""
        trajectories = self.trajectories
        ones = np.ones((len(covariates), 1))
        if len(trajectories.times) == 0:
            return ones
        from scipy.spatial.distance import cdist

        with np.errstate(over="ignore"):
            near = KERNELS[kernel](np.square(cdist(covariates, self.covariates) / bandwidth))
        # One column more: nobody is left after the last trajectory.
        watched = np.pad(np.cumsum(near[:, ::-1], axis=1)[:, ::-1], ((0, 0), (0, 1)))
        before, after = watched[:, trajectories.first], watched[:, trajectories.first + trajectories.num_cuts]
        stays = np.divide(after, before, out=np.full(before.shape, np.nan), where=before > 0)
        return np.concatenate([ones, np.cumprod(stays, axis=1)], axis=1)


def _blocks(num_questions: int, num_trajectories: int) -> Iterator[slice]:
    size = max(1, BLOCK_SIZE // max(1, num_trajectories))
    for start in range(0, num_questions, size):
        yield slice(start, min(start + size, num_questions))
