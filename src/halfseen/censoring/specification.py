"""Which model of the cuts, and on which clock: said once, fitted where it is needed."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from halfseen.censoring.cut_model import CENSORING_BY, CensoringBy, CutModel, fit_cut_model
from halfseen.censoring.inputs import checked_truncation
from halfseen.censoring.model import CensoringModel, uses_covariates
from halfseen.censoring.named import named_model
from halfseen.censoring.stage_clocks import StageClocks
from halfseen.errors import ArgumentError


@dataclass(frozen=True)
class CensoringSpec:
    """A censoring model that is still to be fitted, and its time scale.

    Parameters
    ----------
    model
        ``"kaplan-meier"``, ``"cox"``, ``"kernel"``, or a fitted or unfitted `CensoringModel`: what Ĝ is.
    by
        ``"trajectory"``: Ĝ on the total-time scale, given how the trajectory began; ``"stage"``: a model for each
        stage, on the gap-time scale; ``"pooled"``: one such model for all stages (see `cut_model`). By stage or pooled,
        ``"cox"`` is ``Cox(ridge=1)``.
    covariates
        What a model that uses covariates is given: columns of the stages, and ``"action"`` for the action; for a table
        ``"num_objects"``, ``"mean_occlusion"``, ``"action"``, ``"target_occlusion"``. None for all, the action by
        stage only, and of a trajectory's first table the first two.
    truncate_at
        Largest weight 1/Ĝ allowed; None truncates nothing.

    Raises
    ------
    ArgumentError
        There is no such model or clock, the covariates are no list, or the bound is below 1.
    """

    model: str | CensoringModel = "kaplan-meier"
    by: CensoringBy | str = "trajectory"
    covariates: Sequence[str] | None = None
    truncate_at: float | int | None = None

    def __post_init__(self) -> None:
        named_model(self.model)
        if self.by not in CENSORING_BY:
            raise ArgumentError(f"by is {self.by!r}; it is {', '.join(map(repr, CENSORING_BY[:-1]))} or 'pooled'")
        if isinstance(self.covariates, str):
            raise ArgumentError(f"covariates is {self.covariates!r}; give a list of names")
        checked_truncation(self.truncate_at)
        if self.covariates is not None and not self.uses_covariates:
            raise ArgumentError(
                f"covariates is {list(self.covariates)}, but {self.name} uses none; leave them out, or choose 'cox' or "
                "'kernel'"
            )

    @property
    def name(self) -> str:
        """Name of the model, or what an object prints."""
        return self.model if isinstance(self.model, str) else repr(self.model)

    @property
    def uses_covariates(self) -> bool:
        """Whether the model conditions on covariates."""
        return uses_covariates(named_model(self.model))

    def looks_at(self, clocks: StageClocks) -> StageClocks | None:
        """What of a part of a log Ĝ is fitted to, beyond the ends of the trajectories; None if nothing."""
        if self.by != "trajectory":
            return clocks
        # On the clock of trajectories, Ĝ looks at how each began alone.
        return clocks.begun() if self.uses_covariates else None

    def fit_cuts(self, clocks: StageClocks) -> CutModel:
        """Fit Ĝ; a model that is fitted already is taken as it is.

        Raises
        ------
        ArgumentError
            The model cannot be fitted, or needs the action of a stage in which a trajectory was cut, which was not
            logged.
        """
        by: Any = self.by
        return fit_cut_model(clocks, self.model, by, self.truncate_at)
