"""How a policy in a folder is to be evaluated: with the Q and the model of the cuts that it was learned with."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from halfseen.censoring import CENSORING_NAMES
from halfseen.evaluation.off_policy import LARGEST_WEIGHT, QSpec, default_targets
from halfseen.evaluation.targets import task_by
from halfseen.learning.flat_policy import NamedActionPolicy
from halfseen.learning.targets import DoublyRobust, Targets, named_targets
from halfseen.learning.task import Task
from halfseen.logs import Logs
from halfseen.policies.folder import StoredPolicy, q_space_of_record
from halfseen.policies.folder.stored import refuse_log_of_team


@dataclass(frozen=True)
class EvaluationSpec:
    """What `evaluate` is to be given.

    Parameters
    ----------
    censoring
        What stands for what cuts took away.
    q
        How Q of the policy is fitted; None for the way of `evaluate`.
    """

    censoring: Targets
    q: QSpec | None

    def as_dict(self) -> dict[str, Any]:
        """How cuts were dealt with, ready for JSON."""
        by = getattr(self.censoring, "by", None)
        is_doubly_robust = isinstance(self.censoring, DoublyRobust)
        return {"augmented": is_doubly_robust, "censoring": self.censoring.name, "censoring_by": by}


def specification_of(stored: StoredPolicy, logs: Logs, **chosen: Any) -> EvaluationSpec:
    """Say how to evaluate a policy that was read: as it was learned, but for what is chosen (see `specification`).

    Raises
    ------
    PolicyError
        The log is of a team, and the policy of one robot's tables.
    """
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
    """Say how to evaluate a policy: with the cuts that it was learned with, if any were named, but for what is chosen.

    Q of named actions is fitted as `evaluate` does by itself, for what is good enough to choose an action by may be
    too plain to tell its value.

    Parameters
    ----------
    policy
        The policy.
    learned
        The parameters that it was learned with. A model of the cuts that has no name, is none, or is Kaplan and Meier's
        as if nothing was said, gives way to that of `default_targets`.
    logs
        The log that it is evaluated on.
    censoring, censoring_by, censoring_covariates, truncate_at
        As for `named_targets`; None for those of the policy, and of doubly robust targets no weight above
        `LARGEST_WEIGHT`.
    augmented
        Doubly robust towards cuts; None where the log has all actions.
    """
    own = learned.get("censoring")
    is_complete = bool(logs.stages["action"].notna().all())
    is_augmented = is_complete if augmented is None else augmented
    q = None
    if not isinstance(policy, NamedActionPolicy):
        q = QSpec(_task(policy, learned), q_space_of_record(learned), learned.get("stages"))
    is_chosen = any(one is not None for one in (censoring, censoring_by, censoring_covariates, truncate_at))
    if is_augmented and is_complete and not is_chosen and own not in ("cox", "kernel"):
        return EvaluationSpec(default_targets(logs), q)
    model = censoring or (own if own in CENSORING_NAMES else "kaplan-meier")
    bound = learned.get("truncate_at") if truncate_at is None else truncate_at
    targets = named_targets(
        model,
        by=censoring_by or learned.get("censoring_by") or "trajectory",
        covariates=_own_covariates(learned, model) if censoring_covariates is None else censoring_covariates,
        truncate_at=LARGEST_WEIGHT if bound is None and is_augmented else bound,
        is_doubly_robust=is_augmented,
    )
    return EvaluationSpec(targets, q)


def _own_covariates(learned: Mapping[str, Any], model: str) -> list[str] | None:
    """What cuts were said to depend on, if the same model is to be fitted."""
    return learned.get("censoring_covariates") if learned.get("censoring") == model else None


def _task(policy: Any, learned: Mapping[str, Any]) -> Task:
    return task_by(policy, reduces_variance=bool(learned.get("reduces_variance", True)))
