"""All that the page tells, as numbers."""

import platform
import warnings
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import Any, NamedTuple

import halfseen
from halfseen.censoring.positivity import PositivityReport
from halfseen.errors import HalfseenWarning
from halfseen.evaluation import Evaluation, evaluate
from halfseen.evaluation.specification import specification_of
from halfseen.evaluation.targets import task_of
from halfseen.learning.flat_policy import FlatPolicy
from halfseen.logs import Logs
from halfseen.policies.folder import StoredPolicy, log_digest
from halfseen.policies.folder.record import plain
from halfseen.report.log_findings import Watched, log_findings, positivity_of, watched
from halfseen.report.policy_findings import Band, QCurve, choices, most_telling, q_curves, telling
from halfseen.report.policy_map import PolicyMap, policy_maps
from halfseen.report.table_map import TableMap, table_map
from halfseen.report.timeline import UNKNOWN_ACTION, Timeline, timeline
from halfseen.workers import ALONE, Workers

ASKED = {"censoring_covariates": "covariates", "truncate_at": "truncate_at"}
"""Name on the page → name in the specification of the cuts, where it has one."""
LIBRARIES = ("matplotlib", "numpy", "pandas", "scikit-learn", "scipy")


@dataclass(frozen=True, eq=False)
class PolicyFindings:
    """What is known of a policy, by a log.

    `choices` are what it would do in the states of the log, `curves` Q along its covariates with `band` around it, and
    `maps` what it does over two of them (neither for tables, which have a `table_map`). `model` says how its value was
    judged, and `is_own_log` whether it was learned from this very log.
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

    def as_dict(self) -> dict[str, Any]:
        """What was learned; its value stands apart."""
        return {
            "is_learned_from_these_logs": self.is_own_log,
            **self.record,
            "choices": self.choices,
            "curves": [asdict(curve) for curve in self.curves],
            "band": self.band,
        }


@dataclass(frozen=True, eq=False)
class Findings:
    """What is known of a log, and of a policy if there is one."""

    log: Mapping[str, Any]
    positivity: PositivityReport
    watched: Watched
    timeline: Timeline
    policy: PolicyFindings | None
    log_sha256: str
    notes: list[str]
    seed: int
    versions: Mapping[str, str]

    @property
    def unit(self) -> str | None:
        """What rewards are counted in; None if nobody has said."""
        return self.log["reward_unit"]

    @property
    def timeline_actions(self) -> list[str]:
        """Names of what was done or begun in the trajectories that are drawn."""
        return [name for name in dict.fromkeys(self.timeline.action) if name != UNKNOWN_ACTION]

    def as_dict(self) -> dict[str, Any]:
        """All numbers but those of single trajectories, ready for JSON: null for what is no number."""
        told, policy = {}, self.policy
        if policy is not None:
            value = policy.evaluation
            told["value"] = {"sentence": value.sentence, **value.as_dict(), **policy.model}
            told["policy"] = policy.as_dict()
        return plain(
            {
                **told,
                "notes": self.notes,
                "log": {"sha256": self.log_sha256, **self.log, "watched": asdict(self.watched)},
                "seed": self.seed,
                "versions": dict(self.versions),
            }
        )


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
    """Find out all that the page tells of a log and of the policy that is judged by it, if there is one.

    `against` is what the policy has to beat (see `evaluate`). `chosen` are parameters of the evaluation that are not to
    be the policy's own (`specification_of`); bootstrap bands around Q come from `num_replicates` draws of trajectories.
    Where it takes long, `workers` judge and learn again.
    """
    digest = log_digest(logs)
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", HalfseenWarning)
        judged = None
        if stored is not None:
            is_own = stored.record["log"].get("sha256") in (digest, None)
            asked = _Asked(against, propensity, seed, num_replicates, is_own, chosen, workers)
            judged = _judged(stored, logs, asked, on_progress)
        on_progress("look at the log")
        positivity = positivity_of(logs)
        log = log_findings(logs, positivity)
    notes = [] if judged is None else judged.evaluation.notes
    return Findings(
        log=log,
        positivity=positivity,
        watched=watched(logs),
        timeline=timeline(logs),
        policy=judged,
        log_sha256=digest,
        notes=[*notes, *dict.fromkeys(str(each.message) for each in told if _is_ours(each.category))],
        seed=seed,
        versions={
            "halfseen": halfseen.__version__,
            "python": platform.python_version(),
            **{name: version(name) for name in LIBRARIES},
        },
    )


class _Asked(NamedTuple):
    """How a policy is to be judged."""

    against: list[str] | None
    propensity: str
    seed: int
    num_replicates: int
    is_own_log: bool
    """Whether the policy may have been learned from this very log."""
    chosen: Mapping[str, Any]
    workers: Workers


def _judged(stored: StoredPolicy, logs: Logs, asked: _Asked, on_progress: Callable[[str], object]) -> PolicyFindings:
    on_progress("evaluate")
    spec = specification_of(stored, logs, **asked.chosen)
    task = (spec.q and spec.q.task) or task_of(stored.policy, logs)
    options: Any = {"against": asked.against, "propensity": asked.propensity, "random_state": asked.seed}
    options["workers"] = asked.workers
    evaluation = evaluate(stored.policy, logs, censoring=spec.censoring, q=spec.q, is_hourly=True, **options)
    on_progress("look at the policy")
    decided = choices(stored, task, logs)
    on_progress("learn again")
    resampled: Any = {"is_own_log": asked.is_own_log, "workers": asked.workers}
    curves, band = q_curves(stored, logs, asked.num_replicates, asked.seed, **resampled)
    maps = policy_maps(stored.policy, logs, telling(curves)) if isinstance(stored.policy, FlatPolicy) else []
    named = {name: getattr(spec.censoring, of, None) for name, of in ASKED.items()}
    return PolicyFindings(
        record=stored.record,
        choices=decided,
        curves=most_telling(curves),
        band=band,
        maps=maps,
        table_map=table_map(stored.policy, task, logs) if stored.is_table else None,
        evaluation=evaluation,
        model={"propensity": asked.propensity, **spec.as_dict(), **named},
        is_own_log=asked.is_own_log and stored.record["log"].get("sha256") is not None,
    )


def _is_ours(category: type[Warning]) -> bool:
    return issubclass(category, HalfseenWarning)
