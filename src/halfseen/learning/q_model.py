"""All that turns a log into the rows of eq. 3 and these into Q: composed once, used by whoever fits a Q.

The learner, the bootstrap, streams and off-policy evaluation all start from a `QModel`.

*Support.* An action of a block without completed stages has no value, which is not the value 0. It is impossible for
the maximum in eq. 3 and for the policy. Only where a state allows nothing that was seen do all actions stay that it
allows.

*Sample.* Eq. 3 itself runs on sums, to which every path adds. But landmarks of a kernel, durations of stages, the
behaviour policy, the grasp model of a table and the choice of stages are fitted by methods that hold what they look at.
Of a log of many paths, so many of them tell these as well as all would, in memory and in passes alike.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from halfseen.censoring import CensoringSpec, CutModel
from halfseen.errors import ArgumentError, PositivityError
from halfseen.learning.behaviour import behaviour_of
from halfseen.learning.choice import seen_among
from halfseen.learning.imputation import DurationModel, fit_duration_model, imputation
from halfseen.learning.named_task import NamedActions
from halfseen.learning.q_space import CrossValidation, KernelMap, LinearQ, QSpace, Reg, StageMode
from halfseen.learning.recursion import Regression, fit_q
from halfseen.learning.rows import Imputation, PathArrays, QFunctions, Transitions, path_arrays
from halfseen.learning.targets import Targets, Weighted
from halfseen.learning.task import LearnedQ, RewardedStages, Task
from halfseen.logs import Logs
from halfseen.workers.threads import one_thread

MOST_PATHS = 2_000
"""Paths of the sample; of a log that has no more, it is the log."""


def sampled(num_paths: int, seed: int, most: int | None = None) -> Int[np.ndarray, " k"]:
    """Draw rows of paths, increasing and without replacement.

    Parameters
    ----------
    num_paths
        n.
    seed
        Of the draw.
    most
        Paths to draw, if there are as many; None for `MOST_PATHS`.

    Examples
    --------
    >>> sampled(3, seed=0)
    array([0, 1, 2])
    """
    size = MOST_PATHS if most is None else most
    if num_paths <= size:
        return np.arange(num_paths)
    return np.sort(np.random.default_rng([seed, 4]).choice(num_paths, size, replace=False))


class Support(NamedTuple):
    """How often each block was begun and completed in each stage; support of parts of a log adds up."""

    num_begun: Int[np.ndarray, "T K"]
    num_completed: Int[np.ndarray, "T K"]
    is_allowed: Bool[np.ndarray, "T K"]
    """Blocks that some state of the stage allowed."""

    def plus(self, other: "Support") -> "Support":
        """Join what another part of the log has seen."""
        begun, completed = self.num_begun + other.num_begun, self.num_completed + other.num_completed
        return Support(begun, completed, self.is_allowed | other.is_allowed)

    def is_seen(self, stages: StageMode) -> Bool[np.ndarray, "T K"]:
        """Blocks that have a value: seen completed in the stage, or anywhere where stages are pooled."""
        seen = self.num_completed > 0
        return np.broadcast_to(seen.any(axis=0), seen.shape) if stages == "pooled" else seen


def support_of(paths: PathArrays, blocks: Int[np.ndarray, " A"], num_blocks: int) -> Support:
    """Count what a log has seen.

    Parameters
    ----------
    paths
        The log.
    blocks
        Block of each action.
    num_blocks
        K.
    """
    known = paths.is_begun & paths.has_action
    is_block = blocks[paths.action][..., None] == np.arange(num_blocks)
    of_block = blocks[:, None] == np.arange(num_blocks)
    return Support(
        num_begun=(is_block & known[..., None]).sum(axis=0),
        num_completed=(is_block & (known & paths.is_completed)[..., None]).sum(axis=0),
        is_allowed=(paths.is_possible & paths.is_begun[..., None]).any(axis=0) @ of_block,
    )


def unseen_in_words(support: Support, names: tuple[str, ...], stages: StageMode) -> list[str]:
    """Say of each block that was allowed and never seen completed where that was, and how often it was begun."""
    reached: Bool[np.ndarray, "T 1"] = np.any(support.num_completed > 0, axis=1, keepdims=True)
    lacking = support.is_allowed & ~support.is_seen(stages) & reached
    told = []
    for block in np.flatnonzero(lacking.any(axis=0)):
        rows = np.flatnonzero(lacking[:, block])
        begun = int(support.num_begun[rows, block].sum())
        where = "" if stages == "pooled" else f" in stage {', '.join(str(row + 1) for row in rows)}"
        cut = f"begun {begun} times and cut each time" if begun else "never taken"
        told.append(
            f"{names[block]} was never seen completed{where} ({cut}), so its value is not known and the policy never "
            "takes it there; to learn it, log it uniformly at random now and then"
        )
    return told


def is_count(value: object) -> bool:
    """Whether a value is a whole number, 1 or above."""
    return isinstance(value, int | np.integer) and not isinstance(value, bool) and int(value) >= 1


@dataclass(frozen=True)
class QModel:
    """How Q is fitted.

    Parameters
    ----------
    horizon
        T.
    task
        What is decided.
    targets
        What stands for what cuts took away.
    space
        𝒬.
    reg
        λ.
    stages
        ``"separate"`` or ``"pooled"``.
    random_state
        Seed that deals paths into folds and draws landmarks.
    cut_model
        Ĝ, once it is fitted.
    kernel_map
        Features of the RKHS, once they are chosen.
    support
        What the log has seen completed, once it was looked at.
    pessimism
        Standard errors of Q by which it is lowered wherever the largest is sought, in eq. 3 and by the policy.
    behaviour
        Coefficients of the behaviour policy, once it is fitted, which is for pessimism alone.
    durations
        How long stages last, where that is fitted beforehand, as for a log in parts; None to fit it to each log.

    Raises
    ------
    ArgumentError
        The horizon is below 1, or no whole number.
    """

    horizon: int
    task: Task
    targets: Targets = Weighted()  # noqa: RUF009 - frozen
    space: QSpace = LinearQ()  # noqa: RUF009 - frozen
    reg: Reg = CrossValidation()  # noqa: RUF009 - frozen
    stages: StageMode = "separate"
    random_state: int = 0
    cut_model: CutModel | None = None
    kernel_map: KernelMap | None = None
    support: Support | None = None
    pessimism: float = 0.0
    behaviour: Float[np.ndarray, "K G"] | None = None
    durations: DurationModel | None = None

    def __post_init__(self) -> None:
        if not is_count(self.horizon):
            raise ArgumentError(f"horizon is {self.horizon!r}; a path has a whole number of stages, at least 1")

    def fitted(self, logs: Logs) -> tuple["QModel", PathArrays]:
        """Fit to a log what comes before Q: what the task learns, Ĝ, and the features of the kernel.

        Raises
        ------
        ArgumentError
            A path is longer than the horizon, or a part cannot be fitted.
        PositivityError
            All paths were cut.
        """
        self.check_horizon(logs)
        rows = sampled(logs.num_paths, self.random_state)
        some = logs if len(rows) == logs.num_paths else logs.select(logs.path_ids[rows])
        model = self.with_task([logs], some)
        paths = model.lay_out(logs)
        refuse_all_cut(paths.clocks.is_finished)
        sample = model.sample_of(paths)
        return model.with_kernel(sample).with_cuts(paths).with_behaviour(sample), paths

    def with_task(self, parts: Iterable[Logs], sample: Logs) -> "QModel":
        """Fit what the task learns to a sample; but what categories there are only all parts can tell."""
        task = self.task
        fitted = task.fitted_to_parts(parts) if isinstance(task, NamedActions) else task.fitted(sample, self.horizon)
        return replace(self, task=fitted)

    def sample_of(self, paths: PathArrays) -> PathArrays:
        """Paths that decide on what is no sum (see above)."""
        rows = sampled(paths.num_paths, self.random_state)
        return paths if len(rows) == paths.num_paths else paths.take(rows)

    def with_cuts(self, paths: PathArrays) -> "QModel":
        """Fit Ĝ, and look at what was seen completed."""
        return replace(self, cut_model=self.targets.fit_cuts(paths.clocks), support=self.support_in(paths))

    def with_behaviour(self, paths: PathArrays) -> "QModel":
        """Fit the behaviour policy, if there is a margin that it may waive."""
        if self.pessimism == 0:
            return self
        return replace(self, behaviour=behaviour_of(paths, self.blocks(paths.is_possible.shape[-1])))

    def support_in(self, paths: PathArrays) -> Support:
        """Count what a log has seen completed."""
        return support_of(paths, self.kinds(paths.is_possible.shape[-1]), len(self.task.block_names))

    @property
    def num_blocks(self) -> int:
        """Blocks of coefficients: one a kind of action, or a single one where features tell kinds apart."""
        return 1 if _is_joint(self.task) else len(self.task.block_names)

    def blocks(self, num_actions: int) -> Int[np.ndarray, " A"]:
        """Block of coefficients of each action."""
        kinds = self.kinds(num_actions)
        return np.zeros_like(kinds) if _is_joint(self.task) else kinds

    def kinds(self, num_actions: int) -> Int[np.ndarray, " A"]:
        """Kind of each action, among `Task.block_names`: what the log has to have seen completed."""
        return np.asarray(self.task.block_of_action(num_actions))

    def has_value(self, allowed: Bool[np.ndarray, "*n T A"]) -> Bool[np.ndarray, "*n T A"]:
        """Which of the allowed actions have a value."""
        if self.support is None:
            return allowed
        seen = self.support.is_seen(self.stages)[:, self.kinds(allowed.shape[-1])]
        return np.asarray(seen_among(allowed, seen))

    def check_horizon(self, logs: Logs) -> None:
        """Refuse a log with longer paths."""
        if logs.horizon > self.horizon:
            raise ArgumentError(f"horizon is {self.horizon}, but a path has {logs.horizon} stages; raise horizon")

    def lay_out(self, logs: Logs) -> PathArrays:
        """Lay out a log as the arrays that this model looks at."""
        covariates, spec = None, self.targets
        if isinstance(spec, CensoringSpec) and spec.uses_covariates:
            covariates = self.task.censoring_covariates(logs, spec.covariates, spec.by == "path")
        return path_arrays(logs, self.task.encode(logs, self.horizon), covariates)

    def with_kernel(self, paths: PathArrays) -> "QModel":
        """Choose the features of the kernel, if there is one."""
        return replace(self, kernel_map=self.space.features(paths.encoded.taken[paths.is_completed], self.random_state))

    def transitions(self, paths: PathArrays) -> Transitions:
        """Make the rows of eq. 3 of a log."""
        weight, imputed = self.weights_and_imputation(paths)
        return self.weighted(paths, weight, imputed, self.folds(paths.num_paths))

    def weights_and_imputation(
        self, paths: PathArrays, is_fitted: Bool[np.ndarray, " n"] | None = None
    ) -> tuple[Float[np.ndarray, "n T"], Imputation | None]:
        """Weight of each stage in eq. 3; and what its target is imputed from, if it is, fitted to some paths or all."""
        imputed = self._imputation(paths, is_fitted) if self.targets.is_imputed else None
        return self.targets.weights(paths, self.cut_model), imputed

    def weighted(
        self,
        paths: PathArrays,
        weight: Float[np.ndarray, "n T"],
        imputed: Imputation | None,
        fold: Int[np.ndarray, " n"],
    ) -> Transitions:
        """Make the rows of eq. 3 with weights and folds that are given."""
        reward, variates = self.task.reduce_variance(self.rewarded(paths, weight))
        return Transitions(
            features=self._features(paths),
            is_possible=self.has_value(paths.is_possible),
            action=paths.action,
            reward=reward,
            weight=weight,
            is_last=paths.is_last,
            fold=fold,
            control_variates=variates,
            policy=paths.encoded.policy,
            imputation=imputed,
        )

    def rewarded(self, paths: PathArrays, weight: Float[np.ndarray, "n T"]) -> RewardedStages:
        """What stages paid; those that were cut count for nothing."""
        observed = np.where(paths.is_completed, weight, 0.0)
        return RewardedStages(paths.encoded, paths.reward, observed, paths.is_last)

    def fit(self, log: Transitions) -> QFunctions:
        """Run eq. 3 on a log."""
        num_paths, _, num_actions = log.is_possible.shape
        if isinstance(self.reg, CrossValidation):
            refuse_too_few(int((log.weight > 0).any(axis=-1).sum()), num_paths)
        with one_thread():
            return fit_q(log, self.regression(num_paths, num_actions))

    def policy(self, q_functions: QFunctions) -> Any:
        """Turn Q-functions, or a batch of them, into the policy that follows them."""
        coefficients, root = q_functions.coefficients, q_functions.root
        seen = None if self.support is None else self.support.is_seen(self.stages)
        if self.stages == "separate":
            coefficients, seen = coefficients[..., ::-1, :, :], None if seen is None else seen[::-1]
            root = None if root is None else root[..., ::-1, :, :, :]
        margin = None if root is None else self.pessimism * np.asarray(root)
        learned = LearnedQ(np.asarray(coefficients), self.kernel_map, seen, margin, self.behaviour)
        return self.task.policy(learned)

    @property
    def chosen(self) -> tuple[str, ...]:
        """What the task chose by itself, and why."""
        return tuple(getattr(self.task, "chosen", ()))

    @property
    def regs(self) -> Float[np.ndarray, " L"]:
        """The λ to choose from."""
        return self.reg.regs_of(self.space)

    def regression(self, num_paths: int, num_actions: int) -> Regression:
        """Say how each step of eq. 3 is fitted, on so many paths."""
        return Regression(
            block_of_action=self.blocks(num_actions),
            num_blocks=self.num_blocks,
            regs=self.regs,
            num_folds=self.reg.folds_of(num_paths),
            stages=self.stages,
            end_action=self.task.end_action if self.stages == "pooled" else None,
            is_scaled=self.space.is_scaled,
            pessimism=self.pessimism,
        )

    def folds(self, num_paths: int) -> Int[np.ndarray, " n"]:
        """Deal paths into folds, uniformly at random."""
        return np.random.default_rng(self.random_state).permutation(num_paths) % self.reg.folds_of(num_paths)

    def with_durations(self, paths: PathArrays) -> "QModel":
        """Fit how long stages last, if targets are imputed."""
        return replace(self, durations=self._durations_of(paths)) if self.targets.is_imputed else self

    def _imputation(self, paths: PathArrays, is_fitted: Bool[np.ndarray, " n"] | None) -> Imputation:
        blocks = self.blocks(paths.is_possible.shape[-1])
        durations = self.durations or self._durations_of(paths, is_fitted)
        imputed = imputation(paths, self.cut_model, self._outcome_features(paths), blocks, durations)
        if self.kernel_map is None:
            return imputed
        return imputed._replace(is_used=np.ones(self.kernel_map.num_features))

    def _durations_of(self, paths: PathArrays, is_fitted: Bool[np.ndarray, " n"] | None = None) -> DurationModel:
        blocks, rows = self.blocks(paths.is_possible.shape[-1]), sampled(paths.num_paths, self.random_state)
        among = None if is_fitted is None else is_fitted[rows]
        return fit_duration_model(self.sample_of(paths), self._outcome_features(paths), blocks, among)

    def _outcome_features(self, paths: PathArrays) -> Float[np.ndarray, " F"]:
        names = self.targets.outcome_covariates
        if names is None:
            return np.ones(paths.features.shape[-1])
        if not isinstance(self.space, LinearQ):
            raise ArgumentError("outcome_covariates is given; it chooses among the covariates of a linear Q only")
        return self.task.outcome_features(names)

    def _features(self, paths: PathArrays) -> Float[np.ndarray, "n T E F"]:
        own = paths.features[:, :, :1] if self.task.is_shared else paths.features
        return own if self.kernel_map is None else np.asarray(self.kernel_map(own))


def refuse_all_cut(is_finished: Bool[np.ndarray, " n"]) -> None:
    """Refuse a log in which no path came to its own end.

    Raises
    ------
    PositivityError
        All were cut.
    """
    if not is_finished.any():
        raise PositivityError(
            f"all {len(is_finished)} paths were cut, so how a path ends was never seen; record until some finish, or "
            "shorten the horizon so that reaching it counts as finished"
        )


def refuse_too_few(num_seen: int, num_paths: int) -> None:
    """Refuse to hold out paths where fewer than two completed a stage.

    Raises
    ------
    ArgumentError
        The message says how many did.
    """
    if num_seen < 2:
        raise ArgumentError(
            f"reg is 'cv', which holds out paths, but {num_seen} of {num_paths} completed a stage; give a "
            "number for reg, or record more paths"
        )


def _is_joint(task: Task) -> bool:
    return bool(getattr(task, "is_joint", False))
