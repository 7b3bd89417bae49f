"""How a policy was learned, as plain numbers and text, and back; and the description of its record in words."""

from collections.abc import Mapping, Sequence
from dataclasses import fields
from typing import Any

from halfseen.learning.q_model import QModel
from halfseen.learning.q_space import TREND, CrossValidation, KernelQ, QSpace, q_space_of
from halfseen.learning.targets import DoublyRobust, Targets, named_targets


def described(model: QModel) -> dict[str, Any]:
    """Return the parameters of a learner; custom models as they print.

    Parameters
    ----------
    model
        The composed learner.
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
        "stages": TREND if model.stage_trend else model.stages,
        "reg": "cv" if isinstance(model.reg, CrossValidation) else model.reg,
        "num_folds": getattr(model.reg, "num_folds", None),
        "random_state": int(model.random_state),
        **({} if model.half_life is None else {"half_life": model.half_life}),
    }


def targets_of_record(learned: Mapping[str, Any]) -> Targets:
    """Rebuild the targets.

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
    """Rebuild 𝒬."""
    name = learned.get("q_function")
    if name not in ("kernel", "smooth"):
        return q_space_of(name or "linear")
    trend = learned.get("trend")
    known = learned.get("num_landmarks") or KernelQ.num_landmarks, learned.get("gamma")
    return KernelQ(*known, None if trend is None else tuple(trend))


def reg_of_record(learned: Mapping[str, Any]) -> Any:
    """Rebuild λ, in the form that `CensoredQLearner` takes."""
    return (
        CrossValidation(learned.get("num_folds") or CrossValidation.num_folds)
        if learned["reg"] == "cv"
        else learned["reg"]
    )


BASES = {
    "model": "one step ahead under laws fitted to the log, and a correction by simulation",
    "rule": "value of a WASH; it never LIFTs",
}
"""Base of Q for policies with laws, by kind of base."""


def description(record: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Describe a policy by the record in its folder: rows of a name and a text."""
    weights = record["diagnostics"]["weights"]
    size, largest = weights["effective_sample_size"], weights["largest_weight"]
    return [
        ("looks at", _looks_at(record["kind"], record["schema"])),
        *_q_rows(record),
        *(("chosen", sentence) for sentence in record["chosen"]),
        (
            "weights",
            f"{weights['num_seen']} stages, with an effective sample size of {size:.1f}; the largest weight is "
            f"{largest:.3g}",
        ),
    ]


def _looks_at(kind: str, schema: Mapping[str, Any]) -> str:
    if kind.startswith("team"):
        return f"tables of {schema['num_robots']} robots, and what each is doing; it decides for the robot that is free"
    if kind.startswith("table"):
        return "tables: where objects stand, who hides whom, how dirty each seems, past attempts"
    return ", ".join(schema["covariates"]) or "nothing but the stage"


def _q_rows(record: Mapping[str, Any]) -> list[tuple[str, str]]:
    learner, schema = record["learner"], record["schema"]
    horizon = f"horizon {schema['horizon']}"
    if (num_robots := schema.get("num_robots")) is not None:
        horizon += f", {schema['horizon'] // num_robots} decisions of each robot"
    if "basis" in schema:
        return [("Q", f"{BASES[schema['basis']]}, {horizon}")]
    stages = "pooled with a trend" if learner["stages"] == TREND else learner["stages"]
    is_weighted = learner["censoring"] in ("kaplan-meier", "cox", "kernel")
    by = f", by {learner['censoring_by']}" if is_weighted else ""
    pessimism = (
        f"Q is lowered by {learner['pessimism']:.2g} times its standard error, so that no action is chosen on the "
        "evidence of few stages; less for actions that the logs often take, unless they earned less"
    )
    return [
        ("Q", f"{learner['q_function']}, stages {stages}, {horizon}"),
        *([("pessimism", pessimism)] if learner["pessimism"] else []),
        ("cuts", f"{learner['censoring']}{by}{', augmented' if learner['augmented'] else ''}"),
        ("λ", _regs(**record["reg"])),
    ]


def _regs(values: Sequence[Sequence[float]], rows: str, columns: Sequence[str]) -> str:
    flat = sorted(value for row in values for value in row)
    if flat[0] == flat[-1]:
        return f"{flat[0]:.3g}"
    each = "stage" if rows == "stage" else f"number of {rows}"
    return f"{flat[0]:.3g} to {flat[-1]:.3g}, chosen for each {each}{' and action' if len(columns) > 1 else ''}"
