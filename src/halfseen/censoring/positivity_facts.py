"""How far the logs support their weights: what is identified, who carries it, and what truncation would change."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from halfseen.censoring.diagnostics import FEWEST_EFFECTIVE, WeightDiagnostics
from halfseen.shapes import Float

MEAN_WEIGHT_MARGIN = 0.1
"""Weights whose mean is this far from 1 do not stand for all trajectories."""


@dataclass(frozen=True)
class WeightedTrajectory:
    """One trajectory that finished, and its weight.

    Parameters
    ----------
    trajectory
        Its name.
    time_s
        When it finished [s].
    weight
        1/Ĝ(time⁻), infinite where Ĝ is 0.
    """

    trajectory: Any
    time_s: float
    weight: float


@dataclass(frozen=True)
class Truncation:
    """What is left when the weights are bounded.

    Parameters
    ----------
    truncate_at
        The bound; None for none.
    mean
        Σ w y / Σ w over the trajectories that finished: the weighted mean of the quantity.
    effective_sample_size
        (Σ w)² / Σ w².
    share_removed
        Proportion of Σ w that the bound takes away, in [0, 1]; None where a weight has no end.
    """

    truncate_at: float | None
    mean: float
    effective_sample_size: float
    share_removed: float | None


@dataclass(frozen=True, eq=False)
class PositivityFacts:
    """What weights rest on, in numbers.

    Parameters
    ----------
    num_trajectories
        Number of trajectories.
    num_finished
        Number of those that reached their own end; the rest were cut.
    overall
        Diagnostics of the weights as they are used (bounded, if a bound was given).
    tail
        The same for the tail alone: the trajectories that finished at `tail_from_s` or later.
    tail_from_s
        The time from which the last quarter of the observed finishes lies [s]; NaN where none finished.
    heaviest
        The five largest weights, or fewer, before any truncation, and whose they are.
    unidentified
        Trajectories that finished where Ĝ is 0: without truncation they have no weight.
    identified_until_s
        The last observed end, of these trajectories or of those that the model was fitted to, whichever comes first
        [s]; earlier if Ĝ is 0 at an observed finish. Nothing is known of finishes later than this.
    num_extrapolated
        Number of trajectories that finished later than `identified_until_s` with Ĝ above 0: the model answers for them
        without having seen anyone so late.
    ends_in_cut
        True where the last observed end is a cut, so that some trajectories would have finished later than any did.
    mean_weight
        Σ w / n. Near 1 if the model is right and every finish could be seen; for Kaplan–Meier on its own trajectories
        it is exactly the estimated probability to finish by `identified_until_s` [SattenDatta2001]_.
    truncations
        The weighted mean at a grid of bounds, from none (where all is identified) down to 1, which is no weighting.
    quantity
        What the mean is of.
    truncate_at
        The bound in use, if any.
    finish_s
        When each trajectory that finished did so [s].
    weights
        Its weight before truncation, infinite where Ĝ is 0.
    cut_s
        When each cut trajectory was cut [s].
    """

    num_trajectories: int
    num_finished: int
    overall: WeightDiagnostics
    tail: WeightDiagnostics
    tail_from_s: float
    heaviest: tuple[WeightedTrajectory, ...]
    unidentified: tuple[WeightedTrajectory, ...]
    identified_until_s: float
    num_extrapolated: int
    ends_in_cut: bool
    mean_weight: float
    truncations: tuple[Truncation, ...]
    quantity: str
    truncate_at: float | int | None
    finish_s: Float[np.ndarray, " f"]
    weights: Float[np.ndarray, " f"]
    cut_s: Float[np.ndarray, " c"]

    @property
    def is_sound(self) -> bool:
        """True where every finish has a weight, weights and tail are effective enough, and the weights add up."""
        return (
            not self.has_gap
            and self.overall.effective_sample_size >= FEWEST_EFFECTIVE
            and not self.is_thin
            and not self.is_off
        )

    @property
    def has_gap(self) -> bool:
        """True where some finish is left without a weight."""
        return bool(self.unidentified) and self.truncate_at is None

    @property
    def is_off(self) -> bool:
        """True where unbounded weights add up to less or more than the trajectories, within a tenth."""
        return self.truncate_at is None and abs(self.mean_weight - 1.0) > MEAN_WEIGHT_MARGIN

    @property
    def is_thin(self) -> bool:
        """True where the tail's effective sample size is below 10, and below half of its trajectories."""
        return self.tail.effective_sample_size < min(FEWEST_EFFECTIVE, self.tail.num_seen / 2)
