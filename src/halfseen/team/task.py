"""The task of a team: one Q for all robots, decided one robot at a time, with a block for each verb and one for WAIT."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Float, Int

from halfseen.errors import ArgumentError
from halfseen.learners.q_learning.path_arrays import stage_places
from halfseen.learners.q_learning.task import Encoded, LearnedQ, RewardedStages
from halfseen.logs import Logs
from halfseen.tables.censoring_covariates import TABLE_COVARIATES, table_covariates
from halfseen.team.actions import WAIT, possible_actions, wait_of
from halfseen.team.features import team_features
from halfseen.team.learned_policy import LinearTeamPolicy
from halfseen.team.recording import TEAM_VERBS, states_of
from halfseen.team.state import TeamState
from halfseen.world.action_space import TARGETED, ActionSpace
from halfseen.world.table_checks import object_numbers


@jax.jit
def _encoded(states: TeamState) -> tuple[jax.Array, jax.Array]:
    each = jax.vmap(jax.vmap(lambda state: (team_features(state), possible_actions(state))))
    return each(states)


@dataclass(frozen=True)
class TeamTask:
    """Several robots at one table (a `Task`)."""

    block_names = TEAM_VERBS
    end_action = None
    is_shared = False

    def fitted(self, logs: Logs, horizon: int) -> "TeamTask":
        """Nothing is learned beforehand."""
        return self

    def encode(self, logs: Logs, horizon: int) -> Encoded:
        """Encode every stage of a log of a team."""
        states = states_of(logs, horizon)
        features, is_possible = (np.array(leaf) for leaf in _encoded(states))
        is_state = np.zeros((logs.num_paths, horizon), dtype=bool)
        is_state[stage_places(logs)] = True
        features[~is_state], is_possible[~is_state] = 0.0, False
        is_possible[~is_state, 0] = True
        action = np.zeros(is_state.shape, dtype=np.int64)
        action[stage_places(logs)] = _actions(logs, states.table.num_objects)
        return Encoded(features.astype(np.float64), is_possible, action)

    def block_of_action(self, num_actions: int) -> Int[np.ndarray, " A"]:
        """Block of each action: its verb."""
        return np.append(ActionSpace.of_size(num_actions - 1).verbs, WAIT)

    def outcome_features(self, names: Sequence[str]) -> Float[np.ndarray, " F"]:
        """A team's features have no names to choose by."""
        raise ArgumentError(f"outcome_covariates is {list(names)}; of a team the outcome regression uses all features")

    def censoring_covariates(self, logs: Logs, names: Sequence[str] | None, is_by_path: bool) -> pd.DataFrame:
        """What cuts may depend on, a row for each stage."""
        return table_covariates(logs, TABLE_COVARIATES if names is None else names)

    def fitted_to_rewards(self, parts: Iterable[RewardedStages]) -> "TeamTask":
        """Nothing is learned from rewards."""
        return self

    def reduce_variance(
        self, stages: RewardedStages
    ) -> tuple[Float[np.ndarray, "n T"], Float[np.ndarray, "n T Z"] | None]:
        """Rewards as they are."""
        return stages.reward, None

    def policy(self, learned: LearnedQ) -> LinearTeamPolicy:
        """Policy in single precision."""
        single = partial(jnp.asarray, dtype=jnp.float32)
        margin = None if learned.margin is None else single(learned.margin)
        seen = None if learned.is_seen is None else jnp.asarray(learned.is_seen)
        return LinearTeamPolicy(single(learned.coefficients), seen, margin)

    def target_probabilities(self, policy: Any, logs: Logs, horizon: int) -> Float[np.ndarray, "n T A"]:
        """Not known yet."""
        raise ArgumentError("policies of a team are not judged by logs yet; play them with halfseen.team.episodes")


def _actions(logs: Logs, num_objects: int) -> Int[np.ndarray, " rows"]:
    stages = logs.stages
    verbs = pd.Index(TEAM_VERBS).get_indexer(stages["action"])
    assert logs.objects is not None
    numbered = logs.objects[["path", "stage", "object"]].assign(number=object_numbers(logs.objects))
    merged = stages[["path", "stage", "object"]].merge(numbered, on=["path", "stage", "object"], how="left")
    target = merged["number"].fillna(0).to_numpy(dtype=np.int64)
    codes = ActionSpace(num_objects).encode(np.maximum(verbs, 0), target)
    return np.select([np.isin(verbs, TARGETED), verbs == WAIT], [codes, wait_of(num_objects)], 0)
