"""Censored Q-learning behind scikit-learn's habits: parameters in, `fit`, fitted names that end in ``_``."""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import replace
from numbers import Real
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Bool, Float
from sklearn.base import BaseEstimator
from sklearn.utils.validation import check_is_fitted

from halfseen.censoring import (
    CENSORING_NAMES,
    CensoringModel,
    WeightDiagnostics,
    named_model,
    stage_weights,
    uses_covariates,
    weight_diagnostics,
)
from halfseen.errors import ArgumentError, PositivityError
from halfseen.learners.grasp.grasp_table import grasp_model_of
from halfseen.learners.q_learning.encoding import Encoding, FlatEncoding, TableEncoding
from halfseen.learners.q_learning.linear_policy import LinearTablePolicy
from halfseen.learners.q_learning.path_covariates import first_covariates, first_table
from halfseen.learners.q_learning.recursion import QFunctions, StageMode, Transitions, backward, q_values
from halfseen.learners.q_learning.variance_reduction import expected_rewards, label_surprises, wash_outcomes
from halfseen.logs import Logs
from halfseen.world.grasp_model import GraspModel

REGS = np.logspace(-3, 2, 11)
"""The λ that ``reg="cv"`` chooses from; features are scaled to unit variance, so they need no other unit."""

TABLE = "table"


class CensoredQLearner(BaseEstimator):
    """Learns a policy from paths of which some were cut (paper, eq. 3) [GoldbergKosorok2012]_.

    Backwards from Q̂_{T+1} ≡ 0, each Q̂_t regresses R_t + max_a' Q̂_{t+1}(S_{t+1}, a') on (S_t, A_t) over the completed
    stages, weighted by δ_t / Ĝ(U_t⁻).

    Parameters
    ----------
    horizon
        T, stages that a path may have.
    actions
        Names of the actions, or for each stage (from 1) the names of those possible there; ``"table"`` for WASH, LIFT
        and FINISH on a table of objects (see `for_table`).
    covariates
        Columns of the stages that Q looks at; none for a table.
    q_function
        ``"linear"``.
    censoring
        ``"kaplan-meier"``; ``"cox"`` or ``"kernel"``, on the covariates of a path's first stage (for a table: number of
        objects and mean occlusion); ``"none"`` to leave the weights out (completed stages count alike); or a fitted or
        unfitted `CensoringModel`.
    stages
        ``"separate"``: one Q a stage; ``"pooled"``: one Q for each number of steps to go, on the rows of all stages.
    reg
        λ, or ``"cv"`` to choose it for each regression and block by weighted cross-validation over paths.
    num_folds
        Folds of that cross-validation.
    truncate_at
        Largest weight allowed, if any.
    random_state
        Seed that deals paths into folds.
    grasp
        For a table, what tells the chance of a grasp: None for Laplace's guess; `BetaGrasp` or `SVMGrasp`, which is
        fitted to the attempts of the log unless it is fitted already; or any `GraspModel`.
    reduces_variance
        For a table, takes the noise of dirty or clean and that of the labels out of the targets of eq. 3; it rests on
        the log-odds of DIRTY being right (see `variance_reduction`).

    Attributes
    ----------
    q_functions_ : QFunctions
        Coefficients and λ of every Q.
    weights_ : Float[ndarray, "n T"]
        Weight of every stage.
    diagnostics_ : WeightDiagnostics
        Effective sample size, largest weight, share truncated.
    grasp_ : GraspModel or None
        For a table: what tells the chance of a grasp.
    policy_ : LinearTablePolicy
        For a table: the policy that was learned, with its grasp model.

    Examples
    --------
    >>> from halfseen.logs import Logs
    >>> logs = Logs(
    ...     stages={
    ...         "path": [0, 1, 2, 3],
    ...         "stage": [1, 1, 1, 1],
    ...         "elapsed_s": [1.0, 1.0, 2.0, None],
    ...         "action": ["A", "B", "B", "A"],
    ...         "reward": [0.0, 1.0, 2.0, None],
    ...     },
    ...     paths={"path": [0, 1, 2, 3], "end_s": [1.0, 1.0, 2.0, 1.5], "ending": ["finished"] * 3 + ["cut"]},
    ... )
    >>> learner = CensoredQLearner(horizon=1, actions=["A", "B"], covariates=[], reg=0.0).fit(logs)
    >>> learner.decide(pd.DataFrame(index=[0]), stage=1)
    array(['B'], dtype=object)
    """

    q_functions_: QFunctions
    weights_: Float[np.ndarray, "n T"]
    diagnostics_: WeightDiagnostics
    grasp_: GraspModel | None
    policy_: LinearTablePolicy

    def __init__(
        self,
        horizon: int,
        actions: Sequence[Hashable] | Mapping[int, Sequence[Hashable]] | str = TABLE,
        covariates: Sequence[str] = (),
        *,
        q_function: str = "linear",
        censoring: str | CensoringModel = "kaplan-meier",
        stages: StageMode | str = "separate",
        reg: float | int | Literal["cv"] | str = "cv",
        num_folds: int = 5,
        truncate_at: float | int | None = None,
        random_state: int = 0,
        grasp: Any = None,
        reduces_variance: bool = False,
    ) -> None:
        self.horizon = horizon
        self.actions = actions
        self.covariates = covariates
        self.q_function = q_function
        self.censoring = censoring
        self.stages = stages
        self.reg = reg
        self.num_folds = num_folds
        self.truncate_at = truncate_at
        self.random_state = random_state
        self.grasp = grasp
        self.reduces_variance = reduces_variance

    @classmethod
    def for_table(
        cls,
        horizon: int = 10,
        *,
        stages: StageMode | str = "pooled",
        reduces_variance: bool = True,
        **parameters: Any,
    ) -> "CensoredQLearner":
        """Make a learner for logs of tables; it learns `policy_`."""
        return cls(horizon, TABLE, stages=stages, reduces_variance=reduces_variance, **parameters)

    def fit(self, logs: Logs) -> "CensoredQLearner":
        """Learn from a log.

        Raises
        ------
        ArgumentError
            A parameter has a value that it cannot take.
        LogError
            The log lacks a column, is longer than the horizon, or holds an action that was not possible.
        PositivityError
            All paths were cut, or a weight is not identified.
        """
        stages = self._checked_stages()
        self._check_parameters()
        if logs.horizon > self.horizon:
            raise ArgumentError(f"horizon is {self.horizon}, but a path has {logs.horizon} stages; raise horizon")
        encoding = self._encoding(logs)
        self.weights_ = self._weights(logs)
        self.diagnostics_ = weight_diagnostics(self.weights_, self.truncate_at)
        num_folds = self._num_folds(logs)
        log = self.transitions(logs, encoding, num_folds)
        self.q_functions_ = fit_q_functions(log, encoding, self._regs(), stages, num_folds)
        if self._is_table:
            self.policy_ = replace(as_policy(self.q_functions_, stages), grasp=self.grasp_)
        return self

    def transitions(self, logs: Logs, encoding: Encoding, num_folds: int) -> Transitions:
        """Lay out the arrays that Q is fitted to, with the weights of the log that was learned from."""
        encoded = encoding.encode(logs)
        reward = _padded(logs.stage_values("reward"), self.horizon)
        reward = np.where(np.isnan(reward), 0.0, reward)
        is_last = _last_stages(logs, self.horizon)
        if self.reduces_variance:
            reward = expected_rewards(reward, self.weights_, is_last, wash_outcomes(encoded))
        return Transitions(
            features=encoded.features,
            is_possible=encoded.is_possible,
            action=encoded.action,
            reward=reward,
            weight=self.weights_,
            is_last=is_last,
            fold=np.random.default_rng(self.random_state).permutation(logs.num_paths) % num_folds,
            surprises=label_surprises(encoded) if self.reduces_variance else None,
        )

    def q_values(self, frame: pd.DataFrame, stage: int) -> Float[np.ndarray, "m A"]:
        """Q̂ of every action in a stage (from 1), for each row of covariates; flat actions only."""
        check_is_fitted(self, "q_functions_")
        encoding = self._flat_encoding()
        if not 1 <= stage <= self.horizon:
            raise ArgumentError(f"stage is {stage}; it lies in 1 to the horizon, {self.horizon}")
        index = stage - 1 if self.stages == "separate" else self.horizon - stage
        with jax.enable_x64(True):
            blocks = jnp.asarray(encoding.block_of_action(encoding.num_blocks))
            q = q_values(jnp.asarray(self.q_functions_.coefficients[index]), encoding.features(frame), blocks)
            return np.asarray(q)

    def decide(self, frame: pd.DataFrame, stage: int) -> np.ndarray:
        """Name the possible action with the largest Q̂, for each row of covariates; flat actions only."""
        encoding = self._flat_encoding()
        q = np.where(encoding.possible(stage), self.q_values(frame, stage), -np.inf)
        names = np.empty(encoding.num_blocks, dtype=object)
        names[:] = encoding.names
        return names[np.argmax(q, axis=1)]

    @property
    def _is_table(self) -> bool:
        return isinstance(self.actions, str) and self.actions == TABLE

    def _encoding(self, logs: Logs) -> Encoding:
        if not self._is_table:
            return self._flat_encoding()
        self.grasp_ = grasp_model_of(self.grasp, logs, self.horizon)
        return TableEncoding(self.horizon, self.grasp_)

    def _flat_encoding(self) -> FlatEncoding:
        if isinstance(self.actions, str):
            raise ArgumentError(
                f"actions is {self.actions!r}: a table's policy decides, ask policy_; or name the actions"
            )
        return FlatEncoding(self.horizon, self.actions, self.covariates)

    def _regs(self) -> Float[np.ndarray, " L"]:
        return REGS if self.reg == "cv" else np.array([float(self.reg)])

    def _num_folds(self, logs: Logs) -> int:
        """Folds that the paths are dealt into; one where nothing is chosen."""
        if self.reg != "cv":
            return 1
        num_seen = int((self.weights_ > 0).any(axis=1).sum())
        if num_seen < 2:
            raise ArgumentError(
                f"reg is 'cv', which holds out paths, but {num_seen} of {logs.num_paths} completed a stage; give a "
                "number for reg, or record more paths"
            )
        return min(self.num_folds, logs.num_paths)

    def _weights(self, logs: Logs) -> Float[np.ndarray, "n T"]:
        if not logs.is_finished.any():
            raise PositivityError(
                f"all {logs.num_paths} paths were cut, so how a path ends was never seen; record until some finish, or "
                "shorten the horizon so that reaching it counts as finished"
            )
        elapsed_s = _padded(logs.elapsed_s(), self.horizon)
        if isinstance(self.censoring, str) and self.censoring == "none":
            return (~np.isnan(elapsed_s)).astype(np.float64)
        covariates = self._path_covariates(logs) if uses_covariates(named_model(self.censoring)) else None
        return stage_weights(
            elapsed_s,
            logs.end_s,
            logs.is_finished,
            self.censoring,
            self.truncate_at,
            covariates=covariates,
            path_ids=logs.path_ids,
        )

    def _path_covariates(self, logs: Logs) -> pd.DataFrame:
        return first_table(logs) if self._is_table else first_covariates(logs, self.covariates)

    def _checked_stages(self) -> StageMode:
        if self.stages not in ("separate", "pooled"):
            raise ArgumentError(f"stages is {self.stages!r}; it is 'separate' or 'pooled'")
        return self.stages

    def _check_parameters(self) -> None:
        if self.horizon < 1:
            raise ArgumentError(f"horizon is {self.horizon}; a path has at least 1 stage")
        if self.q_function != "linear":
            raise ArgumentError(f"q_function is {self.q_function!r}; it can be 'linear'")
        if isinstance(self.censoring, str) and self.censoring not in (*CENSORING_NAMES, "none"):
            names = ", ".join(repr(name) for name in CENSORING_NAMES)
            raise ArgumentError(f"censoring is {self.censoring!r}; it is {names}, 'none' or a CensoringModel")
        is_number = isinstance(self.reg, Real) and not isinstance(self.reg, bool)
        if self.reg != "cv" and not (is_number and 0 <= float(self.reg) < np.inf):
            raise ArgumentError(f"reg is {self.reg!r}; it is a λ ≥ 0, or 'cv'")
        if self.grasp is not None and not self._is_table:
            raise ArgumentError("grasp is given, but actions are named ones; only a table's objects are grasped")
        if self.reduces_variance and not self._is_table:
            raise ArgumentError("reduces_variance is True, but actions are named ones; only a table's noise is known")
        if self.reg == "cv" and self.num_folds < 2:
            raise ArgumentError(f"num_folds is {self.num_folds}; cross-validation needs at least 2")


def fit_q_functions(
    log: Transitions, encoding: Encoding, regs: Float[np.ndarray, " L"], stages: StageMode, num_folds: int
) -> QFunctions:
    """Run the recursion in float64 on one log, or on a batch of logs if the arrays have a leading axis for it.

    Raises
    ------
    ArgumentError
        A path is in a fold that does not exist, and would count for nothing.
    """
    largest = int(np.max(log.fold))
    if largest >= num_folds:
        raise ArgumentError(f"fold {largest} of {num_folds}: folds are 0 to {num_folds - 1}; deal the paths anew")
    blocks = encoding.block_of_action(log.is_possible.shape[-1])
    options = {
        "num_blocks": encoding.num_blocks,
        "stages": stages,
        "num_folds": num_folds,
        "end_action": encoding.end_action if stages == "pooled" else None,
    }
    with jax.enable_x64(True):
        arrays = jax.tree.map(jnp.asarray, log)
        is_batch = log.action.ndim == 3
        fit = backward_batch if is_batch else backward
        fitted = fit(arrays, jnp.asarray(blocks), jnp.asarray(regs), **options)
        return QFunctions(*(np.asarray(leaf) for leaf in fitted))


def backward_batch(log: Transitions, blocks: jax.Array, regs: jax.Array, **options: Any) -> QFunctions:
    """Fit a batch of logs in one compiled call."""
    return jax.vmap(lambda one: backward(one, blocks, regs, **options))(log)


def as_policy(q_functions: QFunctions, stages: StageMode) -> LinearTablePolicy:
    """Turn the Q-functions of a table (or of a batch of logs) into policies, indexed by steps to go."""
    coefficients = np.asarray(q_functions.coefficients, dtype=np.float32)
    return LinearTablePolicy(jnp.asarray(coefficients if stages == "pooled" else coefficients[..., ::-1, :, :]))


def _padded(values: Float[np.ndarray, "n L"], horizon: int) -> Float[np.ndarray, "n T"]:
    return np.pad(values, ((0, 0), (0, horizon - values.shape[1])), constant_values=np.nan)


def _last_stages(logs: Logs, horizon: int) -> Bool[np.ndarray, "n T"]:
    """Completed stages after which a path had come to its own end."""
    num_stages = np.bincount(pd.Index(logs.path_ids).get_indexer(logs.stages["path"]), minlength=logs.num_paths)
    return (np.arange(horizon) == num_stages[:, None] - 1) & logs.is_finished[:, None]
