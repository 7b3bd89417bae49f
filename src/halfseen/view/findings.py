"""The numbers behind the report of a log, and of the policy that is evaluated on it."""

import platform
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from typing import Any

import halfseen
from halfseen.censoring.positivity import PositivityReport
from halfseen.errors import noted
from halfseen.evaluation import Evaluation, evaluate
from halfseen.evaluation.specification import specification_of, task_of
from halfseen.evaluation.stepped_back import with_its_rule
from halfseen.learning.discrete_policy import DiscretePolicy
from halfseen.logs import Logs
from halfseen.policies.folder import StoredPolicy, log_digest
from halfseen.policies.folder.record import plain
from halfseen.view.log_findings import FollowUp, Timeline, follow_up, log_findings, positivity_of, timeline
from halfseen.view.policy_findings import (
    MOST_COVARIATES,
    Band,
    PolicyMap,
    QCurve,
    TableMap,
    choices,
    informative,
    policy_maps,
    q_curves,
    table_map,
)
from halfseen.workers import ALONE, Workers

ASKED = {"censoring_covariates": "covariates", "truncate_at": "truncate_at"}
"""Name on the page → name in the specification of the cuts, if any."""
LIBRARIES = ("matplotlib", "numpy", "pandas", "scikit-learn", "scipy")


@dataclass(frozen=True, eq=False)
class PolicyFindings:
    """Findings about a policy, from a log.

    `choices` are its actions in the states of the log, `curves` Q along its covariates with `band` around it, and
    `maps` its actions over two covariates (both empty for tables, which have a `table_map`). `model` describes how its
    value was estimated, and `is_own_log` is whether it was learned from this very log.
    """

    record: Mapping[str, Any]
    choices: list[dict[str, Any]]
    curves: list[QCurve]
    band: Band | None
    maps: list[PolicyMap]
    table_map: TableMap | None
    evaluation: Evaluation
    model: Mapping[str, Any]
    is_own_log: bool


@dataclass(frozen=True, eq=False)
class Findings:
    """Findings about a log, and about a policy if there is one."""

    log: Mapping[str, Any]
    positivity: PositivityReport
    follow_up: FollowUp
    timeline: Timeline
    policy: PolicyFindings | None
    log_sha256: str
    notes: list[str]
    seed: int
    versions: Mapping[str, str]

    @property
    def unit(self) -> str | None:
        """Unit of the rewards; None if unknown."""
        return self.log["reward_unit"]

    def as_dict(self) -> dict[str, Any]:
        """Return all numbers except those of single trajectories, ready for JSON, with null for missing numbers."""
        numbers, policy = {}, self.policy
        if policy is not None:
            value = policy.evaluation
            numbers["value"] = {"sentence": value.sentence, **value.as_dict(), **policy.model}
            numbers["policy"] = {
                "is_learned_from_these_logs": policy.is_own_log,
                **policy.record,
                "choices": policy.choices,
                "curves": [asdict(curve) for curve in policy.curves],
                "band": policy.band,
            }
        log = {"sha256": self.log_sha256, **self.log, "watched": asdict(self.follow_up)}
        return plain({**numbers, "notes": self.notes, "log": log, "seed": self.seed, "versions": dict(self.versions)})


def find(
    stored: StoredPolicy | None,
    logs: Logs,
    *,
    against: list[str] | None = None,
    propensity: str = "logged",
    seed: int = 0,
    num_replicates: int = 100,
    on_progress: Callable[[str], object] = lambda what: None,
    workers: Workers = ALONE,
    **chosen: Any,
) -> Findings:
    """Compute the findings of the page about a log, and about the policy to evaluate on it, if there is one.

    `against` names the baselines of the policy (see `evaluate`). `chosen` are parameters of the evaluation that
    override the policy's own (`specification_of`); bootstrap bands around Q come from `num_replicates` draws of
    trajectories. `workers` do the slow parts of the evaluation and of learning again.
    """
    digest, judged = log_digest(logs), None
    with noted() as of_library:
        if stored is not None:
            options: Any = {"against": against, "propensity": propensity, "random_state": seed, "workers": workers}
            is_own_log = stored.record["log"].get("sha256") in (digest, None)
            judged = _judged(stored, logs, options, num_replicates, is_own_log, on_progress, chosen)
        on_progress("look at the log")
        positivity = positivity_of(logs)
        log = log_findings(logs, positivity)
    notes = [] if judged is None else judged.evaluation.notes
    versions = {"halfseen": halfseen.__version__, "python": platform.python_version()}
    return Findings(
        log=log,
        positivity=positivity,
        follow_up=follow_up(logs),
        timeline=timeline(logs),
        policy=judged,
        log_sha256=digest,
        notes=[*notes, *dict.fromkeys(of_library)],
        seed=seed,
        versions=versions | {name: version(name) for name in LIBRARIES},
    )


def _judged(
    stored: StoredPolicy,
    logs: Logs,
    options: Any,
    num_replicates: int,
    is_own_log: bool,
    on_progress: Callable[[str], object],
    chosen: Mapping[str, Any],
) -> PolicyFindings:
    on_progress("evaluate")
    policy, spec = stored.policy, specification_of(stored, logs, **chosen)
    # What the policy does not know is not shown as anything else than its models take it for.
    served, logs, by_rule = with_its_rule(policy, logs, stored.is_outside)
    evaluation = evaluate(served, logs, censoring=spec.censoring, q=spec.q, is_hourly=True, **options)
    evaluation = replace(evaluation, notes=(*by_rule, *evaluation.notes))
    task = (spec.q and spec.q.task) or task_of(served, logs)
    on_progress("look at the policy")
    decided = choices(served, task, logs)
    on_progress("learn again")
    seed, workers = options["random_state"], options["workers"]
    curves, band = q_curves(stored, logs, num_replicates, seed, is_own_log=is_own_log, workers=workers)
    ranked = informative(curves)
    named = {name: getattr(spec.censoring, of, None) for name, of in ASKED.items()}
    return PolicyFindings(
        record=stored.record,
        choices=decided,
        curves=[curve for curve in curves if curve.covariate in ranked[:MOST_COVARIATES]],
        band=band,
        maps=policy_maps(policy, logs, ranked) if isinstance(policy, DiscretePolicy) else [],
        table_map=table_map(policy, task, logs) if stored.is_table else None,
        evaluation=evaluation,
        model={"propensity": options["propensity"], **spec.as_dict(), **named},
        is_own_log=is_own_log and stored.record["log"].get("sha256") is not None,
    )
