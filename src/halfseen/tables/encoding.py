"""From logs of tables to the dense arrays that the learner runs on."""

from functools import partial

import jax
import numpy as np
import pandas as pd
from jaxtyping import Bool, Int

from halfseen.arrays import on_device
from halfseen.errors import LogError
from halfseen.learning.path_arrays import stage_places
from halfseen.learning.task import Encoded
from halfseen.logs import Logs
from halfseen.logs.refusal import refuse, shown, value_at
from halfseen.tables.features import table_features
from halfseen.world.action_space import FINISH, ActionSpace, Verb, possible_actions
from halfseen.world.grasp_model import GraspModel
from halfseen.world.recording import states_of
from halfseen.world.state import TableState
from halfseen.world.table_checks import object_numbers


@jax.jit
def encode_states(states: TableState, grasp: GraspModel | None = None) -> tuple[jax.Array, jax.Array]:
    """Features and possible actions of tables one after another; FINISH is possible even where there is no table."""
    return jax.vmap(partial(table_features, grasp=grasp))(states), jax.vmap(possible_actions)(states)


def encoded_states(
    states: TableState,
    action: Int[np.ndarray, "n T"],
    is_state: Bool[np.ndarray, "n T"],
    grasp: GraspModel | None = None,
) -> Encoded:
    """Encode tables, and what was done at each.

    Parameters
    ----------
    states
        Tables, axes (n, T); of more paths than n, the first are encoded.
    action
        What was done.
    is_state
        Where there is a table; elsewhere features are 0, and FINISH alone is possible.
    grasp
        What tells the probability of a grasp in the features; None for the rule of succession.
    """
    num_paths, horizon = is_state.shape
    at = np.flatnonzero(is_state)
    # Shapes that logs of about the same size share, for each is compiled for.
    index = np.pad(at, (0, -len(at) % 1024))

    def one_after_another(leaf: jax.Array) -> jax.Array:
        each = np.asarray(leaf)[:num_paths]
        return on_device(each.reshape(num_paths * horizon, *each.shape[2:]).take(index, axis=0))

    features, is_possible = (
        np.asarray(leaf)[: len(at)] for leaf in encode_states(jax.tree.map(one_after_another, states), grasp)
    )
    all_features = np.zeros((num_paths * horizon, *features.shape[1:]))
    all_possible = np.zeros((num_paths * horizon, *is_possible.shape[1:]), dtype=bool)
    all_possible[:, FINISH] = True
    all_features[at], all_possible[at] = features, is_possible
    shape = num_paths, horizon
    return Encoded(
        all_features.reshape(*shape, *features.shape[1:]), all_possible.reshape(*shape, *is_possible.shape[1:]), action
    )


def encode_tables(logs: Logs, horizon: int, grasp: GraspModel | None = None) -> Encoded:
    """Encode every stage of a log of tables.

    Parameters
    ----------
    logs
        The log.
    horizon
        T.
    grasp
        What tells the probability of a grasp in the features; None for the rule of succession.

    Raises
    ------
    LogError
        An action is none that a table knows, or is done to an object that is not on the table; several robots decided.
    """
    robots = logs.stages["robot"].nunique() if "robot" in logs.stages.columns else 1
    if robots > 1:
        raise LogError(
            f"stages: the log is of {robots} robots, and one table's policy decides for one; learn it with "
            "CensoredQLearner.for_team, or the part of one robot, halfseen.team.alone(logs, robot)"
        )
    states = states_of(logs, horizon)
    action = logged_actions(logs, horizon, states.num_objects)
    return encoded_states(states, action, np.any(np.asarray(states.is_on_table), axis=-1), grasp)


def logged_actions(logs: Logs, horizon: int, num_objects: int) -> Int[np.ndarray, "n T"]:
    """Action number of every stage; FINISH where the log has no stage, or no action.

    Raises
    ------
    LogError
        An action is none that a table knows.
    """
    stages = logs.stages
    verbs = pd.Index([verb.name for verb in Verb]).get_indexer(stages["action"])
    is_given = stages["action"].notna().to_numpy()
    needs_object = is_given & (verbs > 0)
    wrong = is_given & ((verbs < 0) | (needs_object & stages["object"].isna().to_numpy()))

    def unknown(row: int) -> str:
        verb, target = (shown(value_at(stages, column, row)) for column in ("action", "object"))
        return f"action {verb} of object {target} is none that a table knows; give {_verb_list()}"

    refuse(stages, wrong, unknown)
    action = np.full((logs.num_paths, horizon), FINISH, dtype=np.int64)
    codes = ActionSpace(num_objects).encode(np.maximum(verbs, 0), _number_of_target(logs))
    action[stage_places(logs)] = np.where(needs_object, codes, FINISH)
    return action


def _verb_list() -> str:
    *first, last = [verb.name for verb in Verb if verb is not Verb.FINISH]
    return f"{', '.join(first)} or {last} with an object, or FINISH"


def _number_of_target(logs: Logs) -> Int[np.ndarray, " rows"]:
    """Number of each stage's object among those of its path; 0 where the action has none."""
    assert logs.objects is not None
    numbered = logs.objects[["path", "stage", "object"]].assign(number=object_numbers(logs.objects))
    merged = logs.stages[["path", "stage", "object"]].merge(numbered, on=["path", "stage", "object"], how="left")
    return merged["number"].fillna(0).to_numpy(dtype=np.int64)
