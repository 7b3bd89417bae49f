"""How a policy was learned, in plain numbers and text, and back."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

from halfseen.learning.q_model import QModel
from halfseen.learning.q_space import CrossValidation, KernelQ, QSpace, q_space_of
from halfseen.learning.targets import DoublyRobust, Targets, named_targets


def described(model: QModel) -> dict[str, Any]:
    """Write down the parameters of a learner; a model of one's own by what it prints.

    Parameters
    ----------
    model
        What was composed of them.
    """
    targets: Any = model.targets
    task: Any = model.task
    return {
        "horizon": model.horizon,
        **{field.name: getattr(task, field.name) for field in fields(task) if field.repr},
        "q_function": model.space.name,
        **{name: getattr(model.space, name, None) for name in ("num_landmarks", "gamma", "trend")},
        "pessimism": model.pessimism,
        "censoring": targets.name,
        "censoring_by": getattr(targets, "by", None),
        "censoring_covariates": getattr(targets, "covariates", None),
        "truncate_at": getattr(targets, "truncate_at", None),
        "augmented": isinstance(targets, DoublyRobust),
        "outcome_covariates": getattr(targets, "outcome_covariates", None),
        "stages": model.stages,
        "reg": "cv" if isinstance(model.reg, CrossValidation) else model.reg,
        "num_folds": getattr(model.reg, "num_folds", None),
        "random_state": int(model.random_state),
        **({} if model.half_life is None else {"half_life": model.half_life}),
    }


def targets_of_record(learned: Mapping[str, Any]) -> Targets:
    """Compose the targets again.

    Raises
    ------
    ArgumentError
        The model of the cuts has no name.
    """
    return named_targets(
        learned["censoring"],
        by=learned.get("censoring_by") or "trajectory",
        covariates=learned.get("censoring_covariates"),
        truncate_at=learned.get("truncate_at"),
        is_doubly_robust=bool(learned.get("augmented")),
        outcome_covariates=learned.get("outcome_covariates"),
    )


def q_space_of_record(learned: Mapping[str, Any]) -> QSpace:
    """Compose 𝒬 again."""
    name = learned.get("q_function")
    if name not in ("kernel", "smooth"):
        return q_space_of(name or "linear")
    trend = learned.get("trend")
    known = learned.get("num_landmarks") or KernelQ.num_landmarks, learned.get("gamma")
    return KernelQ(*known, None if trend is None else tuple(trend))


def reg_of_record(learned: Mapping[str, Any]) -> Any:
    """Compose λ again, as `CensoredQLearner` takes it."""
    return (
        CrossValidation(learned.get("num_folds") or CrossValidation.num_folds)
        if learned["reg"] == "cv"
        else learned["reg"]
    )
