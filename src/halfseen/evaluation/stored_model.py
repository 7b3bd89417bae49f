"""How a policy in a folder is to be evaluated: with the Q and the model of the cuts that it was learned with."""

from collections.abc import Hashable
from typing import Any

from halfseen.censoring import CENSORING_NAMES
from halfseen.learners.q_learning.flat_policy import FlatPolicy
from halfseen.learners.q_learning.q_learner import CensoredQLearner
from halfseen.logs import Logs
from halfseen.policies.folder import StoredPolicy

KEPT = ("q_function", "censoring_by", "censoring_covariates", "stages", "num_landmarks", "gamma", "truncate_at")
"""Parameters of the learner that the evaluation shares."""


def model_of(stored: StoredPolicy, logs: Logs, **chosen: Any) -> CensoredQLearner:
    """Make the learner whose parameters say how to evaluate.

    Parameters
    ----------
    stored
        The policy, with the parameters that it was learned with. A model of the cuts that has no name, or is none,
        gives way to ``"kaplan-meier"``; targets are imputed where the log allows it.
    logs
        The log that it is evaluated on.
    chosen
        Parameters that are to be others; None for those that are not.
    """
    learned = stored.record["learner"]
    parameters = {name: learned[name] for name in KEPT if name in learned}
    named = learned.get("censoring")
    parameters["censoring"] = named if named in CENSORING_NAMES else "kaplan-meier"
    parameters["augmented"] = bool(logs.stages["action"].notna().all())
    parameters |= {name: value for name, value in chosen.items() if value is not None}
    policy = stored.policy
    if not isinstance(policy, FlatPolicy):
        parameters["reduces_variance"] = bool(learned.get("reduces_variance", True))
        return CensoredQLearner.for_table(stored.horizon, grasp=policy.grasp, **parameters)
    actions = {stage: _actions_of(policy, logs, stage) for stage in range(1, stored.horizon + 1)}
    return CensoredQLearner(stored.horizon, actions, policy.covariates, **parameters)


def _actions_of(policy: FlatPolicy, logs: Logs, stage: int) -> list[Hashable]:
    """Actions that the policy may take in a stage, and those that were taken there and it never would."""
    own = [name for name, is_it in zip(policy.actions, policy.is_possible[stage - 1], strict=True) if is_it]
    logged = logs.stages.loc[logs.stages["stage"] == stage, "action"].dropna().unique().tolist()
    return list(dict.fromkeys([*own, *sorted(logged, key=str)]))
