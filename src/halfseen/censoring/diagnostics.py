"""What a set of weights leaves of the evidence: its effective sample size, and who carries it."""

import warnings
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from halfseen.censoring.inputs import checked_truncation
from halfseen.errors import ArgumentError, HalfseenWarning

# An effective sample size below this carries no average.
FEWEST_EFFECTIVE = 10.0


@dataclass(frozen=True)
class WeightDiagnostics:
    """A summary of inverse-probability weights.

    Parameters
    ----------
    num_weights
        Number of weights, those of cut trajectories included.
    num_seen
        Number of weights above 0.
    effective_sample_size
        (Σ w)² / Σ w² [Kish1965]_: that many equal weights would give the same variance; 0 where nothing was seen.
    largest_weight
        The largest weight; 0 where nothing was seen.
    largest_at
        Its index, one integer an axis; None where nothing was seen.
    share_truncated
        Proportion of Σ w that stands on weights at the bound, in [0, 1].
    """

    num_weights: int
    num_seen: int
    effective_sample_size: float
    largest_weight: float
    largest_at: tuple[int, ...] | None
    share_truncated: float

    def __str__(self) -> str:
        if self.num_seen == 0:
            return f"None of {self.num_weights} were seen, so there is nothing to weigh."
        truncated = f", and {self.share_truncated:.1%} of the weight is truncated" if self.share_truncated else ""
        return (
            f"{self.num_seen} of {self.num_weights} were seen, with an effective sample size of "
            f"{self.effective_sample_size:.1f}; the largest weight is {self.largest_weight:.3g}{truncated}."
        )


def weight_diagnostics(weights: ArrayLike, truncate_at: float | int | None = None) -> WeightDiagnostics:
    """Summarise weights as they are used.

    Parameters
    ----------
    weights
        Weights ≥ 0 of any shape, 0 where nothing was seen.
    truncate_at
        The bound that the weights were truncated at, if any; weights at the bound count as truncated.

    Raises
    ------
    ArgumentError
        A weight is negative or not finite.
    """
    tally = WeightTally(truncate_at)
    tally.add(weights)
    return tally.told()


class WeightTally:
    """What is told of weights that come in parts, along their first axis.

    Parameters
    ----------
    truncate_at
        The bound that the weights were truncated at, if any.
    """

    def __init__(self, truncate_at: float | int | None = None) -> None:
        self._bound = checked_truncation(truncate_at)
        self._num_weights = self._num_seen = self._num_rows = self.num_rows_seen = 0
        self._total = self._squares = self._truncated = self._largest = 0.0
        self._largest_at: tuple[int, ...] | None = None

    def add(self, weights: ArrayLike) -> None:
        """Count the next rows.

        Raises
        ------
        ArgumentError
            A weight is negative or not finite.
        """
        values = np.asarray(weights, dtype=np.float64)
        wrong = np.argwhere(~((values >= 0) & np.isfinite(values)))
        if len(wrong):
            at = tuple(wrong[0].tolist())
            raise ArgumentError(f"weights{list(at)} is {values[at]}; a weight is finite and ≥ 0")
        if values.any():
            self._total += values.sum()
            self._squares += np.square(values).sum()
            self._note_largest(values)
            if self._bound is not None:
                # 1/(1/bound) may miss the bound by one unit in the last place.
                self._truncated += values[values >= self._bound * (1 - 1e-12)].sum()
        self._num_weights += values.size
        self._num_seen += int(np.count_nonzero(values))
        self._num_rows += len(values) if values.ndim else 1
        self.num_rows_seen += int(values.any(axis=tuple(range(1, values.ndim))).sum())

    def told(self) -> WeightDiagnostics:
        """Summarise what was counted."""
        if not self._num_seen:
            return WeightDiagnostics(self._num_weights, 0, 0.0, 0.0, None, 0.0)
        return WeightDiagnostics(
            num_weights=self._num_weights,
            num_seen=self._num_seen,
            effective_sample_size=float(self._total**2 / self._squares),
            largest_weight=self._largest,
            largest_at=self._largest_at,
            share_truncated=float(self._truncated / self._total),
        )

    def _note_largest(self, values: np.ndarray) -> None:
        largest = float(values.max())
        if largest > self._largest:
            first, *others = np.unravel_index(int(values.argmax()), values.shape)
            self._largest, self._largest_at = largest, (self._num_rows + int(first), *map(int, others))


def warn_if_few(diagnostics: WeightDiagnostics, stacklevel: int = 3) -> None:
    """Warn where the effective sample size is below ten.

    Parameters
    ----------
    diagnostics
        Summary of the weights.
    stacklevel
        As in `warnings.warn`: 2 blames the caller of this function, 3 whoever called that caller.

    Warns
    -----
    HalfseenWarning
        The effective sample size is below 10.
    """
    if diagnostics.effective_sample_size < FEWEST_EFFECTIVE:
        warnings.warn(
            f"{diagnostics} That is too few to trust an average; record more trajectories, shorten the horizon, or "
            "truncate the weights knowingly with truncate_at=…",
            HalfseenWarning,
            stacklevel=stacklevel,
        )
