"""The task of an evaluation, and the models of Q and of the cuts, by default or as a stored policy was learned.

By default the four models of a doubly robust value are linear in the covariates, the stage and second-order terms, so
that each of them can be nonlinear, and stages can share one Q.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from itertools import combinations_with_replacement
from math import comb
from typing import Any, Literal

import numpy as np
import pandas as pd

from halfseen.censoring import CENSORING_NAMES
from halfseen.errors import ArgumentError
from halfseen.evaluation.targets import CrossFitted, horizon_of, refuse_other_names
from halfseen.learning.covariates import Covariates, check_numeric, fit_covariates
from halfseen.learning.discrete_policy import NamedActionPolicy
from halfseen.learning.named_task import NamedActions
from halfseen.learning.q_model import QModel
from halfseen.learning.q_space import CrossValidation, QSpace, StageMode, q_space_of, reg_of, stage_mode_of
from halfseen.learning.rows import is_far
from halfseen.learning.targets import DoublyRobust, Targets, Weighted, named_targets
from halfseen.learning.task import Task, named_task
from halfseen.logs import Logs
from halfseen.policies.folder import StoredPolicy, q_space_of_record
from halfseen.policies.folder.stored import refuse_log_of_team

LARGEST_WEIGHT = 10.0
"""Bound of 1/Ĝ by default."""

LITTLE_REG = 1e-3
"""Default λ. One chosen on held-out stages suits stages that are observed to end, and shrinks the predictions for the
others; no interval includes that bias."""


@dataclass(frozen=True)
class QSpec:
    """How Q of a policy is fitted for its evaluation.

    Parameters
    ----------
    task
        The task; None for that of the policy.
    q_function, reg
        As for `halfseen.learning.CensoredQLearner`.
    stages
        The same; None for pooled ones if stages are alike, as for tables, else separate.
    """

    task: Task | None = None
    q_function: QSpace | Literal["linear", "quadratic", "kernel", "smooth"] | str = "linear"
    stages: StageMode | str | None = None
    reg: CrossValidation | float | int | Literal["cv"] | str = "cv"

    def __post_init__(self) -> None:
        if not isinstance(self.task, Task | None):
            raise ArgumentError(f"task is {self.task!r}; give a Task, or None for that of the policy (q_function=…)")


def task_of(policy: Any, logs: Logs) -> Task:
    """Find the task of a policy.

    For named actions, the task of a stage has the actions that the policy may take and the other actions taken in the
    log. The covariates are the policy's, with its known categories, or all of the log that hold numbers or text
    of few categories.
    """
    if isinstance(policy, CrossFitted):
        # The policies of all folds use the same covariates, and their actions were logged.
        return task_of(policy.policies[0], logs)
    if isinstance(policy, NamedActionPolicy):
        refuse_other_names(policy, logs, "the policy")
        every = {stage: list(policy.actions) for stage in range(1, policy.horizon + 1)}
        actions, stages = dict(getattr(policy, "actions_by_stage", every)), logs.stages
        for stage, names in actions.items():
            logged = stages.loc[stages["stage"] == stage, "action"].dropna().unique().tolist()
            actions[stage] = list(dict.fromkeys([*names, *sorted(logged, key=str)]))
        covariates = getattr(policy, "covariates", None)
        covariates = fit_covariates(logs) if covariates is None else covariates
        categories = getattr(policy, "categories", {})
        if hasattr(policy, "categories"):
            check_numeric(stages, [name for name in covariates if name not in categories])
        task = NamedActions(actions, covariates, categories)
        return task.fitted(logs, policy.horizon)
    if logs.objects is None:
        raise ArgumentError(
            f"{type(policy).__name__} does not decide about the named actions of the log; give a policy with actions, "
            "horizon and probabilities, such as a learner's policy_"
        )
    # Policies of named actions need no world.
    from halfseen.world.log_checks import robots_in

    return task_by(policy, num_robots=robots_in(logs) or None)


def task_by(policy: Any, num_robots: int | None = None, **parameters: Any) -> Task:
    """Find the task of tables for evaluating a policy of tables: of K robots if the log or the policy has them."""
    grasp = getattr(policy, "grasp", None)
    of_policy = None if getattr(type(policy), "num_robots", None) == 1 else getattr(policy, "num_robots", None)
    known = num_robots or of_policy
    if known is None:
        return named_task("table", grasp=grasp, **parameters)
    return named_task("team", grasp=grasp, num_robots=known, base=None, is_evaluating=True, **parameters)


def is_alike(task: Task) -> bool:
    """Whether stages of a task are alike, as those of tables are, so that they can share one model."""
    return task.end_action is not None or bool(getattr(task, "is_joint", False))


def default_targets(logs: Logs) -> Targets:
    """Doubly robust if the log has all actions, by Cox on the clock of stages, with truncated weights; else weights.

    Cuts may depend on the history of a trajectory, and on the duration of its stage. If a stage is rarely observed to
    end, weights are truncated at `LARGEST_WEIGHT`, and the regression of cut stages provides the rest.
    """
    if logs.stages["action"].isna().to_numpy().any():
        return Weighted()
    return DoublyRobust("cox", by="pooled", truncate_at=LARGEST_WEIGHT)


def default_q(policy: Any, logs: Logs) -> tuple[QSpec, Logs]:
    """Q of named actions is shared by all stages, with the stage and second-order terms added to the log."""
    task = task_of(policy, logs)
    if not isinstance(task, NamedActions):
        return QSpec(task), logs
    task, logs = with_second_order(task, logs)
    return QSpec(task, stages="pooled", reg=LITTLE_REG), logs


def q_model_of(policy: Any, logs: Logs, targets: Targets, q: QSpec, random_state: int = 0) -> QModel:
    """Compose the model that fits Q of a policy to a log."""
    task = task_of(policy, logs) if q.task is None else q.task
    by_task = "pooled" if is_alike(task) else "separate"
    return QModel(
        horizon=horizon_of(policy, logs.horizon),
        task=task,
        targets=targets,
        space=q_space_of(q.q_function),
        reg=reg_of(q.reg),
        stages=stage_mode_of(by_task if q.stages is None else q.stages),
        random_state=random_state,
    )


TRAJECTORIES_PER_TERM = 10
"""Second-order terms need this many trajectories each; with fewer, covariates stay unchanged."""


def with_second_order(task: NamedActions, logs: Logs) -> tuple[NamedActions, Logs]:
    """Add the stage and second-order terms to the covariates of a task, and their columns to its log."""
    fitted = task.fitted(logs, logs.horizon)
    num_features = fitted.looks_at.num_features - ("stage" in task.covariates)
    has_few = comb(num_features, 2) * TRAJECTORIES_PER_TERM <= logs.num_trajectories
    terms = _terms(fitted.looks_at, logs.stages) if has_few else {}
    if len(terms) * TRAJECTORIES_PER_TERM > logs.num_trajectories:
        terms = {}
    stages = logs.stages.copy()
    # A column of the log keeps its name, because a policy may look at it.
    instead = {}
    for name, values in _centred(fitted.looks_at, logs.stages).items():
        instead[name] = _free(f"{name} less its mean", [*stages, *terms])
        stages[instead[name]] = values
    own = [instead.get(name, name) for name in task.covariates]
    named = []
    for name, values in terms.items():
        named.append(_free(name, stages))
        stages[named[-1]] = values
    wider = NamedActions(task.actions, list(dict.fromkeys([*own, "stage", *named])), fitted.categories)
    return wider, Logs(stages, logs.trajectories, logs.objects, reward_unit=logs.reward_unit)


def _free(name: str, taken: Iterable[str]) -> str:
    """The name with as many primes as it takes that none is like it."""
    taken = set(taken)
    while name in taken:
        name += "'"
    return name


FAR = 1e4
"""Covariates with a mean of more standard deviations than this, such as dates, are centred: a linear Q is fitted from
their squares, which would be rounded."""


def _centred(looks_at: Covariates, frame: pd.DataFrame) -> dict[str, np.ndarray]:
    """The numeric covariates that are far from 0, less their mean."""
    each = zip(looks_at.names, looks_at.sources, looks_at.encode(frame).T, strict=True)
    return {
        name: values - values.mean()
        for name, source, values in each
        if source not in looks_at.categories and name != "stage" and is_far(values, FAR)
    }


def _terms(looks_at: Covariates, frame: pd.DataFrame) -> dict[str, np.ndarray]:
    """Products of standardised covariates; the square of a binary one is omitted as redundant."""
    scaled = {}
    for name, values in zip(looks_at.names, looks_at.encode(frame).T, strict=True):
        if name != "stage" and np.ptp(values) > 0.0:
            scaled[name] = (values - values.mean()) / (values.std() or 1.0)
    pairs = combinations_with_replacement(scaled, 2)
    wanted = [(a, b) for a, b in pairs if a != b or len(np.unique(scaled[a])) > 2]
    return {f"{a}*{b}": scaled[a] * scaled[b] for a, b in wanted}


@dataclass(frozen=True)
class EvaluationSpec:
    """Arguments for `evaluate`."""

    censoring: Targets
    """How the rewards that cuts removed are replaced."""
    q: QSpec | None
    """How Q of the policy is fitted; None for the default of `evaluate`."""

    def as_dict(self) -> dict[str, Any]:
        """How cuts were treated, ready for JSON."""
        by = getattr(self.censoring, "by", None)
        is_doubly_robust = isinstance(self.censoring, DoublyRobust)
        return {"augmented": is_doubly_robust, "censoring": self.censoring.name, "censoring_by": by}


def specification_of(stored: StoredPolicy, logs: Logs, **chosen: Any) -> EvaluationSpec:
    """Specify the evaluation of a stored policy: as it was learned, except for what is chosen (see `specification`)."""
    refuse_log_of_team(stored, logs)
    return specification(stored.policy, stored.record["learner"], logs, **chosen)


def specification(
    policy: Any,
    learned: Mapping[str, Any],
    logs: Logs,
    *,
    censoring: str | None = None,
    censoring_by: str | None = None,
    censoring_covariates: list[str] | None = None,
    truncate_at: float | None = None,
    augmented: bool | None = None,
) -> EvaluationSpec:
    """Specify the evaluation of a policy: with the cuts that it was learned with, if given, except for what is chosen.

    Q of named actions is fitted by the default of `evaluate`, because a Q that is good enough for choosing actions may
    be too simple for estimating values.

    Parameters
    ----------
    policy
        The policy.
    learned
        The parameters that it was learned with. A model of the cuts that is unnamed, absent or Kaplan–Meier (the
        default) is replaced by that of `default_targets`.
    logs
        The log that it is evaluated on.
    censoring, censoring_by, censoring_covariates, truncate_at
        As for `named_targets`; None for those of the policy, and for truncation at `LARGEST_WEIGHT` with doubly robust
        targets.
    augmented
        Doubly robust towards cuts; None: if the log has all actions.
    """
    own = learned.get("censoring")
    is_complete = bool(logs.stages["action"].notna().all())
    is_augmented = is_complete if augmented is None else augmented
    q = None
    if not isinstance(policy, NamedActionPolicy):
        task = task_by(policy, reduces_variance=bool(learned.get("reduces_variance", True)))
        q = QSpec(task, q_space_of_record(learned), learned.get("stages"))
    is_chosen = any(one is not None for one in (censoring, censoring_by, censoring_covariates, truncate_at))
    if is_augmented and is_complete and not is_chosen and own not in ("cox", "kernel"):
        return EvaluationSpec(default_targets(logs), q)
    model = censoring or (own if own in CENSORING_NAMES else "kaplan-meier")
    bound = learned.get("truncate_at") if truncate_at is None else truncate_at
    # The covariates of cuts apply to the same model only.
    depends_on = learned.get("censoring_covariates") if own == model else None
    targets = named_targets(
        model,
        by=censoring_by or learned.get("censoring_by") or "trajectory",
        covariates=depends_on if censoring_covariates is None else censoring_covariates,
        truncate_at=LARGEST_WEIGHT if bound is None and is_augmented else bound,
        is_doubly_robust=is_augmented,
    )
    return EvaluationSpec(targets, q)
