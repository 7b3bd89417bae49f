"""Censored Q-learning behind scikit-learn's habits: parameters in, `fit`, fitted names that end in ``_``."""

from collections.abc import Hashable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pandas as pd
from jaxtyping import Float, Int
from sklearn.base import BaseEstimator
from sklearn.utils.validation import check_is_fitted

from halfseen.censoring import CensoringModel, WeightDiagnostics, named_model, uses_covariates, weight_diagnostics
from halfseen.errors import ArgumentError
from halfseen.learners.q_learning.checks import (
    BUCKLEY_JAMES,
    NONE,
    check_parameters,
    check_streamable,
    refuse_all_cut,
    refuse_too_few,
)
from halfseen.learners.q_learning.cut_covariates import ACTION, TABLE_COVARIATES, flat_covariates, table_covariates
from halfseen.learners.q_learning.cut_model import CensoringBy, CutModel, fit_cut_model, fit_path_cuts
from halfseen.learners.q_learning.encoding import Encoding, FlatEncoding, TableEncoding
from halfseen.learners.q_learning.fitting import (
    KERNEL_REGS,
    REGS,
    as_policy,
    backward_options,
    fit_q_functions,
    single_precision,
)
from halfseen.learners.q_learning.flat_policy import FlatPolicy
from halfseen.learners.q_learning.imputation import imputation
from halfseen.learners.q_learning.kernel_map import KernelMap, fit_kernel_map
from halfseen.learners.q_learning.path_arrays import PathArrays, path_arrays
from halfseen.learners.q_learning.recursion import Imputation, QFunctions, StageMode, Transitions
from halfseen.learners.q_learning.streaming import fit_stream
from halfseen.logs import Logs, LogStream
from halfseen.logs.columns import FINISHED
from halfseen.tables.grasp.grasp_table import grasp_model_of
from halfseen.tables.variance_reduction import expected_rewards, label_surprises, wash_outcomes
from halfseen.world.grasp_model import GraspModel

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
        ``"linear"``: Q is linear in the covariates (on a table, in its features); ``"kernel"``: Q is in the RKHS of a
        Gaussian kernel on them.
    censoring
        ``"kaplan-meier"``, ``"cox"``, ``"kernel"``, or a fitted or unfitted `CensoringModel`: what Ĝ is;
        ``"buckley-james"``: no weights, what a cut stage would have brought is imputed instead (see `imputation`);
        ``"none"``: neither, completed stages count alike.
    censoring_by
        ``"path"``: Ĝ on the clock of the path, given how it began; ``"stage"``: a model for each stage, on the clock of
        the stage; ``"pooled"``: one such model for all stages (see `cut_model`). By stage or pooled, ``"cox"`` is
        ``Cox(ridge=1)``.
    censoring_covariates
        What a model that uses covariates is given: columns of the stages, and ``"action"`` for the action; for a table
        ``"num_objects"``, ``"mean_occlusion"``, ``"action"``, ``"target_occlusion"``. By default all, the action by
        stage only, and of a path's first table the first two.
    augmented
        Doubly robust: every begun stage counts, with a target that is right if Ĝ is, or if the regression of the
        target on covariates and durations is (see `imputation`).
    outcome_covariates
        For the regression that ``augmented`` and ``"buckley-james"`` use: some of `covariates`; all by default.
    stages
        ``"separate"``: one Q a stage; ``"pooled"``: one Q for each number of steps to go, on the rows of all stages.
    reg
        λ, or ``"cv"`` to choose it for each regression and block by weighted cross-validation over paths.
    num_landmarks
        For a kernel: rows whose span Q lies in, at most; with as many as there are different rows, it is exact.
    gamma
        For a kernel exp(−γ‖x − z‖²) on covariates of unit variance: γ; 1/F by default.
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
        Weight of every stage in eq. 3.
    diagnostics_ : WeightDiagnostics
        Effective sample size, largest weight, share truncated.
    cut_model_ : CutModel or None
        Ĝ; None without one.
    kernel_map_ : KernelMap or None
        Features of the kernel; None for a linear Q.
    grasp_ : GraspModel or None
        For a table: what tells the chance of a grasp.
    policy_ : FlatPolicy or LinearTablePolicy
        The policy that was learned, with nothing of the learner; the latter for a table.

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
    cut_model_: CutModel | None
    kernel_map_: KernelMap | None
    grasp_: GraspModel | None
    policy_: Any

    def __init__(
        self,
        horizon: int,
        actions: Sequence[Hashable] | Mapping[int, Sequence[Hashable]] | str = TABLE,
        covariates: Sequence[str] = (),
        *,
        q_function: Literal["linear", "kernel"] | str = "linear",
        censoring: str | CensoringModel = "kaplan-meier",
        censoring_by: CensoringBy | str = "path",
        censoring_covariates: Sequence[str] | None = None,
        augmented: bool = False,
        outcome_covariates: Sequence[str] | None = None,
        stages: StageMode | str = "separate",
        reg: float | int | Literal["cv"] | str = "cv",
        num_landmarks: int = 200,
        gamma: float | int | None = None,
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
        self.censoring_by = censoring_by
        self.censoring_covariates = censoring_covariates
        self.augmented = augmented
        self.outcome_covariates = outcome_covariates
        self.stages = stages
        self.reg = reg
        self.num_landmarks = num_landmarks
        self.gamma = gamma
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

    def fit(self, logs: Logs | LogStream) -> "CensoredQLearner":
        """Learn from a log.

        Parameters
        ----------
        logs
            The log. A `LogStream` is read in passes, one for each stage and one before, and never held whole. What is
            learned is the same (a kernel's landmarks are sought in the first part), but Ĝ must be on the clock of
            paths (``censoring_by="path"``), targets weighted, no variance reduced, and a grasp model fitted already.

        Raises
        ------
        ArgumentError
            A parameter has a value that it cannot take.
        LogError
            The log lacks a column, is longer than the horizon, or holds an action that was not possible.
        PositivityError
            All paths were cut, or a weight is not identified.
        """
        check_parameters(self, self._is_table)
        if isinstance(logs, LogStream):
            return self._fit_stream(logs)
        if logs.horizon > self.horizon:
            raise ArgumentError(f"horizon is {self.horizon}, but a path has {logs.horizon} stages; raise horizon")
        self.grasp_ = grasp_model_of(self.grasp, logs, self.horizon) if self._is_table else None
        paths = self.lay_out(logs)
        refuse_all_cut(paths.is_finished)
        self.cut_model_ = self.fit_cuts(paths)
        self.kernel_map_ = self._kernel_map(paths)
        log = self.transitions(paths, self.cut_model_)
        self.weights_ = np.asarray(log.weight)
        self.diagnostics_ = weight_diagnostics(self.weights_, self.truncate_at)
        self.q_functions_ = self.fit_transitions(log)
        self.policy_ = self.as_policy(self.q_functions_)
        return self

    def _fit_stream(self, stream: LogStream) -> "CensoredQLearner":
        """Learn in passes; the first one also gathers what Ĝ and the kernel need."""
        check_streamable(self)
        finished = (stream.paths["ending"] == FINISHED).to_numpy(dtype=bool)
        refuse_all_cut(finished)
        self.grasp_, self.kernel_map_, self.cut_model_ = None, None, None
        if self._is_table:
            self.grasp_ = grasp_model_of(self.grasp, next(iter(stream)), self.horizon)
        first, names = [], ()
        for part in stream:
            if part.horizon > self.horizon:
                raise ArgumentError(f"horizon is {self.horizon}, but a path has {part.horizon} stages; raise horizon")
            paths = self.lay_out(part)
            self.kernel_map_ = self.kernel_map_ or self._kernel_map(paths)
            first.append(paths.covariates[:, 0])
            names = paths.covariate_names
        if not self._is_unweighted:
            ends = stream.paths["end_s"].to_numpy(), finished
            cuts = fit_path_cuts(*ends, np.concatenate(first), names, self.censoring, self.truncate_at)
            self.cut_model_ = cuts
        fold, weights = self._folds(stream.num_paths), []

        def parts() -> Iterator[Transitions]:
            start, weights[:] = 0, []
            for part in stream:
                paths = self.lay_out(part)
                weight, _ = self.weights_and_imputation(paths, self.cut_model_)
                weights.append(weight)
                yield self._weighted(paths, weight, None, fold[start : start + paths.num_paths])
                start += paths.num_paths

        setting = self.regs, self._stage_mode, self.num_folds_for(stream.num_paths), self.horizon
        is_scaled = self.q_function == "linear"
        self.q_functions_ = fit_stream(parts, stream.num_paths, self.encoding, *setting, is_scaled)
        self.weights_ = np.concatenate(weights)
        if self.reg == "cv":
            refuse_too_few(self.weights_)
        self.diagnostics_ = weight_diagnostics(self.weights_, self.truncate_at)
        self.policy_ = self.as_policy(self.q_functions_)
        return self

    def lay_out(self, logs: Logs) -> PathArrays:
        """Lay out a log as the arrays that this learner looks at."""
        return path_arrays(logs, self.encoding.encode(logs), self._cut_covariates(logs))

    def transitions(self, paths: PathArrays, cut_model: CutModel | None) -> Transitions:
        """Make the rows of eq. 3 of a log, with the weights and targets that a model of its cuts gives."""
        weight, imputed = self.weights_and_imputation(paths, cut_model)
        fold = self._folds(paths.num_paths)
        return self._weighted(paths, weight, imputed, fold)

    def _weighted(
        self,
        paths: PathArrays,
        weight: Float[np.ndarray, "n T"],
        imputed: Imputation | None,
        fold: Int[np.ndarray, " n"],
    ) -> Transitions:
        reward, surprises = paths.reward, None
        if self.reduces_variance:
            seen = np.where(paths.is_completed, weight, 0.0)
            reward = expected_rewards(reward, seen, paths.is_last, wash_outcomes(paths.encoded))
            surprises = label_surprises(paths.encoded)
        return Transitions(
            features=self._features(paths),
            is_possible=paths.is_possible,
            action=paths.action,
            reward=reward,
            weight=weight,
            is_last=paths.is_last,
            fold=fold,
            surprises=surprises,
            imputation=imputed,
        )

    def fit_cuts(self, paths: PathArrays) -> CutModel | None:
        """Fit Ĝ as the parameters say; None where nothing is weighted."""
        if self._is_unweighted:
            return None
        by: Any = self.censoring_by
        return fit_cut_model(paths, self.censoring, by, self.truncate_at)

    def weights_and_imputation(
        self, paths: PathArrays, cut_model: CutModel | None
    ) -> tuple[Float[np.ndarray, "n T"], Imputation | None]:
        """Weight of each stage in eq. 3; and what its target is imputed from, if it is."""
        imputed = self._imputation(paths, cut_model)
        if cut_model is not None:
            return cut_model.begun_weights(paths) if self.augmented else cut_model.weights(paths), imputed
        return (paths.is_completed if imputed is None else paths.is_begun).astype(np.float64), imputed

    def _folds(self, num_paths: int) -> Int[np.ndarray, " n"]:
        return np.random.default_rng(self.random_state).permutation(num_paths) % self.num_folds_for(num_paths)

    def fit_transitions(self, log: Transitions) -> QFunctions:
        """Run eq. 3 on one log, or on a batch of logs."""
        if self.reg == "cv":
            refuse_too_few(np.asarray(log.weight))
        num_folds = self.num_folds_for(log.weight.shape[-2])
        return fit_q_functions(log, self.encoding, self.regs, self._stage_mode, num_folds, self.q_function == "linear")

    def as_policy(self, q_functions: QFunctions) -> Any:
        """Turn Q-functions, or a batch of them, into the policy that follows them."""
        if self._is_table:
            policy = as_policy(q_functions, self._stage_mode)
            return replace(policy, grasp=self.grasp_, kernel_map=single_precision(self.kernel_map_))
        encoding = self._flat_encoding()
        by_stage = q_functions.coefficients
        return FlatPolicy(
            actions=tuple(encoding.names),
            covariates=tuple(self.covariates),
            is_possible=np.stack([encoding.possible(stage) for stage in range(1, self.horizon + 1)]),
            coefficients=np.asarray(by_stage if self.stages == "separate" else by_stage[..., ::-1, :, :]),
            kernel_map=self.kernel_map_,
        )

    def q_values(self, frame: pd.DataFrame, stage: int) -> Float[np.ndarray, "m A"]:
        """Q̂ of every action in a stage (from 1), for each row of covariates; flat actions only."""
        self._flat_encoding()
        check_is_fitted(self, "policy_")
        return self.policy_.q_values(frame, stage)

    def decide(self, frame: pd.DataFrame, stage: int) -> np.ndarray:
        """Name the possible action with the largest Q̂, for each row of covariates; flat actions only."""
        self._flat_encoding()
        check_is_fitted(self, "policy_")
        return self.policy_.decide(frame, stage)

    @property
    def encoding(self) -> Encoding:
        """How states and actions become features; for a table, with the grasp model that was fitted."""
        return TableEncoding(self.horizon, self.grasp_) if self._is_table else self._flat_encoding()

    @property
    def regs(self) -> Float[np.ndarray, " L"]:
        """The λ to choose from."""
        if self.reg != "cv":
            return np.array([float(self.reg)])
        return REGS if self.q_function == "linear" else KERNEL_REGS

    def backward_options(self, num_paths: int) -> dict[str, Any]:
        """Collect what the recursion is compiled for, on so many paths."""
        is_scaled = self.q_function == "linear"
        return backward_options(self.encoding, self._stage_mode, self.num_folds_for(num_paths), is_scaled)

    def num_folds_for(self, num_paths: int) -> int:
        """Folds that so many paths are dealt into; one where nothing is chosen."""
        return min(self.num_folds, num_paths) if self.reg == "cv" else 1

    @property
    def _is_table(self) -> bool:
        return isinstance(self.actions, str) and self.actions == TABLE

    @property
    def _is_unweighted(self) -> bool:
        return isinstance(self.censoring, str) and self.censoring in (NONE, BUCKLEY_JAMES)

    @property
    def _stage_mode(self) -> StageMode:
        return "pooled" if self.stages == "pooled" else "separate"

    def _flat_encoding(self) -> FlatEncoding:
        if isinstance(self.actions, str):
            raise ArgumentError(
                f"actions is {self.actions!r}: a table's policy decides, ask policy_; or name the actions"
            )
        return FlatEncoding(self.horizon, self.actions, self.covariates)

    def _cut_covariates(self, logs: Logs) -> pd.DataFrame | None:
        if self._is_unweighted or not uses_covariates(named_model(self.censoring)):
            return None
        by_path = self.censoring_by == "path"
        chosen = self.censoring_covariates
        if self._is_table:
            return table_covariates(logs, chosen or TABLE_COVARIATES[: 2 if by_path else None])
        chosen = chosen or [*self.covariates, *([] if by_path else [ACTION])]
        return flat_covariates(logs, chosen, self._flat_encoding().names)

    def _imputation(self, paths: PathArrays, cut_model: CutModel | None) -> Imputation | None:
        is_buckley_james = isinstance(self.censoring, str) and self.censoring == BUCKLEY_JAMES
        if not self.augmented and not is_buckley_james:
            return None
        blocks = self.encoding.block_of_action(paths.is_possible.shape[-1])
        is_used = np.ones(paths.features.shape[-1])
        if self.outcome_covariates is not None:
            is_used = np.isin(np.array(self.covariates), list(self.outcome_covariates)).astype(np.float64)
        kind = "augmented" if self.augmented else "buckley-james"
        imputed = imputation(paths, kind, cut_model, self._stage_mode, is_used, blocks)
        if self.kernel_map_ is None:
            return imputed
        return imputed._replace(is_used=np.ones(self.kernel_map_.projection.shape[1]))

    def _kernel_map(self, paths: PathArrays) -> KernelMap | None:
        if self.q_function == "linear":
            return None
        taken = np.take_along_axis(paths.features, paths.action[..., None, None], axis=2)[:, :, 0]
        rng = np.random.default_rng(self.random_state)
        return fit_kernel_map(taken[paths.is_completed], self.num_landmarks, self.gamma, rng)

    def _features(self, paths: PathArrays) -> Float[np.ndarray, "n T A F"]:
        if self.kernel_map_ is None:
            return paths.features
        if self._is_table:
            return np.asarray(self.kernel_map_(paths.features))
        return np.repeat(self.kernel_map_(paths.features[:, :, :1]), paths.features.shape[2], axis=2)
