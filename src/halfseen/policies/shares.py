"""What a policy would have done in the states of a log."""

from typing import Any

import jax
import numpy as np
import pandas as pd
from jaxtyping import Int

from halfseen.learners.q_learning.encoding import TableEncoding
from halfseen.learners.q_learning.flat_policy import FlatPolicy
from halfseen.logs import Logs
from halfseen.tables.table_policy import LinearTablePolicy
from halfseen.world.action_space import Verb, verb_of
from halfseen.world.recording import states_of
from halfseen.world.state import TableState


def action_shares(policy: FlatPolicy | LinearTablePolicy, logs: Logs) -> pd.DataFrame:
    """Count how often a policy takes each action in the states of each stage; on a table, each verb.

    Parameters
    ----------
    policy
        A policy.
    logs
        A log that fits it.

    Returns
    -------
    DataFrame
        One row a stage (the index): ``num_states``; ``as_logged``, the share of the states with a known action in
        which the policy takes that one (NaN without such states); and ``shares``, for each action its share.
    """
    is_flat = isinstance(policy, FlatPolicy)
    taken, is_as_logged = _flat_choices(policy, logs) if is_flat else _table_choices(policy, logs)
    names = [str(name) for name in policy.actions] if is_flat else [verb.name for verb in Verb]
    rows = pd.DataFrame(
        {"stage": logs.stages["stage"].to_numpy(), "action": taken, "as_logged": is_as_logged.astype(float)}
    )
    rows.loc[logs.stages["action"].isna().to_numpy(), "as_logged"] = np.nan
    stages: Any = rows.groupby("stage")
    return pd.DataFrame(
        {
            "num_states": stages.size(),
            "as_logged": stages["as_logged"].mean(),
            "shares": stages["action"].agg(lambda codes: {n: float(np.mean(codes == k)) for k, n in enumerate(names)}),
        }
    )


def _flat_choices(policy: FlatPolicy, logs: Logs) -> tuple[Int[np.ndarray, " rows"], np.ndarray]:
    frame: Any = logs.stages
    taken = np.zeros(len(frame), dtype=np.int64)
    for stage in range(1, logs.horizon + 1):
        at = frame["stage"].eq(stage).to_numpy(dtype=bool)
        taken[at] = policy.probabilities(frame[at], stage).argmax(axis=1)
    return taken, taken == pd.Index(policy.actions).get_indexer(frame["action"])


@jax.jit
def _best(policy: LinearTablePolicy, states: TableState) -> jax.Array:
    return jax.vmap(jax.vmap(policy.q_values))(states).argmax(axis=-1)


def _table_choices(policy: LinearTablePolicy, logs: Logs) -> tuple[Int[np.ndarray, " rows"], np.ndarray]:
    horizon = len(policy.coefficients)
    states = states_of(logs, horizon)
    at = pd.Index(logs.path_ids).get_indexer(logs.stages["path"]), logs.stages["stage"].to_numpy() - 1
    taken = np.asarray(_best(policy, states))[at]
    verbs = np.asarray(verb_of(taken, states.num_objects)).astype(np.int64)
    return verbs, taken == TableEncoding(horizon, policy.grasp).encode(logs).action[at]
