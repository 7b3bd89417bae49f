"""How far the logs support their weights: what is identified, which weights dominate, and the effect of truncation.

The positivity report in words: the verdict first, then the evidence.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from halfseen.censoring.weights import FEWEST_EFFECTIVE, WeightDiagnostics
from halfseen.shapes import Float
from halfseen.text_table import aligned

MEAN_WEIGHT_MARGIN = 0.1
"""Weights whose mean differs from 1 by more than this do not represent all trajectories."""


@dataclass(frozen=True)
class WeightedTrajectory:
    """A trajectory that finished, and its weight."""

    trajectory: Any
    """Its name."""
    time_s: float
    """When it finished [s]."""
    weight: float
    """1/Ĝ(time⁻); infinite if Ĝ is 0."""


@dataclass(frozen=True)
class Truncation:
    """The result of truncating the weights."""

    truncate_at: float | None
    """The bound; None for no bound."""
    mean: float
    """Σ w y / Σ w over the trajectories that finished: the weighted mean of the quantity."""
    effective_sample_size: float
    """(Σ w)² / Σ w²."""
    share_removed: float | None
    """Proportion of Σ w that the bound removes, in [0, 1]; None if a weight is infinite."""


@dataclass(frozen=True, eq=False)
class PositivityFacts:
    """Diagnostics of the support of the weights, in numbers.

    Parameters
    ----------
    num_trajectories
        Number of trajectories.
    num_finished
        Number of trajectories that finished; the others were cut.
    overall
        Diagnostics of the weights in use (truncated, if a bound was given).
    tail
        The same for the tail: the trajectories that finished at `tail_from_s` or later.
    tail_from_s
        The time after which the last quarter of the observed finishes lies [s]; NaN if none finished.
    heaviest
        The five largest weights, or fewer, before truncation, with their trajectories.
    unidentified
        Trajectories that finished where Ĝ is 0: they have no weight without truncation.
    identified_until_s
        The last observed end of these trajectories or of those of the fit, whichever is earlier [s]; earlier still if Ĝ
        is 0 at an observed finish. Later finishes are not identified.
    num_extrapolated
        Number of trajectories that finished later than `identified_until_s` with Ĝ above 0, for which the model
        extrapolates.
    ends_in_cut
        True if the last observed end is a cut, so that some trajectories would have finished later than any that did.
    mean_weight
        Σ w / n. Near 1 if the model is right and every finish can be observed; for Kaplan–Meier on its own trajectories
        it equals the estimated probability of finishing by `identified_until_s` [SattenDatta2001]_.
    truncations
        The weighted mean at a grid of bounds, from none (if all weights are identified) down to 1, which is no
        weighting.
    quantity
        Name of the quantity that is averaged.
    truncate_at
        The bound in use, if any.
    finish_s
        Finish time of each trajectory that finished [s].
    weights
        Its weight before truncation; infinite if Ĝ is 0.
    cut_s
        Cut time of each cut trajectory [s].
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
        """Whether every finish has a weight, weights and tail are effective enough, and the mean weight is near 1."""
        return (
            not self.has_gap
            and self.overall.effective_sample_size >= FEWEST_EFFECTIVE
            and not self.is_thin
            and not self.is_off
        )

    @property
    def has_gap(self) -> bool:
        """Whether some finish has no weight."""
        return bool(self.unidentified) and self.truncate_at is None

    @property
    def is_off(self) -> bool:
        """Whether the mean of the untruncated weights differs from 1 by more than a tenth."""
        return self.truncate_at is None and abs(self.mean_weight - 1.0) > MEAN_WEIGHT_MARGIN

    @property
    def is_thin(self) -> bool:
        """Whether the tail's effective sample size is below 10 and below half the number of its trajectories."""
        return self.tail.effective_sample_size < min(FEWEST_EFFECTIVE, self.tail.num_seen / 2)


def text(facts: PositivityFacts) -> str:
    """Write a few plain sentences and a table of truncations."""
    sentences = [verdict(facts), remedy(facts)]
    if facts.num_finished:
        heaviest = [f"{one.weight:.3g} (trajectory {one.trajectory}, {one.time_s:.4g} s)" for one in facts.heaviest]
        sentences += [_size(facts), f"Largest weights: {', '.join(heaviest)}." if heaviest else ""]
    sentences += [_until(facts), _mean_weight(facts)]
    return "\n".join([sentence for sentence in sentences if sentence] + _table(facts))


def verdict(facts: PositivityFacts) -> str:
    """State in one sentence whether the weights can be trusted."""
    size, tail = facts.overall.effective_sample_size, facts.tail
    if facts.num_finished == 0:
        every = (
            "the only trajectory was"
            if facts.num_trajectories == 1
            else f"all {facts.num_trajectories} trajectories were"
        )
        return f"No weights: {every} cut."
    if facts.has_gap:
        first = min(facts.unidentified, key=lambda trajectory: trajectory.time_s)
        return (
            f"Not identified: {_number(len(facts.unidentified))} finished where no trajectory is left "
            f"uncut (Ĝ = 0), first trajectory {first.trajectory} at {first.time_s:.4g} s."
        )
    finishes = "1 finish has" if facts.num_finished == 1 else f"{facts.num_finished} finishes have"
    finishes += f" an effective sample size of {size:.1f}"
    if size < FEWEST_EFFECTIVE:
        return f"Too little: {finishes}."
    if facts.is_thin:
        return (
            f"Thin at the end: {finishes}, but the last "
            f"{tail.num_seen}, from {facts.tail_from_s:.4g} s on, only {tail.effective_sample_size:.1f}."
        )
    if facts.is_off:
        return f"Incomplete: {finishes}, but stand for {facts.mean_weight:.0%} of the trajectories, not for all."
    return f"Sound: {finishes}."


def remedy(facts: PositivityFacts) -> str:
    """State the remedy; empty if none is needed."""
    if facts.num_finished == 0:
        return "Record until some trajectories finish, or shorten the horizon so that reaching it counts as finished."
    if facts.has_gap:
        return (
            f"Shorten the horizon so that it ends before {facts.identified_until_s:.4g} s, fit the model to "
            "trajectories that were watched longer, or truncate the weights knowingly with truncate_at=…."
        )
    size = facts.overall.effective_sample_size
    if size >= FEWEST_EFFECTIVE and not facts.is_thin:
        if not facts.is_off:
            return ""
        if facts.mean_weight > 1.0:
            return "The model overestimates the probability of cuts; try another."
        return (
            f"Either the rest finish after {facts.identified_until_s:.4g} s: restrict times to an earlier one "
            "(a trajectory that outlives it then counts as seen). Or the model underestimates the probability "
            "of cuts: try another."
        )
    if size > 0.9 * facts.num_finished:
        return "Record more trajectories; the weights are not the cause."
    return (
        f"Record more trajectories, shorten the horizon to before {facts.tail_from_s:.4g} s, or truncate the weights "
        "knowingly with truncate_at=…; the table shows what that changes."
    )


def _size(facts: PositivityFacts) -> str:
    overall, tail = facts.overall, facts.tail
    if facts.has_gap:
        size = overall.effective_sample_size
        return f"The {overall.num_seen} that have a weight have an effective sample size of {size:.1f}."
    truncated = f"; {overall.share_truncated:.1%} of the weight is truncated" if facts.truncate_at is not None else ""
    return (
        f"{facts.num_finished} of {_number(facts.num_trajectories)} finished; the last quarter of the "
        f"finishes, {tail.num_seen} from {facts.tail_from_s:.4g} s on, has an effective sample size of "
        f"{tail.effective_sample_size:.1f}{truncated}."
    )


def _until(facts: PositivityFacts) -> str:
    known = f"Nothing is known of finishes after {facts.identified_until_s:.4g} s"
    if facts.num_extrapolated:
        return f"{known}; {_number(facts.num_extrapolated)} finished later, where the model extrapolates."
    reason = "the last trajectory was cut then" if facts.ends_in_cut else "the last trajectory finished then"
    return f"{known}." if facts.unidentified else f"{known}: {reason}."


def _mean_weight(facts: PositivityFacts) -> str:
    if facts.num_finished == 0 or facts.has_gap:
        return ""
    missing = 1.0 - facts.mean_weight
    if facts.ends_in_cut and missing > 0.0005 and facts.truncate_at is None and not facts.has_gap:
        return (
            f"The mean weight is {facts.mean_weight:.3f}, so about {missing:.1%} of trajectories finish later "
            "than that."
        )
    return (
        f"The mean weight is {facts.mean_weight:.3f}; it is near 1 if the model is right and every finish can be seen."
    )


def _table(facts: PositivityFacts) -> list[str]:
    if not facts.truncations:
        return []
    rows = [("weights up to", f"mean {facts.quantity}", "effective sample size", "weight removed")]
    for row in facts.truncations:
        bound = "no bound" if row.truncate_at is None else f"{row.truncate_at:.3g}"
        removed = "no end" if row.share_removed is None else f"{row.share_removed:.1%}"
        rows.append((bound, f"{row.mean:.4g}", f"{row.effective_sample_size:.1f}", removed))
    return ["", *aligned(rows, left=())]


def _number(count: int) -> str:
    return f"{count} {'trajectory' if count == 1 else 'trajectories'}"
