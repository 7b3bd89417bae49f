"""The function class 𝒬: linear or quadratic in its features, or in an RKHS; separate or pooled; how λ is chosen.

Features ψ of a Q in an RKHS satisfy ψ(x)·ψ(z) = k(x, z) on the span of the landmarks. k is Gaussian on features scaled
to unit variance. With as many landmarks as distinct rows this is the whole RKHS that the data can use (the representer
theorem); with fewer it is its low-rank form [WilliamsSeeger2000]_. A *trend* adds the features and all their pairwise
products, so k is the sum of two kernels, and Q is the sum of a quadratic and a smooth remainder.
"""

from dataclasses import dataclass
from functools import cache, partial
from typing import Any, Literal, NamedTuple

import numpy as np

from halfseen.arrays import LEAST_RANGE, library_of
from halfseen.errors import ArgumentError
from halfseen.estimator import is_count, is_number
from halfseen.learning.svm.nystrom import fit_nystrom
from halfseen.shapes import Float


class KernelMap(NamedTuple):
    """ψ(x) = (c · q(z), Rᵀ k(landmarks, z)) with z = (x − centre)/scale and q(z) all z_i and z_i z_j."""

    centre: Float[Any, " F"]
    scale: Float[Any, " F"]
    """Mean and standard deviation of each feature; a constant feature has an infinite scale."""
    landmarks: Float[Any, "m F"]
    """m rows, scaled."""
    projection: Float[Any, "m r"]
    """R."""
    gamma: Float[Any, ""]
    """γ of the Gaussian kernel exp(−γ‖x − z‖²), on scaled features."""
    trend: Float[Any, " Q"] | None = None
    """c, for each z_i and z_i z_j; None without the quadratic trend."""

    @property
    def num_features(self) -> int:
        """Length of ψ(x)."""
        return (0 if self.trend is None else len(self.trend)) + self.projection.shape[1]

    def __call__(self, features: Float[Any, "*S F"]) -> Float[Any, "*S r"]:
        """Map features of states and actions; the result is in the array library of the input."""
        xp = library_of(features)
        scaled = (features - self.centre) / self.scale
        if self.trend is None:
            return self._smooth(scaled)
        return xp.concatenate([self.trend * quadratic(scaled), self._smooth(scaled)], axis=-1)

    def _smooth(self, scaled: Float[Any, "*S F"]) -> Float[Any, "*S r"]:
        return gaussian(scaled, self.landmarks, self.gamma) @ self.projection


def gaussian(rows: Float[Any, "*S F"], others: Float[Any, "m F"], gamma: Any) -> Float[Any, "*S m"]:
    """k(x, z) = exp(−γ‖x − z‖²) of each row with each of `others`."""
    xp = library_of(rows)
    far = xp.sum(rows**2, axis=-1, keepdims=True) + xp.sum(others**2, axis=-1)
    return xp.exp(-gamma * xp.maximum(far - 2.0 * rows @ others.T, 0.0))


def quadratic(scaled: Float[Any, "*S F"]) -> Float[Any, "*S Q"]:
    """Features and all their pairwise products, including squares."""
    xp = library_of(scaled)
    one, other = _pairs(scaled.shape[-1])
    return xp.concatenate([scaled, scaled[..., one] * scaled[..., other]], axis=-1)


@cache
def _pairs(num_features: int) -> tuple[np.ndarray, np.ndarray]:
    """All pairs of features; cached, since finding them takes longer than multiplying those of one state."""
    return np.triu_indices(num_features)


def fit_kernel_map(
    rows: Float[np.ndarray, "k F"],
    num_landmarks: int,
    gamma: float | None,
    rng: np.random.Generator,
    trend: tuple[float, float] | None = None,
) -> KernelMap:
    """Choose landmarks among rows of features.

    Parameters
    ----------
    rows
        Features of the logged stages and actions.
    num_landmarks
        Upper bound of m; fewer are used if they explain all rows.
    gamma
        γ on scaled features; None for 1/F.
    rng
        Generator that draws the landmarks.
    trend
        Root mean squares, over rows, of the linear part and of the products in c · q(z), relative to a Gaussian kernel
        of 1; None for no trend. So the more products there are, the less each counts.
    """
    centre, spread = rows.mean(axis=0), rows.std(axis=0)
    scale = np.where(spread > LEAST_RANGE * np.abs(centre), spread, np.inf)
    num_varied = max(int(np.isfinite(scale).sum()), 1)
    width = 1.0 / num_varied if gamma is None else float(gamma)
    scaled = (rows - centre) / scale
    weight = None
    if trend is not None:
        # The linear part of q and its products have root mean squares of their own.
        parts = np.split(np.asarray(quadratic(scaled)), [scaled.shape[1]], axis=1)
        means = [float(np.sqrt(np.sum(part**2, axis=-1).mean())) for part in parts]
        each = [size / mean if mean > 0 else 0.0 for size, mean in zip(trend, means, strict=True)]
        weight = np.repeat(each, [part.shape[1] for part in parts])
    if num_landmarks == 0:
        return KernelMap(centre, scale, scaled[:0], np.zeros((0, 0)), np.asarray(width), weight)
    found = fit_nystrom(partial(gaussian, gamma=width), scaled, num_landmarks, rng)
    return KernelMap(centre, scale, found.landmarks, found.projection, np.asarray(width), weight)


REGS = np.logspace(-3, 2, 11)
"""The λ that ``reg="cv"`` chooses from; features are scaled to unit variance, so this grid suits all units."""

KERNEL_REGS = np.logspace(-6, 1, 15)
"""The same for the norm of an RKHS."""

StageMode = Literal["separate", "pooled"]

TREND = "trend"
"""Pooled stages, with a trend over them (`stage_trend`)."""


@dataclass(frozen=True)
class LinearQ:
    """Q is linear in its features; λ penalises them as if each had unit variance."""

    name = "linear"
    regs = REGS
    is_scaled = True

    def features(self, rows: Float[np.ndarray, "k F"], random_state: int) -> None:
        """Leave features unchanged."""

    def num_features(self, num_inputs: int) -> int:
        """Largest number of features of a Q with this many inputs."""
        return num_inputs


@dataclass(frozen=True)
class QuadraticQ:
    """Q is linear in its features and their pairwise products; λ penalises all as if each had unit variance."""

    name = "quadratic"
    regs = REGS
    is_scaled = True

    def features(self, rows: Float[np.ndarray, "k F"], random_state: int) -> KernelMap:
        """Compute mean and variance of the completed stages; nothing is random."""
        return fit_kernel_map(rows, 0, None, np.random.default_rng(random_state), trend=(1.0, 1.0))

    def num_features(self, num_inputs: int) -> int:
        """Number of features and their products."""
        return num_inputs + num_inputs * (num_inputs + 1) // 2


@dataclass(frozen=True)
class KernelQ:
    """Q is in the RKHS of a Gaussian kernel exp(−γ‖x − z‖²) on features of unit variance.

    With a trend it is the sum of a quadratic and such a function: if a quadratic fits, λ leaves little of the rest; if
    it does not, the rest corrects it.

    Parameters
    ----------
    num_landmarks
        Largest number of rows that span Q; with as many as distinct rows, Q is exact.
    gamma
        γ; None for 1/F.
    trend
        Root mean squares of the linear part and of the products of the quadratic, relative to 1 for the Gaussian
        kernel; None for no trend.

    Raises
    ------
    ArgumentError
        A number is out of range.
    """

    num_landmarks: int = 200
    gamma: float | int | None = None
    trend: tuple[float, float] | None = None

    regs = KERNEL_REGS
    is_scaled = False

    def __post_init__(self) -> None:
        if not is_count(self.num_landmarks):
            raise ArgumentError(f"num_landmarks is {self.num_landmarks!r}; a kernel needs at least 1")
        if self.gamma is not None and not (is_number(self.gamma) and self.gamma > 0):
            raise ArgumentError(f"gamma is {self.gamma!r}; give a finite number > 0, or None for 1/F")
        if self.trend is not None and not (
            np.size(self.trend) == 2 and all(is_number(c) and c > 0 for c in self.trend)
        ):
            raise ArgumentError(f"trend is {self.trend!r}; give two finite numbers > 0, or None for no trend")

    @property
    def name(self) -> str:
        """The kind of 𝒬."""
        return "kernel" if self.trend is None else "smooth"

    def features(self, rows: Float[np.ndarray, "k F"], random_state: int) -> KernelMap:
        """Choose landmarks among the completed stages."""
        rng = np.random.default_rng(random_state)
        return fit_kernel_map(rows, self.num_landmarks, self.gamma, rng, self.trend)

    def num_features(self, num_inputs: int) -> int:
        """Number of landmarks and trend features."""
        return self.num_landmarks + (0 if self.trend is None else QuadraticQ().num_features(num_inputs))


@dataclass(frozen=True)
class TabularQ(LinearQ):
    """Q has one value per action and state, the state named by one column (`tabular`)."""

    name = "tabular"


QSpace = LinearQ | QuadraticQ | KernelQ

SMOOTH = KernelQ(num_landmarks=48, trend=(3.0, 1.5))
"""A quadratic and a smooth remainder. Its numbers were chosen on logs of the pick cell, of variants of the clinical
trial and of a world of 20 covariates, all with seeds below 1000; `benchmarks/learners.py` evaluates on others."""

Q_SPACES: dict[str, QSpace] = {space.name: space for space in (LinearQ(), QuadraticQ(), KernelQ(), SMOOTH, TabularQ())}


@dataclass(frozen=True)
class CrossValidation:
    """λ is chosen for each regression and block by weighted cross-validation over trajectories.

    Parameters
    ----------
    num_folds
        V, at least 2.
    """

    num_folds: int = 5

    def __post_init__(self) -> None:
        if not is_count(self.num_folds) or self.num_folds < 2:
            raise ArgumentError(f"num_folds is {self.num_folds!r}; cross-validation needs at least 2")


Reg = CrossValidation | float
"""How λ is chosen, or a fixed λ ≥ 0."""


def q_space_of(q_function: QSpace | Literal["linear", "quadratic", "kernel", "smooth", "tabular"] | str) -> QSpace:
    """Parse a user's 𝒬, given by name or as the space itself; refuse an invalid one."""
    if isinstance(q_function, str) and q_function in Q_SPACES:
        return Q_SPACES[q_function]
    if not isinstance(q_function, QSpace):
        names = ", ".join(map(repr, Q_SPACES))
        raise ArgumentError(
            f"q_function is {q_function!r}; give {names}, LinearQ(), QuadraticQ(), KernelQ(…) or TabularQ()"
        )
    return q_function


def stage_mode_of(stages: StageMode | str) -> StageMode:
    """Parse a user's stage mode, where a trend is one of pooled stages; refuse an invalid one."""
    if stages == "separate" or stages == "pooled":
        return stages
    if stages == TREND:
        return "pooled"
    raise ArgumentError(f"stages is {stages!r}; give 'separate', 'pooled' or 'trend'")


def reg_of(reg: Reg | int | Literal["cv"] | str) -> Reg:
    """Parse a user's λ: ``"cv"``, a `CrossValidation` or a number; refuse an invalid one."""
    if isinstance(reg, CrossValidation):
        return reg
    if isinstance(reg, str) and reg == "cv":
        return CrossValidation()
    if not (is_number(reg) and float(reg) >= 0.0):
        raise ArgumentError(f"reg is {reg!r}; give a λ ≥ 0, or 'cv'")
    return float(reg)


def pessimism_of(pessimism: float | int | str) -> float:
    """Parse a user's pessimism; refuse an invalid one."""
    if not (is_number(pessimism) and float(pessimism) >= 0.0):
        raise ArgumentError(f"pessimism is {pessimism!r}; give a number of standard errors ≥ 0, or 'auto'")
    return float(pessimism)


def half_life_of(value: float | int | str | None) -> float | str | None:
    """Parse a user's half-life [trajectories]; refuse an invalid one."""
    if value is None or value == "auto":
        return value
    if not (is_number(value) and float(value) > 0.0):
        raise ArgumentError(f"half_life is {value!r}; give a number of trajectories above 0, 'auto' or None")
    return float(value)
