"""The task of named actions: each action has its own coefficients on the same plain covariates of the stage."""

from collections import Counter
from collections.abc import Hashable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import pandas as pd

from halfseen.errors import ArgumentError, LogError, did_you_mean
from halfseen.estimator import check_names, is_count
from halfseen.learning.behaviour import seen_among
from halfseen.learning.covariates import Categories, Covariates, learned_categories, unfit_covariates
from halfseen.learning.discrete_policy import DiscretePolicy, NamedActionPolicy, checked_probabilities
from halfseen.learning.rows import stage_places
from halfseen.learning.task import ACTION, Encoded, LearnedQ, RewardedStages
from halfseen.logs import Logs
from halfseen.logs.missing import Filling
from halfseen.shapes import Bool, Float, Int

MOST_MEMORY = 8e9
"""Limit for the features of all stages and actions of a log [bytes]."""

KNOWN_LATER = ("elapsed_s", "reward", "probability")
"""Columns of the stages that no policy can use."""

Actions = Sequence[Hashable] | Mapping[int, Sequence[Hashable]]


@dataclass(frozen=True)
class NamedActions:
    """Named actions on plain covariates (a `Task`).

    Parameters
    ----------
    actions
        Their names, or a mapping from stage (from 1) to the names of the actions possible there.
    covariates
        Columns of the stages that Q uses.
    categories
        Categories of the text columns; those not given are learned by `fitted`.
    filling
        Values that replace missing covariates, as `fitted` finds them in the log; None if null is refused.

    Raises
    ------
    ArgumentError
        A stage has no action, or one twice; a covariate is named twice; or the names are a single string.
    """

    actions: Actions
    covariates: Sequence[str] = ()
    categories: Categories = field(default_factory=dict)
    filling: Filling | None = None

    end_action = None
    is_shared = True

    def __post_init__(self) -> None:
        if isinstance(self.actions, str | Iterator) or not isinstance(self.actions, Iterable):
            raise ArgumentError(f"actions is {self.actions!r}; give a list of names, or one for each stage")
        check_names("covariates", self.covariates)
        twice = [name for name, count in Counter(self.covariates).items() if count > 1]
        if twice:
            raise ArgumentError(f"covariates names {twice[0]!r} twice; name it once")
        late = [name for name in self.covariates if name in KNOWN_LATER]
        if late:
            raise ArgumentError(
                f"covariates names {late[0]!r}, which is known only once the action is chosen; leave it out"
            )
        lists = self.actions if isinstance(self.actions, Mapping) else {None: self.actions}
        for stage, names in lists.items():
            if stage is not None and not is_count(stage):
                raise ArgumentError(f"actions: stage {stage!r} does not exist; name the stages 1 to the horizon")
            if not all(isinstance(name, Hashable) for name in names):
                raise ArgumentError(f"actions are {list(names)}; give a list of names, or one for each stage")
            if len(names) == 0 or len(set(names)) < len(names):
                where = "actions" if stage is None else f"actions of stage {stage}"
                raise ArgumentError(f"{where} are {list(names)}; name at least one, and none twice")

    @property
    def names(self) -> list[Hashable]:
        """All actions, in the order in which they first appear."""
        if isinstance(self.actions, Mapping):
            return list(dict.fromkeys(name for stage in sorted(self.actions) for name in self.actions[stage]))
        return list(self.actions)

    @property
    def block_names(self) -> tuple[str, ...]:
        """Names of the actions."""
        return tuple(map(str, self.names))

    def fitted(self, logs: Logs, horizon: int) -> "NamedActions":
        """Learn the categories of the text columns of a log, whether Q uses them or cuts may depend on them.

        Raises
        ------
        LogError
            A covariate of Q holds text that cannot be used; the message gives the reason.
        """
        return self.fitted_to_parts([logs], logs.filling)

    def fitted_to_parts(self, parts: Iterable[Logs], filling: Filling | None) -> "NamedActions":
        """Do the same from a log in parts of whole trajectories, and store the replacements of its nulls."""
        return replace(self, categories=learned_categories(parts, self.covariates, self.categories), filling=filling)

    @property
    def looks_at(self) -> Covariates:
        """The encoding of the covariates of Q."""
        return Covariates(tuple(self.covariates), self.categories)

    def block_of_action(self, num_actions: int) -> Int[np.ndarray, " A"]:
        """Block of each action: its own."""
        return np.arange(num_actions)

    def possible(self, stage: int) -> Bool[np.ndarray, " A"]:
        """Which actions are possible in a stage (from 1)."""
        if not isinstance(self.actions, Mapping):
            return np.ones(len(self.names), dtype=bool)
        if stage not in self.actions:
            raise ArgumentError(f"actions: none for stage {stage}; give a list for each stage from 1 to the horizon")
        return np.isin(np.arange(len(self.names)), [self.names.index(name) for name in self.actions[stage]])

    def encode(self, logs: Logs, horizon: int) -> Encoded:
        """Encode every stage of a log of named actions."""
        shape = (logs.num_trajectories, horizon, len(self.names))
        self._refuse_too_large(shape)
        at = stage_places(logs)
        values = self.looks_at.encode(logs.stages)
        features = np.zeros((*shape, values.shape[1]))
        features[at] = values[:, None, :]
        is_possible = np.broadcast_to(self._possible_by_stage(horizon), shape)
        action = np.zeros(shape[:2], dtype=np.int64)
        action[at] = self._codes(logs, is_possible)
        return Encoded(features, is_possible, action)

    def outcome_features(self, names: Sequence[str]) -> Float[np.ndarray, " F"]:
        """1 for each feature of these covariates, 0 for the others.

        Raises
        ------
        ArgumentError
            One of them is not a covariate of Q.
        """
        check_names("outcome_covariates", names)
        unknown = [name for name in names if name not in self.covariates]
        if unknown:
            known = ", ".join(self.covariates) + did_you_mean(unknown[0], self.covariates)
            raise ArgumentError(f"outcome_covariates names {unknown[0]!r}, which is not among the covariates {known}")
        return np.isin(np.array(self.looks_at.sources), list(names)).astype(np.float64)

    def censoring_covariates(self, logs: Logs, names: Sequence[str] | None, is_by_trajectory: bool) -> pd.DataFrame:
        """Columns of the stages as numbers, and indicators of all actions but the first in sorted order.

        They are NaN if the action is not known.

        Raises
        ------
        LogError
            The log lacks a column.
        ArgumentError
            A column holds neither numbers nor usable text.
        """
        columns = [*self.covariates, *([] if is_by_trajectory else [ACTION])] if names is None else names
        missing = [name for name in columns if name not in logs.stages.columns]
        if missing:
            there = ", ".join(logs.stages.columns) + did_you_mean(missing[0], logs.stages.columns)
            raise LogError(f"the stages have no column {missing[0]!r}; they have {there}")
        # A penalty on the indicators must not depend on the order in which the actions are given.
        contrasted = sorted(self.names, key=str)[1:]
        parts = [
            action_indicators(logs.stages[ACTION], contrasted) if name == ACTION else self._numbers(logs, name)
            for name in columns
        ]
        return pd.concat([pd.DataFrame(index=logs.stages.index), *parts], axis=1)

    def fitted_to_rewards(self, parts: Iterable[RewardedStages]) -> "NamedActions":
        """Return the task unchanged: it has no model of the noise."""
        return self

    def reduce_variance(self, stages: RewardedStages) -> tuple[Float[np.ndarray, "n T"], None]:
        """Return rewards unchanged."""
        return stages.reward, None

    def policy(self, learned: LearnedQ) -> DiscretePolicy:
        """Policy that follows Q-functions, or a batch of them, and takes only actions that have a value."""
        coefficients, seen, margin = learned.coefficients, learned.is_seen, learned.margin
        possible = self._possible_by_stage(coefficients.shape[-3])
        return DiscretePolicy(
            actions=tuple(self.names),
            covariates=tuple(self.covariates),
            is_possible=possible if seen is None else np.asarray(seen_among(possible, seen[::-1])),
            coefficients=np.asarray(coefficients[..., ::-1, :, :]),
            kernel_map=learned.kernel_map,
            margin=None if margin is None else margin[..., ::-1, :, :, :],
            behaviour=learned.behaviour,
            behaviour_weight=learned.behaviour_weight,
            categories={name: self.categories[name] for name in self.covariates if name in self.categories},
            filling=self.filling,
        )

    def target_probabilities(self, policy: Any, logs: Logs, horizon: int) -> Float[np.ndarray, "n T A"]:
        """π(a | S_t) of a `NamedActionPolicy` in every stage of a log.

        Raises
        ------
        ArgumentError
            The policy is not a `NamedActionPolicy`, takes an action that the task does not have, or gives numbers that
            are no probabilities.
        """
        if not isinstance(policy, NamedActionPolicy):
            raise ArgumentError(
                f"{type(policy).__name__} does not decide about named actions; give a policy with actions, horizon and "
                "probabilities, such as a learner's policy_"
            )
        is_known = np.array([name in self.names for name in policy.actions], dtype=bool)
        column = [self.names.index(name) for name in policy.actions if name in self.names]
        trajectory, _ = stage_places(logs)
        probabilities = np.zeros((logs.num_trajectories, horizon, len(self.names)))
        for stage in range(1, logs.horizon + 1):
            rows = (logs.stages["stage"] == stage).to_numpy()
            frame: Any = logs.stages[rows]
            given = checked_probabilities(policy, frame, stage)
            # An action that no log has may be named as long as it is not taken.
            for k in np.flatnonzero(~is_known & (given > 0).any(axis=0)).tolist():
                unknown = policy.actions[k]
                listed = ", ".join(map(repr, self.names)) + did_you_mean(unknown, self.names)
                raise ArgumentError(f"the policy takes {unknown!r}, which is not an action of the task: {listed}")
            probabilities[trajectory[rows][:, None], stage - 1, column] = given[:, is_known]
        return probabilities

    def _refuse_too_large(self, shape: tuple[int, int, int]) -> None:
        num_features = self.looks_at.num_features
        needed = 8.0 * num_features * float(np.prod(shape))
        if needed > MOST_MEMORY:
            raise ArgumentError(
                f"{num_features} features of {shape[2]} actions, in {shape[0]:,} trajectories of up to {shape[1]} "
                f"stages, take {needed / 1e9:.3g} GB, and {MOST_MEMORY / 1e9:.3g} GB are allowed; leave covariates "
                "out, or group their categories"
            )

    def _possible_by_stage(self, horizon: int) -> Bool[np.ndarray, "T A"]:
        return np.stack([self.possible(stage) for stage in range(1, horizon + 1)])

    def _numbers(self, logs: Logs, name: str) -> Any:
        if pd.api.types.is_numeric_dtype(logs.stages[name].dtype) and name not in self.categories:
            return logs.stages[[name]].astype(float)
        if name not in self.categories:
            trouble = unfit_covariates([logs]).get(name, "is not a covariate of the stages; leave it out")
            raise ArgumentError(f"censoring covariate {name!r} {trouble}")
        looks_at = Covariates((name,), self.categories)
        return pd.DataFrame(looks_at.encode(logs.stages), index=logs.stages.index, columns=pd.Index(looks_at.names))

    def _codes(self, logs: Logs, is_possible: Bool[np.ndarray, "n T A"]) -> Int[np.ndarray, " rows"]:
        stages = logs.stages
        codes = pd.Index(self.names).get_indexer(stages["action"])
        is_given = stages["action"].notna().to_numpy()
        is_allowed = is_possible[0, stages["stage"].to_numpy() - 1, codes] & (codes >= 0)
        if (is_given & ~is_allowed).any():
            row = stages.iloc[int(np.argmax(is_given & ~is_allowed))]
            raise LogError(
                f"trajectory {row['trajectory']}, stage {row['stage']}: action {row['action']!r} was not possible "
                f"there; the learner was given {', '.join(map(repr, self.names))}"
            )
        return np.where(is_given, codes, 0)


def action_indicators(taken: Any, actions: Sequence[Hashable]) -> pd.DataFrame:
    """Indicators of actions, ``action=NAME``; NaN if the action is not known."""
    is_unknown = taken.isna().to_numpy()
    columns = {f"action={name}": np.where(is_unknown, np.nan, taken.eq(name).to_numpy(float)) for name in actions}
    return pd.DataFrame(columns, index=taken.index)
