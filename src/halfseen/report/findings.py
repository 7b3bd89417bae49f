"""All that the page tells, as numbers."""

import platform
import warnings
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import Any

import halfseen
from halfseen.censoring.positivity import PositivityReport
from halfseen.errors import HalfseenWarning
from halfseen.evaluation import Evaluation, evaluate
from halfseen.evaluation.stored_model import specification_of
from halfseen.evaluation.targets import task_of
from halfseen.logs import Logs
from halfseen.policies.folder import StoredPolicy, log_digest
from halfseen.policies.folder.json_values import plain
from halfseen.report.log_findings import Watched, log_findings, positivity_of, watched
from halfseen.report.policy_findings import QCurve, choices, q_curves

ASKED = {"censoring_covariates": "covariates", "truncate_at": "truncate_at"}
"""Name on the page → name in the specification of the cuts, where it has one."""
LIBRARIES = ("jax", "matplotlib", "numpy", "pandas", "scikit-learn", "scipy")


@dataclass(frozen=True, eq=False)
class Findings:
    """What is known of a log and a policy.

    `choices` and `curves` are what the policy would do in the states of the log, and Q along its covariates (none for
    tables); `model` says how its value was judged, and `is_own_log` whether it was learned from this very log.
    """

    log: Mapping[str, Any]
    positivity: PositivityReport
    watched: Watched
    record: Mapping[str, Any]
    choices: list[dict[str, Any]]
    curves: list[QCurve]
    evaluation: Evaluation
    model: Mapping[str, Any]
    log_sha256: str
    is_own_log: bool
    notes: list[str]
    seed: int
    versions: Mapping[str, str]

    def as_dict(self) -> dict[str, Any]:
        """Everything, ready for JSON: null for what is no number."""
        return plain(
            {
                "value": {"sentence": self.evaluation.sentence, **self.evaluation.as_dict(), **self.model},
                "notes": self.notes,
                "log": {"sha256": self.log_sha256, **self.log, "watched": asdict(self.watched)},
                "policy": {
                    "is_learned_from_these_logs": self.is_own_log,
                    **self.record,
                    "choices": self.choices,
                    "curves": [asdict(curve) for curve in self.curves],
                },
                "seed": self.seed,
                "versions": dict(self.versions),
            }
        )


def find(
    stored: StoredPolicy,
    logs: Logs,
    *,
    against: list[str] | None = None,
    propensity: str = "logged",
    seed: int = 0,
    num_replicates: int = 100,
    on_progress: Callable[[str], object] = lambda what: None,
    **chosen: Any,
) -> Findings:
    """Find out all that the page tells of a policy and the log that it is judged by.

    `against` is what the policy has to beat (see `evaluate`). `chosen` are parameters of the evaluation that are not to
    be the policy's own (`specification_of`); bands around Q come from `num_replicates` draws of paths.
    """
    on_progress("evaluate")
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", HalfseenWarning)
        spec = specification_of(stored, logs, **chosen)
        task = (spec.q and spec.q.task) or task_of(stored.policy, logs)
        options: Any = {"against": against, "propensity": propensity, "random_state": seed}
        evaluation = evaluate(stored.policy, logs, censoring=spec.censoring, q=spec.q, **options)
        on_progress("look at the log")
        positivity = positivity_of(logs)
        log = log_findings(logs, positivity)
        on_progress("look at the policy")
        decided = choices(stored, task, logs)
        on_progress("learn again")
        curves = q_curves(stored, logs, num_replicates, seed)
    digest = log_digest(logs)
    asked = {name: getattr(spec.censoring, of, None) for name, of in ASKED.items()}
    return Findings(
        log=log,
        positivity=positivity,
        watched=watched(logs),
        record=stored.record,
        choices=decided,
        curves=curves,
        evaluation=evaluation,
        model={"propensity": propensity, **spec.as_dict(), **asked},
        log_sha256=digest,
        is_own_log=digest == stored.record["log"].get("sha256"),
        notes=[*evaluation.notes, *dict.fromkeys(str(each.message) for each in told if _is_ours(each.category))],
        seed=seed,
        versions={
            "halfseen": halfseen.__version__,
            "python": platform.python_version(),
            **{name: version(name) for name in LIBRARIES},
        },
    )


def _is_ours(category: type[Warning]) -> bool:
    return issubclass(category, HalfseenWarning)
