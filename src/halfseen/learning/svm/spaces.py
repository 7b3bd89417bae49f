"""Two ways to write f = g + b with g in H: by a Gram matrix, g = K α, or by features, g = Φ θ.

Both answer the same three questions, so that one solver serves them: the values of g, its squared norm, and the Newton
step of λ‖g‖² + Σ φ_i(g_i + b), where φ has the derivatives −p and the second derivatives D on the rows.
"""

from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np
import scipy.linalg
from jaxtyping import Bool, Float

from halfseen.arrays import Rows
from halfseen.learning.svm.edited_factor import EditedFactor, factored

Coefficients = Float[np.ndarray, " c"]

_NO_CURVATURE = 1e-12


@runtime_checkable
class Space(Protocol):
    """Where g lives."""

    def num_coefficients(self) -> int:
        """C."""
        ...

    def values(self, coefficients: Coefficients) -> Rows:
        """Values of g on the rows."""
        ...

    def inner(self, coefficients: Coefficients, others: Coefficients, other_values: Rows) -> float:
        """⟨g, g'⟩ in H, where `other_values` are the values of g'."""
        ...

    def of_pull(self, pull: Rows, reg: float) -> Coefficients:
        """Coefficients of the g with 2 λ g = Σ_i pull_i k(z_i, ·); 0 where λ = 0."""
        ...

    def unpenalised(self, reg: float) -> Float[np.ndarray, "n k"]:
        """Columns of f that cost nothing, the offset's apart: all if λ = 0, else none."""
        ...

    def newton_step(
        self, coefficients: Coefficients, pull: Rows, curvature: Rows, reg: float, has_offset: bool
    ) -> tuple[Coefficients, float]:
        """Step of the coefficients and of the offset."""
        ...


@dataclass(frozen=True)
class GramSpace:
    """g = Σ_i α_i k(z_i, ·), λ > 0; K need not be of full rank.

    The optimality condition 2 λ α = p is kept in this form, without a factor K. Rows without curvature are solved at
    once, α_i = p_i / 2λ; the others, A, solve (K_AA + 2 λ D_A⁻¹) Δα_A + Δb = …, whose matrix is as large as A only.
    """

    gram: Float[np.ndarray, "n n"]
    _factor: EditedFactor = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_factor", EditedFactor(self.gram))

    def num_coefficients(self) -> int:
        return len(self.gram)

    def values(self, coefficients: Coefficients) -> Rows:
        return self.gram @ coefficients

    def inner(self, coefficients: Coefficients, others: Coefficients, other_values: Rows) -> float:
        return float(coefficients @ other_values)

    def of_pull(self, pull: Rows, reg: float) -> Coefficients:
        return pull / (2.0 * reg)

    def unpenalised(self, reg: float) -> Float[np.ndarray, "n k"]:
        return np.zeros((len(self.gram), 0))

    def newton_step(
        self, coefficients: Coefficients, pull: Rows, curvature: Rows, reg: float, has_offset: bool
    ) -> tuple[Coefficients, float]:
        is_curved = _is_curved(curvature)
        step = pull / (2.0 * reg) - coefficients
        curved = np.flatnonzero(is_curved)
        if len(curved) == 0:
            return step, 0.0
        ridge = 2.0 * reg / curvature[curved]
        rest = np.where(is_curved, 0.0, step)
        wanted = ridge * step[curved]
        if len(curved) < len(self.gram):
            wanted = wanted - (self.gram @ rest)[curved]
        right = np.column_stack([wanted, np.ones(len(curved))])[:, : 1 + has_offset]
        solved = self._factor.solve(curved, ridge, right)
        offset = 0.0
        step[curved] = solved[:, 0]
        if has_offset:
            # Σ α = 0 is the optimality condition of the offset.
            missing = -coefficients.sum() - rest.sum()
            offset = float((solved[:, 0].sum() - missing) / solved[:, 1].sum())
            step[curved] -= offset * solved[:, 1]
        return step, offset


@dataclass(frozen=True)
class FeatureSpace:
    """g = Φ θ, ‖g‖² = θᵀθ."""

    features: Float[np.ndarray, "n c"]

    def num_coefficients(self) -> int:
        return self.features.shape[1]

    def values(self, coefficients: Coefficients) -> Rows:
        return self.features @ coefficients

    def inner(self, coefficients: Coefficients, others: Coefficients, other_values: Rows) -> float:
        return float(coefficients @ others)

    def of_pull(self, pull: Rows, reg: float) -> Coefficients:
        return self.features.T @ pull / (2.0 * reg) if reg > 0.0 else np.zeros(self.num_coefficients())

    def unpenalised(self, reg: float) -> Float[np.ndarray, "n k"]:
        return self.features[:, : 0 if reg > 0.0 else None]

    def newton_step(
        self, coefficients: Coefficients, pull: Rows, curvature: Rows, reg: float, has_offset: bool
    ) -> tuple[Coefficients, float]:
        size = self.num_coefficients()
        system = np.zeros((size + 1, size + 1))
        gradient = np.zeros(size + 1)
        curved = np.flatnonzero(_is_curved(curvature))
        # Some 32 MiB of features at a time.
        for rows in np.array_split(curved, 1 + len(curved) * size // 2**22):
            weighted = self.features[rows] * np.sqrt(curvature[rows])[:, None]
            system[:size, :size] += weighted.T @ weighted
            system[:size, size] += weighted.T @ np.sqrt(curvature[rows])
        system[size, :size] = system[:size, size]
        system[size, size] = curvature.sum()
        gradient[:size] = self.features.T @ pull - 2.0 * reg * coefficients
        gradient[size] = pull.sum()
        system[np.arange(size), np.arange(size)] += 2.0 * reg
        used = size + (has_offset and system[size, size] > 0.0)
        step = np.zeros(size + 1)
        if used:
            step[:used] = _solve(system[:used, :used], gradient[:used])
        return step[:size], float(step[size])


def _is_curved(curvature: Rows) -> Bool[np.ndarray, " n"]:
    return curvature > _NO_CURVATURE * curvature.max(initial=0.0)


def _solve(system: Float[np.ndarray, "k k"], right: Float[np.ndarray, " k"]) -> Float[np.ndarray, " k"]:
    """Solve a positive semidefinite system; a direction that it does not see gets as much curvature as rounding has."""
    if not system.diagonal().max(initial=0.0) > 0.0:
        return np.zeros_like(right)
    return scipy.linalg.cho_solve((factored(system)[0], True), right, check_finite=False)
