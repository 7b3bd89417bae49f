"""The objects of a table, as a stage of a log has them, to where a path stands."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp

from halfseen.logs.journal.values import Schema
from halfseen.logs.recording.log_so_far import log_so_far
from halfseen.policies.folder.stored import StoredPolicy
from halfseen.tables.present import Present
from halfseen.world.recording import states_of

_NOTHING_DONE = {"robot": None, "action": None, "object": None, "probability": None}


def present_of(stored: StoredPolicy, objects: Sequence[dict[str, Any]], stage: int) -> tuple[Present, list[Any]]:
    """Put a table together from its objects.

    Parameters
    ----------
    stored
        A policy of tables.
    objects
        A dict for each, with the columns that `halfseen.world.recording` writes.
    stage
        The stage to decide, from 1.

    Returns
    -------
    present : Present
        Where its path stands.
    names : list
        Of the objects, by the numbers that actions have.

    Raises
    ------
    LogError
        They break a rule of tables.
    """
    _, told = Schema().with_stage({}, list(objects), _NOTHING_DONE, "the request")
    begun = {"event": "stage", "path": 1, "stage": 1, "at_s": 0.0, "columns": {}, **told}
    states = states_of(log_so_far([begun]), stored.horizon)
    state = jax.tree.map(lambda leaf: leaf[0, 0], states)
    state = replace(state, steps_to_go=jnp.int32(stored.horizon - stage + 1))
    dirty_share = stored.record["schema"]["dirty_share"]
    return Present(state, stage, is_labelled=True, dirty_share=dirty_share), sorted(one["object"] for one in objects)
