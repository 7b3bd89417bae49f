"""From logs to the dense arrays of the recursion: flat actions on plain covariates, or tables of objects."""

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple, Protocol, runtime_checkable

import jax
import numpy as np
import pandas as pd
from jaxtyping import Bool, Float, Int

from halfseen.errors import ArgumentError, LogError
from halfseen.learners.q_learning.flat_policy import covariate_values
from halfseen.logs import Logs
from halfseen.tables.features import block_of_action, table_features
from halfseen.world.action_space import FINISH, Verb, possible_actions
from halfseen.world.grasp_model import GraspModel
from halfseen.world.recording import states_of
from halfseen.world.state import TableState


class Encoded(NamedTuple):
    """What the Q-functions look at, and what was done."""

    features: Float[np.ndarray, "n T A F"]
    is_possible: Bool[np.ndarray, "n T A"]
    action: Int[np.ndarray, "n T"]


@runtime_checkable
class Encoding(Protocol):
    """How states and actions become features."""

    @property
    def num_blocks(self) -> int:
        """K, blocks of coefficients."""
        ...

    @property
    def end_action(self) -> int | None:
        """Action that ends a path wherever it is taken, if there is one."""
        ...

    def encode(self, logs: Logs) -> Encoded:
        """Encode every stage of a log; stages that a path does not have hold zeros."""
        ...

    def block_of_action(self, num_actions: int) -> Int[np.ndarray, " A"]:
        """Block of coefficients of each action."""
        ...


@dataclass(frozen=True)
class FlatEncoding:
    """Named actions, each with its own coefficients on the same covariates of the stage.

    Parameters
    ----------
    horizon
        T.
    actions
        Their names; or, by stage from 1, the names of those that are possible there.
    covariates
        Columns of the stages.
    """

    horizon: int
    actions: Sequence[Hashable] | Mapping[int, Sequence[Hashable]]
    covariates: Sequence[str]
    end_action: int | None = None

    def __post_init__(self) -> None:
        lists = self.actions if isinstance(self.actions, Mapping) else {"any": self.actions}
        for stage, names in lists.items():
            if len(names) == 0 or len(set(names)) < len(names):
                raise ArgumentError(f"actions of stage {stage} are {list(names)}; name at least one, and none twice")

    @property
    def names(self) -> list[Hashable]:
        """All actions, in the order in which they first appear."""
        if isinstance(self.actions, Mapping):
            return list(dict.fromkeys(name for stage in sorted(self.actions) for name in self.actions[stage]))
        return list(self.actions)

    @property
    def num_blocks(self) -> int:
        """One block an action."""
        return len(self.names)

    def block_of_action(self, num_actions: int) -> Int[np.ndarray, " A"]:
        """Block of each action: its own."""
        return np.arange(num_actions)

    def possible(self, stage: int) -> Bool[np.ndarray, " A"]:
        """Which actions are possible in a stage (from 1)."""
        if not isinstance(self.actions, Mapping):
            return np.ones(self.num_blocks, dtype=bool)
        if stage not in self.actions:
            raise ArgumentError(f"actions: none for stage {stage}; give a list for each stage 1 to {self.horizon}")
        return np.isin(np.arange(self.num_blocks), [self.names.index(name) for name in self.actions[stage]])

    def features(self, frame: pd.DataFrame) -> Float[np.ndarray, "rows A F"]:
        """Covariates of each row, the same for every action."""
        values = covariate_values(frame, tuple(self.covariates))
        return np.repeat(values[:, None, :], self.num_blocks, axis=1)

    def encode(self, logs: Logs) -> Encoded:
        """Encode every stage of a log of flat actions."""
        shape = (logs.num_paths, self.horizon, self.num_blocks)
        at = _place(logs)
        features = np.zeros((*shape, len(self.covariates)))
        features[at] = self.features(logs.stages)
        is_possible = np.broadcast_to([self.possible(stage + 1) for stage in range(self.horizon)], shape)
        action = np.zeros(shape[:2], dtype=np.int64)
        action[at] = self._codes(logs, is_possible)
        return Encoded(features, is_possible, action)

    def _codes(self, logs: Logs, is_possible: Bool[np.ndarray, "n T A"]) -> Int[np.ndarray, " rows"]:
        stages = logs.stages
        codes = pd.Index(self.names).get_indexer(stages["action"])
        is_given = stages["action"].notna().to_numpy()
        is_allowed = is_possible[0, stages["stage"].to_numpy() - 1, codes] & (codes >= 0)
        if (is_given & ~is_allowed).any():
            row = stages.iloc[int(np.argmax(is_given & ~is_allowed))]
            raise LogError(
                f"path {row['path']}, stage {row['stage']}: action {row['action']!r} was not possible there; the "
                f"learner was given {', '.join(map(repr, self.names))}"
            )
        return np.where(is_given, codes, 0)


@jax.jit
def encode_states(states: TableState, grasp: GraspModel | None = None) -> tuple[jax.Array, jax.Array]:
    """Features and possible actions of tables, axes (n, T); FINISH is possible even where there is no table."""
    each = jax.vmap(jax.vmap(partial(table_features, grasp=grasp))), jax.vmap(jax.vmap(possible_actions))
    return each[0](states), each[1](states)


@dataclass(frozen=True)
class TableEncoding:
    """WASH, LIFT and FINISH on a table of objects; one block of coefficients for each verb.

    Parameters
    ----------
    horizon
        T.
    grasp
        What tells the chance of a grasp in the features; None for Laplace's guess.
    """

    horizon: int
    grasp: GraspModel | None = None
    num_blocks: int = len(Verb)
    end_action: int | None = FINISH

    def block_of_action(self, num_actions: int) -> Int[np.ndarray, " A"]:
        """Block of each action: its verb."""
        return np.asarray(block_of_action((num_actions - 1) // 2))

    def encode(self, logs: Logs) -> Encoded:
        """Encode every stage of a log of tables."""
        states = states_of(logs, self.horizon)
        features, is_possible = (np.asarray(leaf) for leaf in encode_states(states, self.grasp))
        action = self._codes(logs, states.num_objects)
        _check_possible(logs, is_possible, action)
        return Encoded(features.astype(np.float64), is_possible, action)

    def _codes(self, logs: Logs, num_objects: int) -> Int[np.ndarray, "n T"]:
        stages = logs.stages
        verbs = pd.Index([verb.name for verb in Verb]).get_indexer(stages["action"])
        is_given = stages["action"].notna().to_numpy()
        needs_object = is_given & (verbs > 0)
        wrong = is_given & ((verbs < 0) | (needs_object & stages["object"].isna().to_numpy()))
        if wrong.any():
            row = stages.iloc[int(np.argmax(wrong))]
            raise LogError(
                f"path {row['path']}, stage {row['stage']}: action {row['action']!r} of object {row['object']} is none "
                "that a table knows; give WASH or LIFT with an object, or FINISH"
            )
        action = np.zeros((logs.num_paths, self.horizon), dtype=np.int64)
        target = _rank_of_target(logs)
        action[_place(logs)] = np.where(needs_object, 1 + (verbs - 1) * num_objects + target, FINISH)
        return action


def _place(logs: Logs) -> tuple[Int[np.ndarray, " rows"], Int[np.ndarray, " rows"]]:
    """Row of each stage's path, and its column."""
    return pd.Index(logs.path_ids).get_indexer(logs.stages["path"]), logs.stages["stage"].to_numpy() - 1


def _check_possible(logs: Logs, is_possible: Bool[np.ndarray, "n T A"], action: Int[np.ndarray, "n T"]) -> None:
    path, stage = _place(logs)
    wrong = ~is_possible[path, stage, action[path, stage]]
    if wrong.any():
        row = logs.stages.iloc[int(np.argmax(wrong))]
        raise LogError(
            f"path {row['path']}, stage {row['stage']}: {row['action']} of object {row['object']}, which is not on the "
            "table; fix the action's object or the object's location"
        )


def _rank_of_target(logs: Logs) -> Int[np.ndarray, " rows"]:
    """Rank of each stage's object among the objects of that stage; 0 where the action has none."""
    assert logs.objects is not None
    ranked = logs.objects[["path", "stage", "object"]].assign(
        rank=logs.objects.groupby(["path", "stage"]).cumcount().to_numpy()
    )
    merged = logs.stages[["path", "stage", "object"]].merge(ranked, on=["path", "stage", "object"], how="left")
    return merged["rank"].fillna(0).to_numpy(dtype=np.int64)
