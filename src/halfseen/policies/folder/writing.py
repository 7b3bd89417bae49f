"""Writing of learned policies to a folder, with their log and how they were learned."""

import platform
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import safetensors.numpy

import halfseen
from halfseen.censoring import positivity_report, weight_diagnostics
from halfseen.censoring.positivity import PositivityReport
from halfseen.errors import ArgumentError
from halfseen.estimator import check_fitted
from halfseen.learning.q_learner import CensoredQLearner
from halfseen.learning.q_model import checked_log
from halfseen.learning.sample import latest
from halfseen.learning.streaming import sample_of
from halfseen.logs import Logs, LogStream
from halfseen.logs.data_quality import data_warnings
from halfseen.logs.stream import parts_of
from halfseen.policies.folder.files import check_target, write_files
from halfseen.policies.folder.kinds import laid_out
from halfseen.policies.folder.log_facts import log_facts, sources_of
from halfseen.policies.folder.promised_parts import promised_parts, promised_states
from halfseen.policies.folder.record import FORMAT, VERSION, as_json, from_json
from halfseen.policies.folder.specification import described
from halfseen.policies.folder.stored import kind_name_of, kind_named, policy_of
from halfseen.writing import path_of


def write_policy(
    learner: CensoredQLearner,
    logs: Logs | LogStream,
    folder: str | Path,
    *,
    overwrite: bool = False,
    verdict: Mapping[str, Any] | None = None,
    origin: Mapping[str, Any] | None = None,
) -> None:
    """Write the policy of a fitted learner, all or nothing.

    Parameters
    ----------
    learner
        Fitted to `logs`.
    logs
        The log that it was learned from; only its ranges, counts and digest are kept.
    folder
        Destination; missing parents are made.
    overwrite
        Replace an existing policy.
    verdict
        Verdict on the policy, such as from `halfseen.evaluation.HeldOutVerdict.as_dict`, to be stored with it.
    origin
        Further facts about the log (see `record_of`).

    Raises
    ------
    ArgumentError
        The log has another number of trajectories than that of the learner, the folder exists or cannot be written, or
        the policy holds what cannot be stored: a custom grasp model, or actions that are neither whole numbers nor
        text.
    PolicyError
        A number of the policy is not finite.
    """
    check_fitted(learner, "policy_")
    if checked_log(logs).num_trajectories != len(learner.weights_):
        raise ArgumentError(
            f"the log has {logs.num_trajectories} trajectories, but the learner was fitted to {len(learner.weights_)}; "
            "give it the log that it was fitted to"
        )
    folder = path_of(folder)
    check_target(folder, overwrite)
    arrays = kind_named(kind_name_of(learner.policy_)).arrays_of(learner.policy_)
    # The memory order of a matrix affects the rounding of a product, and so the last bit.
    by_column = [name for name, each in arrays.items() if each.flags.f_contiguous and not each.flags.c_contiguous]
    text = as_json({**record_of(learner, logs, verdict, origin), "column_major": sorted(by_column)})
    policy_of(from_json(text), arrays)
    write_files(folder, text, safetensors.numpy.save(laid_out(arrays, ())), overwrite=overwrite)


def record_of(
    learner: CensoredQLearner,
    logs: Logs | LogStream,
    verdict: Mapping[str, Any] | None = None,
    origin: Mapping[str, Any] | None = None,
) -> dict[str, Any]:
    """Describe a fitted learner and its log.

    Parameters
    ----------
    learner
        Fitted to `logs`.
    logs
        The log that it was learned from.
    verdict
        Verdict on the policy, if there is one: at least ``verdict``, ``reason`` and ``sentence``.
    origin
        Further facts about the log: its ``name``; ``since``, if earlier trajectories were dropped; and ``changes``,
        each with a ``sentence`` (`halfseen.monitoring.training_log`).

    Raises
    ------
    ArgumentError
        An action has a name that a JSON file cannot hold.
    """
    policy, name = learner.policy_, kind_name_of(learner.policy_)
    kind, is_by_stage = kind_named(name), learner.model_.stages == "separate"
    summary, sha256, prior, facts = log_facts(parts_of(logs), kind, policy, is_by_stage)
    schema = kind.schema(policy) | prior
    sample = logs if isinstance(logs, Logs) else sample_of(logs, learner.random_state)
    known = {"name": None, "since": None, "changes": [], **(origin or {})}
    # Changes that weights by recency account for are no reason to doubt a decision.
    changes = [] if learner.model_.half_life else [each["sentence"] for each in known["changes"]]
    # The promise describes the cell in its latest state.
    present = latest(sample, learner.model_.half_life, logs.num_trajectories)
    positivity = positivity_report(logs.end_s, logs.is_finished, trajectory_ids=logs.trajectory_ids)
    return {
        "format": FORMAT,
        "version": VERSION,
        "versions": {
            "halfseen": halfseen.__version__,
            "python": platform.python_version(),
            "numpy": np.__version__,
        },
        "kind": name,
        "schema": schema,
        **facts,
        "learner": described(learner.model_),
        "chosen": list(learner.chosen_),
        "seed": int(learner.random_state),
        "reg": {
            "rows": "stage" if is_by_stage else "steps to go",
            "columns": schema.get("blocks", schema["actions"]),
            "values": np.asarray(learner.q_functions_.reg).tolist(),
        },
        "log": {
            "sha256": sha256,
            "sentence": str(summary),
            **asdict(summary),
            "sources": sources_of(logs.trajectories, known["name"]),
            "since": known["since"],
            "changes": known["changes"],
        },
        "diagnostics": _diagnostics(learner, summary.horizon, positivity),
        "warnings": [*_warnings(sample, positivity), *changes],
        "verdict": None if verdict is None else dict(verdict),
        "promise": {
            "value": None if verdict is None else verdict.get("value"),
            "stages": promised_states(present, schema.get("covariates", ())),
            **promised_parts(present, learner.policy_),
        },
    }


def _warnings(logs: Logs, positivity: PositivityReport) -> list[str]:
    """Objections of `halfseen inspect` to the log and what was learned from it, one per line."""
    weights = [] if positivity.is_sound else [str(positivity).splitlines()[0]]
    # Learning needs no propensities, so their absence is no reason to doubt a decision.
    return [*weights, *(each.sentence for each in data_warnings(logs) if each.kind != "no-probability")]


def _diagnostics(learner: CensoredQLearner, horizon: int, positivity: PositivityReport) -> dict[str, Any]:
    by_stage = [
        weight_diagnostics(column, getattr(learner.model_.targets, "truncate_at", None))
        for column in learner.weights_[:, :horizon].T
    ]
    return {
        "weights": asdict(learner.diagnostics_),
        "weights_by_stage": [asdict(one) for one in by_stage],
        "positivity": {
            "censoring": "kaplan-meier by trajectory",
            "text": str(positivity),
            "is_sound": positivity.is_sound,
            "mean_weight": positivity.mean_weight,
            "identified_until_s": positivity.identified_until_s,
        },
    }
