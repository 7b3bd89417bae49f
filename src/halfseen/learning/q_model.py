"""The model that turns a log into the transitions of eq. 3, and these into Q.

It is composed once; the learner, the bootstrap, the study and off-policy evaluation all start from a `QModel`.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from halfseen.censoring import CensoringSpec, CutModel
from halfseen.censoring.clocks import StageClocks
from halfseen.errors import ArgumentError
from halfseen.estimator import is_count
from halfseen.learning.behaviour import fit_choice, seen_among
from halfseen.learning.imputation import DurationModel, fit_duration_model, imputation
from halfseen.learning.named_task import NamedActions
from halfseen.learning.q_space import (
    CrossValidation,
    KernelMap,
    LinearQ,
    QSpace,
    Reg,
    StageMode,
    TabularQ,
)
from halfseen.learning.recursion import QFunctions, fit_q
from halfseen.learning.rows import (
    Imputation,
    Support,
    TrajectoryArrays,
    Transitions,
    refuse_all_cut,
    refuse_far,
    refuse_too_few,
    refuse_vanishing,
    support_of,
    trajectory_arrays,
)
from halfseen.learning.sample import recency_weights, sampled
from halfseen.learning.stage_trend import StageTrend, stage_trend_of
from halfseen.learning.sums import Regression
from halfseen.learning.tabular import StateActions, fit_table
from halfseen.learning.targets import Targets, Weighted
from halfseen.learning.task import LearnedQ, RewardedStages, Task
from halfseen.logs import Logs, LogStream
from halfseen.shapes import Bool, Float, Int
from halfseen.workers.threads import one_thread

MOST_WORK = 1e8
"""Largest K·F³, for K blocks of F features, of a Q chosen by default; a fit takes seconds. Twenty covariates of three
actions, or eight of sixteen, are smooth; thirty-two of sixteen are linear."""
MOST_MEMORY = 4e9
"""Limit for sums over rows [bytes]."""
NUM_SUMS = 4
"""Matrices of sums for each fold and block (`sums.Moments`)."""


def checked_log(logs: Any, kind: Any = Logs | LogStream) -> Any:
    """Refuse what is no log of this kind; return the log."""
    if not isinstance(logs, kind):
        or_stream = "" if kind is Logs else ", or a LogStream"
        raise ArgumentError(f"logs is a {type(logs).__name__}; give Logs, as read_logs returns{or_stream}")
    return logs


@dataclass(frozen=True)
class QModel:
    """How Q is fitted: the checked parameters of `CensoredQLearner`, and what is fitted before Q."""

    horizon: int
    task: Task
    targets: Targets = Weighted()  # noqa: RUF009 - frozen
    space: QSpace = LinearQ()  # noqa: RUF009 - frozen
    reg: Reg = CrossValidation()  # noqa: RUF009 - frozen
    stages: StageMode = "separate"
    random_state: int = 0
    cut_model: CutModel | None = None
    """Ĝ, once fitted."""
    kernel_map: KernelMap | None = None
    """Features of the RKHS, once chosen."""
    support: Support | None = None
    """What was completed in the log, once counted."""
    pessimism: float = 0.0
    """Standard errors by which Q is lowered wherever a maximum is taken, in eq. 3 and by the policy."""
    behaviour: Float[np.ndarray, "K G"] | None = None
    """Coefficients of the behaviour policy, once fitted; needed for pessimism only."""
    durations: DurationModel | None = None
    """Model of the durations of stages if fitted beforehand, as for a log in parts; None to fit it to each log."""
    is_space_free: bool = False
    """Whether 𝒬 is a default, to be replaced by a linear one if it would take too long."""
    space_chosen: tuple[str, ...] = ()
    """Why it was replaced."""
    has_many_actions: bool = False
    """Whether the Q of each action is shrunk towards a fit common to all actions, rather than towards 0, and the policy
    towards the behaviour policy (`behaviour`)."""
    behaviour_weight: float = 0.0
    """τ of that preference, once estimated."""
    stage_trend: StageTrend | None = None
    """How effects change over pooled stages; None if they do not."""
    half_life: float | str | None = None
    """Trajectories over which the weight in eq. 3 halves (`sample`); ``"auto"`` until it is chosen, None for equal
    weights."""

    def __post_init__(self) -> None:
        if not is_count(self.horizon):
            raise ArgumentError(f"horizon is {self.horizon!r}; give a whole number of stages, at least 1")

    def fitted(self, logs: Logs) -> tuple["QModel", TrajectoryArrays]:
        """Fit to a log what comes before Q: the task, Ĝ, and the features of the kernel."""
        self.check_horizon(logs)
        rows = sampled(logs.num_trajectories, self.random_state)
        some = logs if len(rows) == logs.num_trajectories else logs.select(logs.trajectory_ids[rows])
        model = self.with_task([logs], some)
        trajectories = model.lay_out(logs)
        refuse_all_cut(trajectories.clocks.is_finished)
        model = model.with_clocks(trajectories.clocks, model.support_in(trajectories))
        return model.with_sample(model.sample_of(trajectories)), trajectories

    def check_horizon(self, logs: Logs) -> None:
        """Refuse a log whose trajectories are longer than the horizon."""
        if logs.horizon > self.horizon:
            raise ArgumentError(f"horizon is {self.horizon}, but a trajectory has {logs.horizon} stages; raise horizon")

    def with_task(self, parts: Iterable[Logs], sample: Logs) -> "QModel":
        """Fit the task to a sample, but its categories to all parts."""
        task = self.task
        if isinstance(task, NamedActions):
            return replace(self, task=task.fitted_to_parts(parts, sample.filling))
        return replace(self, task=task.fitted(sample, self.horizon))

    def sample_of(self, trajectories: TrajectoryArrays) -> TrajectoryArrays:
        """Sample of trajectories for what cannot be computed from sums (`sample`)."""
        rows = sampled(trajectories.num_trajectories, self.random_state)
        return trajectories if len(rows) == trajectories.num_trajectories else trajectories.take(rows)

    def with_clocks(self, clocks: StageClocks, support: Support) -> "QModel":
        """Fit Ĝ to the clocks of a log, and keep the log's support."""
        return replace(self, cut_model=self.targets.fit_cuts(clocks), support=support)

    def with_sample(self, trajectories: TrajectoryArrays) -> "QModel":
        """Choose the features of a kernel, and fit the behaviour policy if there is a margin for it to reduce."""
        refuse_vanishing(trajectories.reward[trajectories.is_completed])
        model = self._with_affordable_space(trajectories.features.shape[-1])
        taken = trajectories.encoded.taken[trajectories.is_completed]
        if isinstance(model.space, LinearQ) and type(self.task) is NamedActions:
            refuse_far(taken, self.task.looks_at.names)
        model = replace(model, kernel_map=model.space.features(taken, self.random_state))
        model = model.with_trend(taken.shape[1]) if model.stage_trend else model
        if self.pessimism == 0 or self.has_many_actions:
            return model
        known, blocks = trajectories.is_begun & trajectories.has_action, self.blocks(trajectories.is_possible.shape[-1])
        found = fit_choice(
            trajectories.features[known], trajectories.is_possible[known], trajectories.action[known], blocks
        )
        return replace(model, behaviour=found)

    def with_trend(self, num_inputs: int) -> "QModel":
        """Pool the stages, with a trend over them."""
        return replace(self, stages="pooled", stage_trend=stage_trend_of(self.kernel_map, num_inputs))

    @property
    def num_blocks(self) -> int:
        """Number K of blocks of coefficients."""
        return 1 if self.is_joint else len(self.task.block_names)

    def is_affordable(self, num_inputs: int) -> bool:
        """Whether a Q with this many inputs can be fitted in seconds."""
        return self.num_blocks * self._num_features(num_inputs) ** 3 <= MOST_WORK

    def _num_features(self, num_inputs: int) -> int:
        return self.space.num_features(num_inputs) + (1 + num_inputs if self.stage_trend else 0)

    def _with_affordable_space(self, num_inputs: int) -> "QModel":
        """Replace a default 𝒬 that is too large by a linear one; refuse a Q that does not fit in memory."""
        num_blocks, num_features = self.num_blocks, self._num_features(num_inputs)
        if self.is_space_free and not self.is_affordable(num_inputs):
            why = f"Q is linear: a smooth Q would have {num_features} features for each of {num_blocks} actions"
            return replace(self, space=LinearQ(), space_chosen=(why,))
        # Pooled stages have two slices: rows that go on, and rows that the horizon ended.
        num_slices = self.horizon if self.stages == "separate" else 2
        num_folds = self.reg.num_folds if isinstance(self.reg, CrossValidation) else 1
        needed = 8.0 * NUM_SUMS * num_folds * num_slices * num_blocks * (1 + num_features) ** 2
        if needed > MOST_MEMORY:
            raise ArgumentError(
                f"q_function is {self.space.name!r}: {num_features} features for each of {num_blocks} actions take "
                f"{needed / 1e9:.0f} GB, and {MOST_MEMORY / 1e9:.0f} GB are allowed; leave covariates out, group their "
                "categories, or choose 'linear' or KernelQ(num_landmarks=…)"
            )
        return self

    def with_durations(self, trajectories: TrajectoryArrays) -> "QModel":
        """Fit the durations of stages, if targets are imputed."""
        return replace(self, durations=self._durations_of(trajectories)) if self.targets.is_imputed else self

    def support_in(self, trajectories: TrajectoryArrays) -> Support:
        """Count what was completed in a log."""
        return support_of(trajectories, self.kinds(trajectories.is_possible.shape[-1]), len(self.task.block_names))

    @property
    def is_joint(self) -> bool:
        """Whether one block of coefficients serves all kinds of actions, because features distinguish them."""
        return bool(getattr(self.task, "is_joint", False))

    def blocks(self, num_actions: int) -> Int[np.ndarray, " A"]:
        """Block of coefficients of each action."""
        kinds = self.kinds(num_actions)
        return np.zeros_like(kinds) if self.is_joint else kinds

    def kinds(self, num_actions: int) -> Int[np.ndarray, " A"]:
        """Kind of each action, among `Task.block_names`: the unit for which the log needs completed stages."""
        return np.asarray(self.task.block_of_action(num_actions))

    def lay_out(self, logs: Logs) -> TrajectoryArrays:
        """Convert a log to the arrays that this model uses."""
        covariates, spec = None, self.targets
        if isinstance(spec, CensoringSpec) and spec.uses_covariates:
            covariates = self.task.censoring_covariates(logs, spec.covariates, spec.by == "trajectory")
        return trajectory_arrays(logs, self.task.encode(logs, self.horizon), covariates)

    def transitions(self, trajectories: TrajectoryArrays) -> Transitions:
        """Make the transitions of eq. 3 from a log."""
        given = self.weights_and_imputation(trajectories)
        return self.weighted(trajectories, *given, self.folds(trajectories.num_trajectories))

    def weights_and_imputation(
        self, trajectories: TrajectoryArrays, is_fitted: Bool[np.ndarray, " n"] | None = None
    ) -> tuple[Float[np.ndarray, "n T"], Imputation | None]:
        """Weight of each stage in eq. 3; and what its target is imputed from, if it is, fitted to some or all."""
        imputed = None
        if self.targets.is_imputed:
            blocks = self.blocks(trajectories.is_possible.shape[-1])
            durations = self.durations or self._durations_of(trajectories, is_fitted)
            imputed = imputation(trajectories, self.cut_model, self._outcome_features(trajectories), blocks, durations)
            if self.kernel_map is not None:
                imputed = imputed._replace(is_used=np.ones(self.kernel_map.num_features))
            if self.stage_trend is not None:
                imputed = self.stage_trend.used_by(imputed)
        return self.targets.weights(trajectories, self.cut_model), imputed

    def weighted(
        self,
        trajectories: TrajectoryArrays,
        weight: Float[np.ndarray, "n T"],
        imputed: Imputation | None,
        fold: Int[np.ndarray, " n"],
    ) -> Transitions:
        """Make the transitions of eq. 3 with given weights and folds."""
        reward, variates = self.task.reduce_variance(self.rewarded(trajectories, weight))
        is_possible = trajectories.is_possible
        features = trajectories.features[:, :, :1] if self.task.is_shared else trajectories.features
        features = features if self.kernel_map is None else np.asarray(self.kernel_map(features))
        if self.stage_trend is not None:
            features = np.concatenate([features, self.stage_trend.of(features)], axis=-1)
        if self.support is not None:
            seen = self.support.is_seen(self.stages)[:, self.kinds(is_possible.shape[-1])]
            is_possible = np.asarray(seen_among(is_possible, seen))
        return Transitions(
            features=features,
            is_possible=is_possible,
            action=trajectories.action,
            reward=reward,
            weight=weight,
            is_last=trajectories.is_last,
            fold=fold,
            control_variates=variates,
            policy=trajectories.encoded.policy,
            imputation=imputed,
        )

    def recent(self, log: Transitions, first: int = 0, num_trajectories: int | None = None) -> Transitions:
        """Apply the half-life, if any, to trajectories that start at number `first` of a log of `num_trajectories`."""
        if not isinstance(self.half_life, float):
            return log
        weights = recency_weights(num_trajectories or len(log.action), self.half_life)
        return log.counted(weights[first : first + len(log.action)])

    def rewarded(self, trajectories: TrajectoryArrays, weight: Float[np.ndarray, "n T"]) -> RewardedStages:
        """Rewards and weights of stages; cut stages have weight 0."""
        observed = np.where(trajectories.is_completed, weight, 0.0)
        return RewardedStages(trajectories.encoded, trajectories.reward, observed, trajectories.is_last)

    def fit(self, log: Transitions) -> QFunctions:
        """Run eq. 3 on a log."""
        num_trajectories, _, num_actions = log.is_possible.shape
        if isinstance(self.reg, CrossValidation):
            refuse_too_few(int((log.weight > 0).any(axis=-1).sum()), num_trajectories)
        if isinstance(self.space, TabularQ):
            if not isinstance(self.task, StateActions):
                raise ArgumentError("q_function is 'tabular', which needs named actions; choose another")
            return fit_table(log, self.task.num_states, None if isinstance(self.reg, CrossValidation) else self.reg)
        with one_thread():
            return fit_q(log, self.regression(num_trajectories, num_actions))

    def policy(self, q_functions: QFunctions) -> Any:
        """Turn Q-functions, or a batch of them, into the policy that follows them."""
        if self.stage_trend is not None:
            q_functions = self.stage_trend.at_stages(q_functions)
        coefficients, root = q_functions.coefficients, q_functions.root
        seen = None if self.support is None else self.support.is_seen(self.stages)
        if self.stages == "separate":
            coefficients, seen = coefficients[..., ::-1, :, :], None if seen is None else seen[::-1]
            root = None if root is None else root[..., ::-1, :, :, :]
        margin = None if root is None else self.pessimism * np.asarray(root)
        return self.task.policy(
            LearnedQ(coefficients, self.kernel_map, seen, margin, self.behaviour, self.behaviour_weight)
        )

    @property
    def chosen(self) -> tuple[str, ...]:
        """What was chosen automatically, and why."""
        return (*self.space_chosen, *getattr(self.task, "chosen", ()))

    def regression(self, num_trajectories: int, num_actions: int) -> Regression:
        """Describe how each step of eq. 3 is fitted."""
        return Regression(
            block_of_action=self.blocks(num_actions),
            num_blocks=self.num_blocks,
            regs=self.space.regs if isinstance(self.reg, CrossValidation) else np.array([self.reg]),
            num_folds=self._num_folds(num_trajectories),
            stages=self.stages,
            end_action=self.task.end_action if self.stages == "pooled" else None,
            is_scaled=self.space.is_scaled,
            pessimism=self.pessimism,
            is_partially_pooled=self.has_many_actions,
        )

    def folds(self, num_trajectories: int) -> Int[np.ndarray, " n"]:
        """Assign trajectories to folds, uniformly at random; without cross-validation there is one fold."""
        order = np.random.default_rng(self.random_state).permutation(num_trajectories)
        return order % self._num_folds(num_trajectories)

    def _num_folds(self, num_trajectories: int) -> int:
        return min(self.reg.num_folds, num_trajectories) if isinstance(self.reg, CrossValidation) else 1

    def _durations_of(
        self, trajectories: TrajectoryArrays, is_fitted: Bool[np.ndarray, " n"] | None = None
    ) -> DurationModel:
        blocks = self.blocks(trajectories.is_possible.shape[-1])
        among = None if is_fitted is None else is_fitted[sampled(trajectories.num_trajectories, self.random_state)]
        return fit_duration_model(self.sample_of(trajectories), self._outcome_features(trajectories), blocks, among)

    def _outcome_features(self, trajectories: TrajectoryArrays) -> Float[np.ndarray, " F"]:
        names = self.targets.outcome_covariates
        if names is None:
            return np.ones(trajectories.features.shape[-1])
        if not isinstance(self.space, LinearQ):
            raise ArgumentError("outcome_covariates is given, but selects covariates of a linear Q only; leave it out")
        return self.task.outcome_features(names)
