"""Where Q is sought, 𝒬: linear or quadratic in its features, or in an RKHS; by stage or pooled; how λ is chosen."""

from dataclasses import dataclass
from numbers import Real
from typing import Any, Literal

import numpy as np

from halfseen.errors import ArgumentError
from halfseen.learning.kernel_map import KernelMap, fit_kernel_map
from halfseen.shapes import Float

REGS = np.logspace(-3, 2, 11)
"""The λ that ``reg="cv"`` chooses from; features are scaled to unit variance, so they need no other unit."""

KERNEL_REGS = np.logspace(-6, 1, 15)
"""The same for the norm of an RKHS."""


StageMode = Literal["separate", "pooled"]


def _is_number(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool) and bool(np.isfinite(float(value)))


@dataclass(frozen=True)
class LinearQ:
    """Q is linear in its features; λ weighs them as if each had unit variance."""

    regs = REGS
    is_scaled = True

    def features(self, rows: Float[np.ndarray, "k F"], random_state: int) -> None:
        """Features stay as they are."""


@dataclass(frozen=True)
class QuadraticQ:
    """Q is linear in its features and in the products of each two; λ weighs all as if each had unit variance."""

    regs = REGS
    is_scaled = True

    def features(self, rows: Float[np.ndarray, "k F"], random_state: int) -> KernelMap:
        """Find mean and variance of the completed stages; nothing is drawn."""
        return fit_kernel_map(rows, 0, None, np.random.default_rng(random_state), trend=(1.0, 1.0))


@dataclass(frozen=True)
class KernelQ:
    """Q is in the RKHS of a Gaussian kernel exp(−γ‖x − z‖²) on features of unit variance.

    With a trend it is the sum of a quadratic and of such a function: where a quadratic does, λ leaves little of the
    rest, and where it does not, the rest mends it.

    Parameters
    ----------
    num_landmarks
        Rows whose span Q lies in, at most; with as many as there are different rows, it is exact.
    gamma
        γ; None for 1/F.
    trend
        Root mean squares of the features of the quadratic, of its linear part and of its products, where those of the
        Gaussian kernel have 1; None for none.

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
        if self.num_landmarks < 1:
            raise ArgumentError(f"num_landmarks is {self.num_landmarks}; a kernel needs at least 1")
        if self.gamma is not None and not (_is_number(self.gamma) and self.gamma > 0):
            raise ArgumentError(f"gamma is {self.gamma!r}; it is a finite number > 0, or None for 1/F")
        if self.trend is not None and not (len(self.trend) == 2 and all(_is_number(c) and c > 0 for c in self.trend)):
            raise ArgumentError(f"trend is {self.trend!r}; it is two finite numbers > 0, or None for no trend")

    def features(self, rows: Float[np.ndarray, "k F"], random_state: int) -> KernelMap:
        """Choose landmarks among the completed stages."""
        rng = np.random.default_rng(random_state)
        return fit_kernel_map(rows, self.num_landmarks, self.gamma, rng, self.trend)


@dataclass(frozen=True)
class TabularQ:
    """Q has a value for each action in each state, of a state that one column names (`tabular`)."""

    regs = REGS
    is_scaled = True

    def features(self, rows: Float[np.ndarray, "k F"], random_state: int) -> None:
        """A state is its number."""


QSpace = LinearQ | QuadraticQ | KernelQ | TabularQ

SMOOTH = KernelQ(num_landmarks=48, trend=(3.0, 1.5))
"""A quadratic and a smooth remainder. Its numbers were chosen on logs of the pick cell, of kin of the clinical trial
and of a world of 20 covariates, all of seeds below 1000; `benchmarks/learners.py` judges by others."""

Q_SPACES: dict[str, QSpace] = {
    "linear": LinearQ(),
    "quadratic": QuadraticQ(),
    "kernel": KernelQ(),
    "smooth": SMOOTH,
    "tabular": TabularQ(),
}


MOST_WORK = 1e8
"""K·F³ of K blocks of F features that a Q may have which nobody asked for: seconds. Twenty covariates of three actions,
or eight of sixteen, are smooth; thirty-two of sixteen are linear."""
MOST_MEMORY = 4e9
"""That sums over rows may take [bytes]."""
NUM_SUMS = 4
"""Matrices of sums of each fold and block (`sums.Moments`)."""


def num_features_of(space: QSpace, num_inputs: int) -> int:
    """Count the features that a Q of so many inputs has, at most."""
    num_products = num_inputs * (num_inputs + 1) // 2
    if isinstance(space, KernelQ):
        return space.num_landmarks + (0 if space.trend is None else num_inputs + num_products)
    return num_inputs + (num_products if isinstance(space, QuadraticQ) else 0)


def is_affordable(space: QSpace, num_inputs: int, num_blocks: int) -> bool:
    """Tell whether a Q is fitted in seconds."""
    return num_blocks * num_features_of(space, num_inputs) ** 3 <= MOST_WORK


def refuse_too_large(space: QSpace, num_inputs: int, num_blocks: int, num_sums: int) -> None:
    """Refuse a Q whose sums over rows take more than `MOST_MEMORY`.

    Raises
    ------
    ArgumentError
        They do.
    """
    num_features = num_features_of(space, num_inputs)
    needed = 8.0 * NUM_SUMS * num_sums * num_blocks * (1 + num_features) ** 2
    if needed > MOST_MEMORY:
        raise ArgumentError(
            f"q_function is {name_of(space)!r}: {num_features} features for each of {num_blocks} actions take "
            f"{needed / 1e9:.0f} GB, and {MOST_MEMORY / 1e9:.0f} GB are allowed; leave covariates out, group their "
            "categories, or choose 'linear' or KernelQ(num_landmarks=…)"
        )


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
        if self.num_folds < 2:
            raise ArgumentError(f"num_folds is {self.num_folds}; cross-validation needs at least 2")


Reg = CrossValidation | float
"""How λ is chosen, or λ ≥ 0."""


def q_space_of(q_function: QSpace | Literal["linear", "quadratic", "kernel", "smooth", "tabular"] | str) -> QSpace:
    """Read what a user says of 𝒬: a name, or the space itself.

    Raises
    ------
    ArgumentError
        It is neither.
    """
    if isinstance(q_function, str) and q_function in Q_SPACES:
        return Q_SPACES[q_function]
    if not isinstance(q_function, QSpace):
        names = ", ".join(map(repr, Q_SPACES))
        raise ArgumentError(
            f"q_function is {q_function!r}; it is {names}, LinearQ(), QuadraticQ(), KernelQ(…) or TabularQ()"
        )
    return q_function


def name_of(space: QSpace) -> str:
    """Name the kind of a 𝒬."""
    if isinstance(space, KernelQ):
        return "kernel" if space.trend is None else "smooth"
    names = {QuadraticQ: "quadratic", TabularQ: "tabular"}
    return names.get(type(space), "linear")


def stage_mode_of(stages: StageMode | str) -> StageMode:
    """Read what a user says of stages.

    Raises
    ------
    ArgumentError
        It is neither ``"separate"`` nor ``"pooled"``.
    """
    if stages == "separate" or stages == "pooled":
        return stages
    raise ArgumentError(f"stages is {stages!r}; it is 'separate' or 'pooled'")


def reg_of(reg: Reg | int | Literal["cv"] | str) -> Reg:
    """Read what a user says of λ: ``"cv"``, a `CrossValidation`, or a number; what was read already stays.

    Raises
    ------
    ArgumentError
        It is none of these.
    """
    if isinstance(reg, CrossValidation):
        return reg
    if isinstance(reg, str) and reg == "cv":
        return CrossValidation()
    if not (_is_number(reg) and float(reg) >= 0.0):
        raise ArgumentError(f"reg is {reg!r}; it is a λ ≥ 0, or 'cv'")
    return float(reg)


def pessimism_of(pessimism: float | int | str) -> float:
    """Read what a user says of pessimism.

    Raises
    ------
    ArgumentError
        It is no finite number ≥ 0.
    """
    if not (_is_number(pessimism) and float(pessimism) >= 0.0):
        raise ArgumentError(f"pessimism is {pessimism!r}; it is a number of standard errors ≥ 0, or 'auto'")
    return float(pessimism)
