"""Cox's proportional hazards for the censoring time C (design, §2): cuts depend on covariates.

A trajectory that finishes at s leaves before those cut at s. So in the order of time, finishes first, the risk set of a
cut time consists of the trajectories from its first cut on, and every sum over it is a suffix sum.

========  ==============================================================================================
symbol    here
========  ==============================================================================================
z_i       ``covariates``: row i
β         ``coefficients_``: log hazard ratio for one unit of each covariate
Λ̂0(s)     ``cumulative_hazard_``: just after the cuts at s, at the mean covariates
Ĝ(u⁻|z)   ``survival(u, z)`` = exp(−Λ̂0(u⁻) exp((z − z̄)β))
s_k       ``times``: the distinct times at which trajectories were cut [s]
R_k       the risk set at s_k: the rows from ``first[k]`` on
D_k       cut at s_k: the ``num_cuts[k]`` rows from ``first[k]`` on
r_i       relative risk exp(z_i β)
φ_j       proportion of the risk of D_k that has left before the j-th cut: 0 for Breslow, (place in D_k)/|D_k| for Efron
D_j       ``at_risk``: Σ_{R_k} r − φ_j Σ_{D_k} r, one for each cut j
========  ==============================================================================================
"""

from dataclasses import dataclass
from numbers import Real
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from halfseen.censoring.clocks import tied
from halfseen.censoring.inputs import (
    checked_covariates,
    checked_ends,
    checked_question,
    just_before,
    precision_of,
    refuse_constant,
    refuse_other_order,
)
from halfseen.censoring.kaplan_meier import CutOrder, cut_order
from halfseen.errors import ArgumentError
from halfseen.estimator import Estimator
from halfseen.shapes import Float

# Relative to the largest risk; above it, the inverse and its sums are finite.
SMALLEST_RISK = 1e-290
# A direction with less than this share of the information counts as having none.
NO_INFORMATION = 1e-10
# If the maximum is at infinity, each step reduces the information by a factor of about e; no regular fit comes near
# this.
INFORMATION_LOST = 1e-8
MAX_ITERATIONS, MAX_HALVINGS = 60, 30
# In standard deviations; Newton doubles the digits, so the next step would be at the rounding.
STEP_TOLERANCE = 1e-8


@dataclass(frozen=True)
class PartialLikelihood:
    """The partial likelihood at one β."""

    value: float
    """Its logarithm."""
    gradient: Float[np.ndarray, " p"]
    information: Float[np.ndarray, "p p"]
    """Minus its Hessian, the observed information: positive semidefinite."""
    hazard: Float[np.ndarray, " k"]
    """Step of the baseline cumulative hazard at each cut time: Σ_j 1/D_j over the cuts there."""


def partial_likelihood(
    beta: Float[np.ndarray, " p"], covariates: Float[np.ndarray, "n p"], trajectories: CutOrder, is_efron: bool
) -> PartialLikelihood:
    """Evaluate Cox's partial likelihood [Cox1972]_ in O(n p²), ties after [Breslow1974]_ or [Efron1977]_.

    Notes
    -----
    No p × p matrix is formed per trajectory. Σ_j Σ_{i ∈ R_j} r_i z_i z_iᵀ / D_j is one product Zᵀ diag(r · exposure) Z,
    where a trajectory's exposure Σ_{j: i ∈ R_j} 1/D_j grows at each cut while it is at risk.
    """
    scores = covariates @ beta
    # Relative to the largest, so that no risk overflows.
    shift = scores.max()
    risk = np.exp(scores - shift)
    cuts, group = trajectories.cuts, trajectories.group
    at_risk = _suffix_sums(risk)[trajectories.first][group]
    at_risk_gradient = _suffix_sums(risk[:, None] * covariates)[trajectories.first][group]
    phi = trajectories.place / trajectories.num_cuts[group] if is_efron else np.zeros(len(cuts))
    if is_efron:
        at_risk = at_risk - phi * _group_sums(risk[cuts], trajectories)[group]
        cut_gradient = _group_sums(risk[cuts, None] * covariates[cuts], trajectories)[group]
        at_risk_gradient = at_risk_gradient - phi[:, None] * cut_gradient
    if at_risk.min() < SMALLEST_RISK:
        return _nowhere(len(beta), len(trajectories.times))
    mean = at_risk_gradient / at_risk[:, None]
    hazard = _group_sums(1.0 / at_risk, trajectories)
    steps = np.zeros(len(risk))
    steps[trajectories.first] = hazard
    exposure = np.cumsum(steps)
    exposure[cuts] -= _group_sums(phi / at_risk, trajectories)[group]
    return PartialLikelihood(
        value=float((scores[cuts] - shift).sum() - np.log(at_risk).sum()),
        gradient=(covariates[cuts] - mean).sum(axis=0),
        information=covariates.T @ ((risk * exposure)[:, None] * covariates) - mean.T @ mean,
        hazard=hazard * np.exp(-shift),
    )


def _nowhere(num_covariates: int, num_times: int) -> PartialLikelihood:
    """Result for a β so large that all risk at some cut time underflows."""
    information = np.full((num_covariates, num_covariates), np.nan)
    return PartialLikelihood(-np.inf, np.full(num_covariates, np.nan), information, np.full(num_times, np.nan))


def _suffix_sums(values: np.ndarray) -> np.ndarray:
    return np.cumsum(values[::-1], axis=0)[::-1]


def _group_sums(values: np.ndarray, trajectories: CutOrder) -> np.ndarray:
    """Sum over the cuts at each time."""
    return np.add.reduceat(values, np.concatenate(([0], np.cumsum(trajectories.num_cuts)[:-1])), axis=0)


class Cox(Estimator):
    """Proportional hazards of being cut (right-censored), P(C ≥ u | z) = exp(−Λ0(u⁻) exp((z − z̄)β)) [Cox1972]_.

    β maximises the partial likelihood of the cuts; a trajectory that finishes at s leaves before those cut at s. Λ0 is
    Breslow's baseline [Breslow1974]_ for ``ties="breslow"``, and Efron's [Efron1977]_, which spreads the cuts of one
    time, for ``ties="efron"``. Unlike `KaplanMeier`, Ĝ never reaches 0, even if the last trajectories were cut: beyond
    ``last_time_`` it keeps its last value, an extrapolation without data.

    Parameters
    ----------
    ties
        How equal cut times are treated: ``"efron"`` or ``"breslow"``.
    ridge
        Penalty ridge/2 · Σ_j (β_j · sd_j)² on the log partial likelihood, ≥ 0; a positive one also makes the fit unique
        with collinear covariates or perfect separation.

    Attributes
    ----------
    coefficients_ : Float[ndarray, "p"]
        β, one for each covariate in its own unit; 0 if no trajectory was cut.
    standard_errors_ : Float[ndarray, "p"]
        Their standard errors, from the inverse information; infinite if no trajectory was cut and ridge is 0.
    covariates_ : list of str
        Names of the columns.
    means_ : Float[ndarray, "p"]
        z̄: the mean of each covariate.
    times_ : Float[ndarray, "k"]
        Distinct times at which trajectories were cut [s], increasing.
    cumulative_hazard_ : Float[ndarray, "k"]
        Λ0 just after each of `times_`, for a trajectory at `means_`.
    log_likelihood_ : float
        Log partial likelihood at β, without the penalty.
    num_iterations_ : int
        Newton steps taken.
    num_trajectories_ : int
        Number of trajectories that the model was fitted to.
    num_cut_ : int
        Number of those that were cut.
    last_time_ : float
        The last observed end [s]; there are no data beyond it.
    tolerance_s_ : float
        Times that differ by no more count as equal [s].

    Examples
    --------
    Trajectories with more clutter are cut sooner:

    >>> clutter = [[0.1], [0.9], [0.4], [0.8], [0.2], [0.6]]
    >>> cox = Cox().fit([9.0, 2.0, 5.0, 4.0, 6.0, 7.0], [True, False, False, True, False, False], clutter)
    >>> cox.survival([5.0, 5.0], [[0.1], [0.9]]).round(2)
    array([0.96, 0.68])
    """

    uses_covariates = True

    coefficients_: Float[np.ndarray, " p"]
    standard_errors_: Float[np.ndarray, " p"]
    covariates_: list[str]
    means_: Float[np.ndarray, " p"]
    times_: Float[np.ndarray, " k"]
    cumulative_hazard_: Float[np.ndarray, " k"]
    log_likelihood_: float
    num_iterations_: int
    num_trajectories_: int
    num_cut_: int
    last_time_: float
    tolerance_s_: float
    _precision: float = 0.0

    def __init__(self, ties: Literal["efron", "breslow"] = "efron", ridge: float | int = 0.0) -> None:
        self.ties = ties
        self.ridge = ridge

    def fit(self, time: ArrayLike, is_finished: ArrayLike, covariates: Any = None) -> "Cox":
        """Maximise the partial likelihood by Newton's method, with step halving; parameters as in `CensoringModel.fit`.

        Raises
        ------
        ArgumentError
            A time is not finite and positive, the lengths differ, a covariate is missing, constant or a combination of
            others, fewer trajectories were cut than there are covariates, or a covariate separates the cut trajectories
            so well that its coefficient is infinite.
        """
        self._check_parameters()
        refuse_other_order(time=time, covariates=covariates)
        ends, finished = checked_ends(time, is_finished)
        values, names = checked_covariates(covariates, len(ends), "Cox")
        ends, self.tolerance_s_ = tied(ends)
        self._precision = precision_of(time)
        trajectories = cut_order(ends, finished)
        means, scales = values.mean(axis=0), values.std(axis=0)
        if len(trajectories.times):
            if len(trajectories.cuts) < len(names) and self.ridge == 0:
                num_cut = len(trajectories.cuts)
                raise ArgumentError(
                    f"{num_cut} {'trajectories were' if num_cut > 1 else 'trajectory was'} cut, too few for "
                    f"{len(names)} covariates; leave covariates out, give ridge > 0, or use KaplanMeier"
                )
            refuse_constant(values, names)
            scaled = ((values - means) / scales)[trajectories.order]
            beta, best, self.num_iterations_ = _maximise(
                scaled, trajectories, self.ties == "efron", float(self.ridge), names
            )
            covariance = np.linalg.inv(best.information + self.ridge * np.eye(len(beta)))
            self.coefficients_, self.standard_errors_ = beta / scales, np.sqrt(np.diag(covariance)) / scales
            self.cumulative_hazard_, self.log_likelihood_ = np.cumsum(best.hazard), best.value
        else:
            # No trajectory was cut, so Ĝ is 1 and β is not identified.
            self.coefficients_, self.standard_errors_ = np.zeros(len(names)), np.full(len(names), np.inf)
            self.cumulative_hazard_, self.log_likelihood_, self.num_iterations_ = np.empty(0), 0.0, 0
        self.covariates_, self.means_ = names, means
        self.times_, self.num_trajectories_, self.num_cut_ = trajectories.times, len(ends), len(trajectories.cuts)
        self.last_time_ = float(ends.max())
        return self

    def survival(self, u: ArrayLike, covariates: Any = None) -> Float[np.ndarray, "..."]:
        """Ĝ(u⁻ | z) = P(C ≥ u | z); parameters as in `CensoringModel.survival`.

        Raises
        ------
        ArgumentError
            The model is not fitted, a time is NaN, or the covariates do not match.
        """
        if not hasattr(self, "times_"):
            raise ArgumentError("this Cox is not fitted; call fit(time, is_finished, covariates) first")
        times, values = checked_question(u, covariates, "Cox", self.covariates_)
        scores = (values - self.means_) @ self.coefficients_
        levels = np.concatenate(([0.0], self.cumulative_hazard_))
        before = just_before(times, self.tolerance_s_, max(self._precision, precision_of(u)))
        hazard = levels[np.searchsorted(self.times_, before, side="left")]
        # The hazard ratio of an extreme row would overflow; before all cuts its survival must still be 1.
        ratio = np.exp(np.minimum(scores, 700.0)).reshape((-1,) + (1,) * max(times.ndim - 1, 0))
        with np.errstate(over="ignore"):
            return np.exp(-hazard * ratio).reshape(times.shape)

    def _check_parameters(self) -> None:
        if self.ties not in ("efron", "breslow"):
            raise ArgumentError(f"ties is {self.ties!r}; give 'efron' or 'breslow'")
        if not (isinstance(self.ridge, Real) and 0 <= float(self.ridge) < np.inf):
            raise ArgumentError(f"ridge is {self.ridge!r}; give a finite number ≥ 0")


def _maximise(
    covariates: Float[np.ndarray, "n p"], trajectories: CutOrder, is_efron: bool, ridge: float, names: list[str]
) -> tuple[Float[np.ndarray, " p"], PartialLikelihood, int]:
    """Find β, the partial likelihood at β, and the number of Newton steps; covariates are standardised."""
    beta = np.zeros(covariates.shape[1])
    now = partial_likelihood(beta, covariates, trajectories, is_efron)
    initial = now.information
    if ridge == 0:
        _refuse_unidentified(initial, len(trajectories.cuts), names)
    for iteration in range(1, MAX_ITERATIONS + 1):
        step = np.linalg.solve(now.information + ridge * np.eye(len(beta)), now.gradient - ridge * beta)
        floor = _penalised(now, beta, ridge)
        floor -= 1e-12 * max(1.0, abs(floor))
        for halving in range(MAX_HALVINGS):
            now = partial_likelihood(beta + step / 2**halving, covariates, trajectories, is_efron)
            if _penalised(now, beta + step / 2**halving, ridge) >= floor:
                beta = beta + step / 2**halving
                break
        else:
            break
        if ridge == 0:
            _refuse_separation(now.information, initial, names)
        if np.abs(step).max() <= STEP_TOLERANCE:
            return beta, now, iteration
    raise _without_end(names[int(np.argmax(np.abs(beta)))])


def _refuse_unidentified(information: Float[np.ndarray, "p p"], num_cuts: int, names: list[str]) -> None:
    """Refuse covariates with unidentified effects, by the information at β = 0 in standard deviations."""
    own = np.diag(information)
    if (own <= NO_INFORMATION * num_cuts).any():
        column = int(np.argmin(own))
        raise ArgumentError(
            f"covariates, {names[column]}: equal for all trajectories at risk at every cut; leave it out, or "
            "give ridge > 0"
        )
    correlation = information / np.sqrt(np.outer(own, own))
    eigenvalues, directions = np.linalg.eigh(correlation)
    if eigenvalues[0] <= NO_INFORMATION:
        involved = [name for name, part in zip(names, directions[:, 0], strict=True) if abs(part) > 1e-4]
        raise ArgumentError(
            f"covariates {', '.join(involved)} are collinear (or cuts are too few to tell them apart), so their "
            "coefficients are not identified; leave one out, or give ridge > 0"
        )


def _refuse_separation(
    information: Float[np.ndarray, "p p"], initial: Float[np.ndarray, "p p"], names: list[str]
) -> None:
    """Refuse a partial likelihood that has lost all its information during the fit: its maximum is at infinity."""
    import scipy.linalg

    shares, directions = scipy.linalg.eigh(information, initial)
    if shares[0] < INFORMATION_LOST:
        raise _without_end(names[int(np.argmax(np.abs(directions[:, 0])))])


def _without_end(name: str) -> ArgumentError:
    """Error: the partial likelihood is monotone in the coefficient of this covariate."""
    return ArgumentError(
        f"covariates, {name}: its coefficient diverges, because it predicts perfectly which of the trajectories "
        "at risk is cut next; leave it out, give ridge > 0, or use KaplanMeier"
    )


def _penalised(likelihood: PartialLikelihood, beta: Float[np.ndarray, " p"], ridge: float) -> float:
    """Log partial likelihood minus the penalty; −∞ if it is out of the range of floats."""
    value = likelihood.value - ridge / 2 * float(beta @ beta)
    return value if np.isfinite(value) and np.isfinite(likelihood.information).all() else -np.inf
