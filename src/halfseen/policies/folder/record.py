"""policy.json: what a policy looks at, what it was learned from and how, and what its weights are worth."""

import json
import platform
from collections.abc import Mapping
from dataclasses import asdict
from importlib.metadata import version
from typing import Any

import numpy as np

import halfseen
from halfseen.censoring import positivity_report, weight_diagnostics
from halfseen.censoring.positivity import PositivityReport
from halfseen.errors import PolicyError
from halfseen.learners.q_learning.q_learner import CensoredQLearner
from halfseen.learners.q_learning.streaming import sample_of
from halfseen.logs import Logs, LogStream
from halfseen.logs.stream import parts_of
from halfseen.logs.suspicions import suspicions
from halfseen.policies.folder.json_values import names_in, plain, typed
from halfseen.policies.folder.kinds import KINDS, kind_name_of, kind_of
from halfseen.policies.folder.log_facts import log_facts
from halfseen.policies.folder.specification import described

FORMAT, VERSION = "halfseen-policy", 1


def record_of(
    learner: CensoredQLearner, logs: Logs | LogStream, verdict: Mapping[str, Any] | None = None
) -> dict[str, Any]:
    """Describe a fitted learner and its log.

    Parameters
    ----------
    learner
        Fitted to `logs`.
    logs
        What it was learned from.
    verdict
        On what was learned, if there is one: at least ``verdict``, ``reason`` and ``sentence``.

    Raises
    ------
    ArgumentError
        An action has a name that a JSON file cannot hold.
    """
    policy, name = learner.policy_, kind_name_of(learner.policy_)
    is_by_stage = learner.model_.stages == "separate"
    facts = log_facts(parts_of(logs), KINDS[name], policy, is_by_stage)
    sample = logs if isinstance(logs, Logs) else sample_of(logs, learner.random_state)
    positivity = positivity_report(logs.end_s, logs.is_finished, path_ids=logs.path_ids)
    return {
        "format": FORMAT,
        "version": VERSION,
        "versions": {
            "halfseen": halfseen.__version__,
            "python": platform.python_version(),
            **{name: version(name) for name in ("numpy", "jax")},
        },
        "kind": name,
        "schema": facts.schema,
        "seen": facts.seen,
        "stages_left": facts.stages_left,
        "reward_spread": facts.reward_spread,
        "learner": described(learner.model_),
        "chosen": list(learner.chosen_),
        "seed": int(learner.random_state),
        "reg": {
            "rows": "stage" if is_by_stage else "steps to go",
            "columns": facts.schema["actions"],
            "values": np.asarray(learner.q_functions_.reg).tolist(),
        },
        "log": {"sha256": facts.sha256, "sentence": str(facts.summary), **asdict(facts.summary)},
        "diagnostics": _diagnostics(learner, facts.summary.horizon, positivity),
        "warnings": _warnings(sample, positivity),
        "verdict": None if verdict is None else dict(verdict),
    }


def as_json(record: Mapping[str, Any]) -> bytes:
    """Write a record down; the same record gives the same bytes."""
    return (json.dumps(plain(record), indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


def from_json(data: bytes) -> dict[str, Any]:
    """Read a record, and check that it is one of this version.

    Raises
    ------
    PolicyError
        It is no JSON, describes no policy, or one of another version.
    """
    try:
        record: Any = json.loads(data.decode(), parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise PolicyError(f"it is no JSON ({error}); learn the policy anew") from error
    if not isinstance(record, dict) or record.get("format") != FORMAT:
        raise PolicyError("it describes no policy; give a folder that `halfseen learn` wrote")
    if record.get("version") != VERSION:
        raise PolicyError(
            f"version {record.get('version')!r} is not the {VERSION} that halfseen {halfseen.__version__} reads; use "
            "the halfseen that wrote it, or learn the policy anew"
        )
    kind_of(record)
    names_in(record, "column_major", (str,))
    for name in ("schema", "learner", "log", "diagnostics", "reg", "versions"):
        typed(record, name, dict, "an object")
    _check_doubts(record)
    spread = typed({"reward_spread": 0.0, **record}, "reward_spread", float, "a standard deviation")
    if not 0.0 <= spread < np.inf:
        raise PolicyError(f"reward_spread is {spread}; it is a standard deviation: learn the policy anew")
    left = typed({"stages_left": [], **record}, "stages_left", list, "a list")
    if not all(isinstance(each, float) and each >= 1.0 for each in left):
        raise PolicyError(f"stages_left is {left}; it holds a number from 1 on for each stage: learn the policy anew")
    return record


def _check_doubts(record: Mapping[str, Any]) -> None:
    """Refuse a verdict or warnings that say nothing; folders that were written before there were any have neither."""
    if not all(isinstance(one, str) for one in typed({"warnings": [], **record}, "warnings", list, "a list")):
        raise PolicyError(f"warnings is {record['warnings']!r} and not a list of sentences; learn the policy anew")
    if record.get("verdict") is not None:
        for name in ("verdict", "reason", "sentence"):
            typed(typed(record, "verdict", dict, "an object"), name, str, "a text")


def _warnings(logs: Logs, positivity: PositivityReport) -> list[str]:
    """What `halfseen inspect` would say against the log, a line each."""
    weights = [] if positivity.is_sound else [str(positivity).splitlines()[0]]
    return [*weights, *(each.sentence for each in suspicions(logs))]


def _diagnostics(learner: CensoredQLearner, horizon: int, positivity: PositivityReport) -> dict[str, Any]:
    by_stage = [
        weight_diagnostics(column, getattr(learner.model_.targets, "truncate_at", None))
        for column in learner.weights_[:, :horizon].T
    ]
    return {
        "weights": asdict(learner.diagnostics_),
        "weights_by_stage": [asdict(one) for one in by_stage],
        "positivity": {
            "censoring": "kaplan-meier by path",
            "text": str(positivity),
            "is_sound": positivity.is_sound,
            "mean_weight": positivity.mean_weight,
            "identified_until_s": positivity.identified_until_s,
        },
    }


def _refuse_constant(name: str) -> None:
    raise ValueError(f"{name} is no number of JSON")
