"""What the policy that is evaluated would have done in each stage of a log: π(a | S_t)."""

from collections.abc import Hashable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from jaxtyping import Array, Float

from halfseen.errors import ArgumentError
from halfseen.learners.q_learning.encoding import FlatEncoding
from halfseen.learners.q_learning.path_arrays import PathArrays
from halfseen.learners.q_learning.q_learner import CensoredQLearner
from halfseen.logs import Logs
from halfseen.world.action_space import possible_actions
from halfseen.world.policy import ExploringPolicy, Policy, UniformPolicy
from halfseen.world.recording import states_of
from halfseen.world.state import TableState


@runtime_checkable
class NamedActionPolicy(Protocol):
    """Tells the probability of each named action from plain covariates; `FlatPolicy` is one."""

    actions: tuple[Hashable, ...]

    @property
    def horizon(self) -> int:
        """Number T of stages."""
        ...

    def probabilities(self, frame: pd.DataFrame, stage: int) -> Float[np.ndarray, "m A"]:
        """π(a | S) in a stage (from 1), for each row of covariates."""
        ...


@dataclass(frozen=True)
class FixedSequence:
    """Takes the same action for everyone, one for each stage: what a policy has to beat.

    Parameters
    ----------
    sequence
        The action of each stage.

    Examples
    --------
    >>> FixedSequence(("B", "A")).probabilities(pd.DataFrame(index=range(2)), stage=1)
    array([[1., 0.],
           [1., 0.]])
    """

    sequence: tuple[Hashable, ...]

    @property
    def actions(self) -> tuple[Hashable, ...]:
        """Names, in the order in which they first appear."""
        return tuple(dict.fromkeys(self.sequence))

    @property
    def horizon(self) -> int:
        """Number T of stages."""
        return len(self.sequence)

    def probabilities(self, frame: pd.DataFrame, stage: int) -> Float[np.ndarray, "m A"]:
        """1 for the action of that stage (from 1)."""
        is_taken = [name == self.sequence[stage - 1] for name in self.actions]
        return np.tile(np.array(is_taken, dtype=np.float64), (len(frame), 1))


def target_probabilities(
    policy: Any, logs: Logs, paths: PathArrays, model: CensoredQLearner
) -> Float[np.ndarray, "n T A"]:
    """π(a | S_t) of every stage that was begun; 0 elsewhere.

    Parameters
    ----------
    policy
        A `NamedActionPolicy`, or for a table any `Policy` without chance, or one mixed with `UniformPolicy`.
    logs
        The log.
    paths
        The same, laid out by `model`.
    model
        Names the actions and the horizon.

    Raises
    ------
    ArgumentError
        The policy is for another horizon, other actions or another kind of log, takes an action that is not possible,
        or draws its actions and cannot say how.
    """
    encoding = model.encoding
    if isinstance(encoding, FlatEncoding):
        _check_kind(policy, NamedActionPolicy, "named actions", model.horizon)
        chances = _named_chances(policy, logs, model.horizon, encoding.names)
    else:
        _check_kind(policy, Policy, "tables", model.horizon)
        chances = np.array(_chances_at(policy, states_of(logs, model.horizon)), dtype=np.float64)
    chances = np.where(paths.is_begun[..., None], chances, 0.0)
    _refuse_unknown(chances, policy)
    _refuse_impossible(chances, paths)
    return chances


def table_chances(policy: Any, state: TableState) -> Float[Array, " A"]:
    """π(a | S) of one table; NaN where the policy draws its actions and does not say how."""
    is_possible = possible_actions(state)
    uniform = is_possible / jnp.sum(is_possible)
    if isinstance(policy, UniformPolicy):
        return uniform
    if isinstance(policy, ExploringPolicy):
        return policy.random_share * uniform + (1.0 - policy.random_share) * table_chances(policy.base, state)
    decision = policy.decide(state, jax.random.key(0))
    is_taken = jnp.arange(len(is_possible)) == decision.action
    return jnp.where(decision.probability == 1.0, is_taken.astype(uniform.dtype), jnp.nan)


@jax.jit
def _chances_at(policy: Any, states: TableState) -> Float[Array, "n T A"]:
    return jax.vmap(jax.vmap(lambda state: table_chances(policy, state)))(states)


def _named_chances(
    policy: NamedActionPolicy, logs: Logs, horizon: int, names: list[Hashable]
) -> Float[np.ndarray, "n T A"]:
    unknown = [name for name in policy.actions if name not in names]
    if unknown:
        listed = ", ".join(map(repr, names))
        raise ArgumentError(f"the policy takes {unknown[0]!r}, which is none of the actions of the model: {listed}")
    column = [names.index(name) for name in policy.actions]
    at_path = pd.Index(logs.path_ids).get_indexer(logs.stages["path"])
    chances = np.zeros((logs.num_paths, horizon, len(names)))
    for stage in range(1, logs.horizon + 1):
        rows = (logs.stages["stage"] == stage).to_numpy()
        frame: Any = logs.stages[rows]
        chances[at_path[rows][:, None], stage - 1, column] = policy.probabilities(frame, stage)
    return chances


def _check_kind(policy: Any, kind: type, what: str, horizon: int) -> None:
    if not isinstance(policy, kind):
        raise ArgumentError(f"{type(policy).__name__} decides nothing about {what}, which the model is for")
    own = getattr(policy, "horizon", None)
    coefficients = getattr(policy, "coefficients", None)
    if own is None and coefficients is not None:
        own = coefficients.shape[0]
    if own is not None and own != horizon:
        raise ArgumentError(f"the policy is for {own} stages and the model for {horizon}; make their horizons equal")


def _refuse_unknown(chances: Float[np.ndarray, "n T A"], policy: Any) -> None:
    if np.isnan(chances).any():
        raise ArgumentError(
            f"{type(policy).__name__} draws its actions and does not say how likely each is, which evaluation by a log "
            "needs; evaluate it by simulation"
        )


def _refuse_impossible(chances: Float[np.ndarray, "n T A"], paths: PathArrays) -> None:
    wrong = paths.is_begun[..., None] & (chances > 0) & ~paths.is_possible
    if wrong.any():
        path, stage, action = np.argwhere(wrong)[0]
        raise ArgumentError(
            f"path {paths.path_ids[path]}, stage {stage + 1}: the policy takes action number {action + 1}, which is "
            "not possible there; give a policy for the actions of this stage"
        )
