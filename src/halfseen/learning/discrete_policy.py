"""A learned Q of named actions as a policy, independent of the learner; and how cautious the policy is.

With pessimism, a policy maximises Q̂ − (1 − ℓ)·M, where ℓ is the excess propensity of the action in the log and M the
margin of its Q̂. A multiple of M demands stronger evidence for each deviation from the log; the deviations that remain
are those whose advantage has the largest lower bound, as in safe policy improvement [LarocheTrichelairTachet2019]_.
"""

import copy
from collections.abc import Hashable
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple, Protocol, TypeVar, runtime_checkable

import numpy as np

from halfseen.arrays import in_rows_of
from halfseen.errors import ArgumentError
from halfseen.estimator import is_count
from halfseen.lazy import Frame
from halfseen.learning.behaviour import excess_propensity, log_chances
from halfseen.learning.covariates import Categories, Covariates
from halfseen.learning.q_space import KernelMap
from halfseen.logs.missing import Filling
from halfseen.shapes import Bool, Float

Fitted = TypeVar("Fitted")
"""A learner with `policy_` and `model_`."""


@runtime_checkable
class NamedActionPolicy(Protocol):
    """A policy that gives the probability of each named action from plain covariates, such as `DiscretePolicy`."""

    actions: tuple[Hashable, ...]

    @property
    def horizon(self) -> int:
        """Number T of stages."""
        ...

    def probabilities(self, frame: Frame, stage: int) -> Float[np.ndarray, "m A"]:
        """π(a | S) in a stage (from 1), for each row of covariates."""
        ...


SUM_TOLERANCE = 1e-5
"""Of probabilities in single precision."""


def checked_probabilities(policy: NamedActionPolicy, frame: Frame, stage: int) -> Float[np.ndarray, "m A"]:
    """π(a | S) of any policy of named actions, checked; a row may be NaN if the policy does not know it.

    Raises
    ------
    ArgumentError
        An action is named twice, the shape is wrong, or the probabilities of a row are negative or do not add up to 1.
    """
    names, name = list(policy.actions), f"{type(policy).__name__}.probabilities, stage {stage}"
    twice = next((each for each in names if names.count(each) > 1), None)
    if twice is not None:
        raise ArgumentError(f"{type(policy).__name__}.actions names {twice!r} twice; give each action one column")
    answer: Any = in_rows_of(frame, policy.probabilities(frame, stage))
    # A table with the names of the actions is read by them.
    has_names = hasattr(answer, "columns") and set(answer.columns) == set(names)
    shape = (len(frame), len(names))
    try:
        given = np.asarray(answer[names] if has_names else answer, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise ArgumentError(f"{name}: a {type(answer).__name__} is no array ({error}); give one, {shape}") from error
    if given.shape != shape:
        raise ArgumentError(
            f"{name}: the shape is {given.shape}; give one row a state and one column an action: {shape}"
        )
    total = given.sum(axis=1)
    wrong = (given < -SUM_TOLERANCE).any(axis=1) | (np.abs(total - 1.0) > SUM_TOLERANCE)
    if wrong.any():
        row = int(np.argmax(wrong))
        raise ArgumentError(
            f"{name}, row {row}: {given[row].tolist()} for {', '.join(map(str, policy.actions))} are no probabilities; "
            "give numbers ≥ 0 that add up to 1"
        )
    return given


class Valued(NamedTuple):
    """What a policy computes for each action, for each row of covariates."""

    q: Float[np.ndarray, "m A"]
    """Q̂, also of impossible actions."""
    margins: Float[np.ndarray, "m A"]
    """‖Mᵀ (1, features)‖; 0 without pessimism."""
    scores: Float[np.ndarray, "m A"]
    """The quantity that the policy maximises."""


@dataclass(frozen=True, eq=False)
class DiscretePolicy:
    """argmax over the possible actions of Q̂_t(S, a), with pessimism less a margin (`scores`).

    Parameters
    ----------
    actions
        Names, in the order of the columns of Q.
    covariates
        Columns that Q uses.
    is_possible
        The possible actions of each stage.
    coefficients
        Of Q_1 … Q_T by stage, action and feature, the intercept first (with leading axes for a batch of policies).
    kernel_map
        Features of the RKHS; None if Q is linear in the covariates.
    margin
        M of each stage and action: the lower confidence bound is Q̂ − ‖Mᵀ (1, features)‖; None without pessimism.
    behaviour
        Coefficients of the behaviour policy on the covariates, the intercept first (`behaviour`); None if not known.
    behaviour_weight
        τ: weight of a nat of log b relative to Q (`behaviour`) [reward].
    categories
        Categories of the text covariates, as seen in the log.
    filling
        Values that replace missing covariates; None if null is refused.

    Raises
    ------
    ArgumentError
        The coefficients are not those of these stages and actions, or not finite; or a stage has no possible action.
    """

    actions: tuple[Hashable, ...]
    covariates: tuple[str, ...]
    is_possible: Bool[np.ndarray, "T A"]
    coefficients: Float[np.ndarray, "*B T A F"]
    kernel_map: KernelMap | None = None
    margin: Float[np.ndarray, "*B T A F F"] | None = None
    behaviour: Float[np.ndarray, "A G"] | None = None
    behaviour_weight: float = 0.0
    categories: Categories = field(default_factory=dict)
    filling: Filling | None = None

    def __post_init__(self) -> None:
        shape, possible = np.shape(self.coefficients), np.asarray(self.is_possible)
        if possible.shape != shape[-3:-1] or shape[-2] != len(self.actions):
            raise ArgumentError(
                f"coefficients have the shape {shape}, and is_possible {possible.shape}; give a row for each stage and "
                f"each of the {len(self.actions)} actions"
            )
        if not (np.isfinite(self.coefficients).all() and possible.any(axis=1).all()):
            raise ArgumentError("a coefficient is not finite, or a stage has no possible action; give each one")

    @property
    def looks_at(self) -> Covariates:
        """The encoding of the covariates as numbers."""
        return Covariates(self.covariates, self.categories)

    @property
    def horizon(self) -> int:
        """Number T of stages."""
        return len(self.is_possible)

    @property
    def actions_by_stage(self) -> dict[int, list[Hashable]]:
        """Names of the actions possible in each stage, from 1."""
        rows = enumerate(self.is_possible, start=1)
        return {stage: [name for name, is_it in zip(self.actions, row, strict=True) if is_it] for stage, row in rows}

    def q_values(self, frame: Frame, stage: int) -> Float[np.ndarray, "m A"]:
        """Q̂ of every action in a stage (from 1), for each row of covariates; also of impossible ones.

        The log says nothing of actions that it never completed: their Q̂ is no estimate (`is_possible` is False).

        Raises
        ------
        ArgumentError
            The stage does not exist.
        LogError
            A covariate is missing, null, not a finite number, or of a category that the log does not contain.
        """
        return self._valued(frame, stage).q

    def lower_bounds(self, frame: Frame, stage: int) -> Float[np.ndarray, "m A"]:
        """Lower confidence bound of every Q̂; Q̂ itself without pessimism."""
        valued = self._valued(frame, stage)
        return valued.q - valued.margins

    def scores(self, frame: Frame, stage: int) -> Float[np.ndarray, "m A"]:
        """Q̂ less its margin, which the policy maximises; the margin is smaller for actions that the log takes often.

        With many actions, τ·log b is added.
        """
        return self._valued(frame, stage).scores

    def valued(self, encoded: Float[np.ndarray, "m G"], stage: int) -> Valued:
        """All values of the actions in a stage (from 1), for each row of covariates as encoded by `looks_at`.

        Raises
        ------
        ArgumentError
            The stage does not exist.
        """
        self._check_stage(stage)
        features = encoded if self.kernel_map is None else np.asarray(self.kernel_map(encoded))
        each = self.coefficients[stage - 1]
        q = each[:, 0] + features @ each[:, 1:].T
        margins = self._margins(features, stage)
        if self.behaviour is None:
            return Valued(q, margins, q - margins)
        utility = self.behaviour[:, 0] + encoded @ self.behaviour[:, 1:].T
        possible = self.is_possible[stage - 1]
        scores = q - (1.0 - excess_propensity(utility, possible)) * margins
        if self.behaviour_weight > 0:
            scores = scores + self.behaviour_weight * log_chances(utility, possible)
        return Valued(q, margins, scores)

    def decide(self, frame: Frame, stage: int) -> np.ndarray:
        """The possible action with the largest score, for each row of covariates; shape (m,)."""
        names = np.empty(len(self.actions), dtype=object)
        names[:] = self.actions
        return names[self._best(frame, stage)]

    def probabilities(self, frame: Frame, stage: int) -> Float[np.ndarray, "m A"]:
        """π(a | S): 1 for the action that the policy takes."""
        best = self._best(frame, stage)
        return (best[:, None] == np.arange(len(self.actions))).astype(np.float64)

    def _best(self, frame: Frame, stage: int) -> np.ndarray:
        scores = self.scores(frame, stage)
        return np.argmax(np.where(self.is_possible[stage - 1], scores, -np.inf), axis=1)

    def _valued(self, frame: Frame, stage: int) -> Valued:
        self._check_stage(stage)
        if not (hasattr(frame, "columns") and hasattr(frame, "iloc")):
            raise ArgumentError(f"the states are a {type(frame).__name__}; give a pandas DataFrame, one row a state")
        full = frame if self.filling is None else self.filling.of_states(frame, self.covariates)
        return self.valued(self.looks_at.encode(full), stage)

    def _margins(self, features: Float[np.ndarray, "m F1"], stage: int) -> Float[np.ndarray, "m A"]:
        if self.margin is None:
            return np.zeros((len(features), len(self.actions)))
        root = self.margin[stage - 1]
        return np.stack([np.linalg.norm(each[0] + features @ each[1:], axis=1) for each in root], axis=1)

    def _check_stage(self, stage: int) -> None:
        if not (is_count(stage) and stage <= self.horizon):
            raise ArgumentError(f"stage is {stage!r}; give a whole number, 1 to the horizon, {self.horizon}")


def has_margin(policy: Any) -> bool:
    """Whether a policy has a margin that can be increased."""
    return getattr(policy, "margin", None) is not None


def more_cautious(policy: Any, times: float) -> Any:
    """The same policy with its margin multiplied; unchanged if it has none."""
    if not has_margin(policy) or times == 1.0:
        return policy
    changed = {"margin": times * policy.margin}
    if getattr(policy, "behaviour_weight", 0.0) > 0:
        changed["behaviour_weight"] = times * policy.behaviour_weight
    return replace(policy, **changed)


def more_cautious_learner(learner: Fitted, times: float) -> Fitted:
    """A copy of a learner with a more cautious policy; the original is unchanged."""
    cautious: Any = copy.copy(learner)
    cautious.policy_ = more_cautious(cautious.policy_, times)
    cautious.model_ = replace(cautious.model_, pessimism=times * cautious.model_.pessimism)
    return cautious
