"""How the outcomes that cuts removed are replaced: by weights, doubly robust targets, Buckley–James, or not at all.

Each kind has its own settings, so none can be given where it has no meaning. All have the same interface: the model of
the cuts, the weight of each stage in eq. 3, and whether targets are imputed, and by which covariates.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from halfseen.censoring import CENSORING_NAMES, CensoringModel, CensoringSpec, CutModel, StageClocks
from halfseen.errors import ArgumentError
from halfseen.learning.rows import TrajectoryArrays
from halfseen.shapes import Float


@dataclass(frozen=True)
class Weighted(CensoringSpec):
    """Completed stages have the weight δ_t / Ĝ(U_t⁻), as in eq. 3 (IPCW); parameters as in `CensoringSpec`."""

    is_imputed = False
    outcome_covariates = None

    def weights(self, trajectories: TrajectoryArrays, cut_model: CutModel | None) -> Float[np.ndarray, "n T"]:
        """Weight of each stage in eq. 3."""
        assert cut_model is not None
        return cut_model.weights(trajectories.clocks)


@dataclass(frozen=True)
class DoublyRobust(CensoringSpec):
    """Every stage that began has a pseudo-outcome (AIPCW), right if Ĝ or the outcome regression is (`imputation`).

    Parameters
    ----------
    model, by, covariates, truncate_at
        As in `CensoringSpec`.
    outcome_covariates
        Covariates of the outcome regression: some of those of a linear Q; None for all.
    """

    outcome_covariates: Sequence[str] | None = None

    is_imputed = True

    def weights(self, trajectories: TrajectoryArrays, cut_model: CutModel | None) -> Float[np.ndarray, "n T"]:
        """1 / Ĝ(U_{t−1}⁻) of each stage that began."""
        assert cut_model is not None
        return cut_model.begun_weights(trajectories.clocks)


class _WithoutCutModel:
    """No model of the cuts is fitted, so no data are gathered for one."""

    def looks_at(self, clocks: StageClocks) -> None:
        """Return nothing: no model is fitted."""

    def fit_cuts(self, clocks: StageClocks) -> None:
        """Return nothing: no model of the cuts is needed."""


@dataclass(frozen=True)
class BuckleyJames(_WithoutCutModel):
    """No weights: the outcome of a cut stage is imputed by a regression alone (see `imputation`).

    Parameters
    ----------
    outcome_covariates
        Covariates of the outcome regression: some of those of a linear Q; None for all.
    """

    outcome_covariates: Sequence[str] | None = None

    name = "buckley-james"
    is_imputed = True

    def weights(self, trajectories: TrajectoryArrays, cut_model: CutModel | None) -> Float[np.ndarray, "n T"]:
        """1 for each stage that began."""
        return trajectories.is_begun.astype(np.float64)


@dataclass(frozen=True)
class Unweighted(_WithoutCutModel):
    """Completed stages get equal weights and cut stages none: biased if many are cut; for comparison."""

    name = "none"
    is_imputed = False
    outcome_covariates = None

    def weights(self, trajectories: TrajectoryArrays, cut_model: CutModel | None) -> Float[np.ndarray, "n T"]:
        """1 for each completed stage."""
        return trajectories.is_completed.astype(np.float64)


Targets = Weighted | DoublyRobust | BuckleyJames | Unweighted

BY_NAME: dict[str, Callable[[], Targets]] = {"buckley-james": BuckleyJames, "none": Unweighted}
CENSORING_CHOICES = (*CENSORING_NAMES, *BY_NAME)
"""Valid names for ``censoring``."""


def targets_of(censoring: Targets | CensoringModel | str) -> Targets:
    """Parse a user's censoring: a name, a model of the cuts (for weights), or the targets themselves."""
    if isinstance(censoring, Weighted | DoublyRobust | BuckleyJames | Unweighted):
        return censoring
    if isinstance(censoring, str) and censoring in BY_NAME:
        return BY_NAME[censoring]()
    named: Any = censoring
    if isinstance(censoring, str) and censoring not in CENSORING_NAMES:
        listed = ", ".join(map(repr, CENSORING_CHOICES))
        raise ArgumentError(
            f"censoring is {censoring!r}; give {listed}, Weighted(…), DoublyRobust(…) or a CensoringModel"
        )
    return Weighted(named)


def named_targets(
    censoring: CensoringModel | str = "kaplan-meier",
    *,
    by: str = "trajectory",
    covariates: Sequence[str] | None = None,
    truncate_at: float | int | None = None,
    is_doubly_robust: bool = False,
    outcome_covariates: Sequence[str] | None = None,
) -> Targets:
    """Make targets from plain settings, as given on a command line or in a record on disk.

    Parameters
    ----------
    censoring
        One of `CENSORING_CHOICES`, or a model.
    by, covariates, truncate_at
        As in `CensoringSpec`.
    is_doubly_robust
        Use `DoublyRobust` rather than `Weighted`.
    outcome_covariates
        Covariates of the outcome regression, if there is one.
    """
    if isinstance(censoring, str) and censoring in BY_NAME:
        of_weights = {"by": None if by == "trajectory" else by, "covariates": covariates, "truncate_at": truncate_at}
        for name, value in of_weights.items():
            if value is not None:
                choice = f"{name} is {value!r}, but censoring {censoring!r} uses no weights"
                raise ArgumentError(
                    f"{choice}; leave it out, or choose a model of the cuts: 'kaplan-meier', 'cox', 'kernel'"
                )
        if is_doubly_robust:
            raise ArgumentError(f"doubly robust targets need a model of the cuts, but censoring is {censoring!r}")
        return BuckleyJames(outcome_covariates) if censoring == BuckleyJames.name else Unweighted()
    targets_of(censoring)
    if is_doubly_robust:
        return DoublyRobust(censoring, by, covariates, truncate_at, outcome_covariates)
    return Weighted(censoring, by, covariates, truncate_at)
