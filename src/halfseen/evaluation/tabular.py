"""Whether policies of a table of states beat what made the log: doubly robust by state and action, cross-fitted.

With ν(s, a) how often a policy comes to a cell in a trajectory, if nothing is cut, and m(s, a) how often the log
completes it, a trajectory adds

    V̂(S₁) + Σ_t ν̂(S_t, A_t)/m̂(S_t, A_t) · (R_t + V̂(S_{t+1}) − Q̂(S_t, A_t))

over its completed stages, whose mean is the value of the policy where either Q̂ or ν̂/m̂ is right
[KallusUehara2020]_; that cuts come sooner in some states is part of m. Q̂, ν̂ and m̂ are of the trajectories outside its
fold, as is the policy: means of cells, shrunk as those that the policy was learned from (`halfseen.learning.tabular`).
A policy is judged by what it does with all stages to go.
"""

from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse

from halfseen.evaluation.targets import CrossFitted
from halfseen.learning.discrete_policy import DiscretePolicy
from halfseen.learning.q_model import QModel
from halfseen.learning.rows import TrajectoryArrays
from halfseen.logs import Logs
from halfseen.shapes import Float, Int


ROUNDING = 1e-12


class Gain(NamedTuple):
    """What policies earn more than what made the log."""

    value: float
    low: float
    high: float


class _Rows(NamedTuple):
    """Completed stages."""

    trajectory: Int[np.ndarray, " m"]
    state: Int[np.ndarray, " m"]
    action: Int[np.ndarray, " m"]
    successor: Int[np.ndarray, " m"]
    """S after a trajectory's own end."""
    reward: Float[np.ndarray, " m"]


def gain_of(policy: CrossFitted, model: QModel, logs: Logs, kappa: float, level: float = 0.95) -> Gain:
    """Estimate what policies that were learned without each fold earn more than the logging policy.

    Parameters
    ----------
    policy
        They; each a `DiscretePolicy` of one covariate, the name of the state.
    model
        Whose task numbers the states.
    logs
        The log.
    kappa
        Stages that the mean of a state counts for.
    level
        Of the interval.
    """
    trajectories = model.lay_out(logs)
    shape = len(policy.policies[0].coefficients[0, 0]), trajectories.is_possible.shape[-1]
    rows, first = _rows_of(trajectories, shape[0]), trajectories.features[:, 0, 0, 0].astype(np.int64) - 1
    gains = np.zeros(len(first))
    for k, one in enumerate(policy.policies):
        is_in = policy.fold[rows.trajectory] == k
        others, own = _Rows(*(each[~is_in] for each in rows)), _Rows(*(each[is_in] for each in rows))
        world = _World(others, first[policy.fold != k], shape, kappa, policy.horizon)
        ours, theirs = world.added(_choice_of(one), own, first), world.added(None, own, first)
        is_more = np.abs(ours - theirs) > ROUNDING * np.abs(theirs).max()
        gains = np.where(policy.fold == k, np.where(is_more, ours - theirs, 0.0), gains)
    value, error = float(gains.mean()), float(gains.std(ddof=1) / np.sqrt(len(gains)))
    reach = NormalDist().inv_cdf((1.0 + level) / 2.0) * error
    return Gain(value, value - reach, value + reach)


class _World:
    """What trajectories outside a fold tell of the world, and of policies in it."""

    def __init__(
        self, rows: _Rows, first: Int[np.ndarray, " n"], shape: tuple[int, int], kappa: float, horizon: int
    ) -> None:
        num_states, num_actions = shape
        cell, size, num = rows.state * num_actions + rows.action, num_states * num_actions, max(len(first), 1)
        self.n = np.bincount(cell, minlength=size)
        n_of_state = self.n.reshape(shape).sum(axis=1)
        self.reward, self.moves = _means(cell, rows, size, num_states)
        self.reward_of_state, self.moves_of_state = _means(rows.state, rows, num_states, num_states)
        self.kept = self.n / np.maximum(self.n + kappa, 1e-12)
        self.start, self.horizon, self.shape = np.bincount(first, minlength=num_states) / num, horizon, shape
        self.completed, self.completed_of_state = self.n / num, n_of_state / num

    def added(self, choice: Int[np.ndarray, " S"] | None, rows: _Rows, first: Int[np.ndarray, " n"]) -> np.ndarray:
        """What each trajectory adds to the value of a policy, by its action in each state; None for the log's own."""
        reward, moves = self.reward_of_state, self.moves_of_state
        if choice is not None:
            at = np.arange(self.shape[0]) * self.shape[1] + choice
            kept = self.kept[at]
            reward = kept * self.reward[at] + (1.0 - kept) * reward
            moves = _scaled(kept, self.moves[at]) + _scaled(1.0 - kept, moves)
        value, visits = self._solved(reward, moves)
        target = rows.reward + np.append(value, 0.0)[rows.successor]
        if choice is None:
            expected, came, completed = value[rows.state], visits[rows.state], self.completed_of_state[rows.state]
        else:
            cell = rows.state * self.shape[1] + rows.action
            expected = (reward + moves @ value)[rows.state]
            came = np.where(rows.action == choice[rows.state], visits[rows.state], 0.0)
            completed = self.completed[cell]
        ratio = np.divide(came, completed, out=np.zeros(len(came)), where=completed > 0)
        return value[first] + np.bincount(rows.trajectory, ratio * (target - expected), len(first))

    def _solved(self, reward: Float[np.ndarray, " S"], moves: Any) -> tuple[np.ndarray, np.ndarray]:
        """V and ν, over as many stages as a trajectory may have; a state never seen is worth what others are."""
        value, now, visits = np.zeros(self.shape[0]), self.start, np.zeros(self.shape[0])
        for _ in range(self.horizon):
            value, visits, now = reward + moves @ value, visits + now, moves.T @ now
        is_seen = self.completed_of_state > 0
        return np.where(is_seen, value, np.average(value, weights=self.completed_of_state)), visits


def _means(
    group: Int[np.ndarray, " m"], rows: _Rows, size: int, num_states: int
) -> tuple[Float[np.ndarray, " g"], Any]:
    """Mean reward, and share of successors, of rows by group; 0 of an empty one."""
    each = 1.0 / np.maximum(np.bincount(group, minlength=size), 1)
    goes_on = rows.successor < num_states
    pairs = (group[goes_on], rows.successor[goes_on])
    shares = scipy.sparse.csr_matrix((each[pairs[0]], pairs), shape=(size, num_states))
    return np.bincount(group, rows.reward, size) * each, shares


def _scaled(by: Float[np.ndarray, " S"], moves: Any) -> Any:
    return scipy.sparse.diags(by) @ moves


def _rows_of(trajectories: TrajectoryArrays, num_states: int) -> _Rows:
    number = trajectories.features[:, :, 0, 0].astype(np.int64) - 1
    successor = np.where(trajectories.is_last, num_states, np.pad(number[:, 1:], ((0, 0), (0, 1)), constant_values=-1))
    done = trajectories.is_completed & (successor >= 0)
    who = np.broadcast_to(np.arange(len(number))[:, None], number.shape)
    return _Rows(*(each[done] for each in (who, number, trajectories.action, successor, trajectories.reward)))


def _choice_of(policy: DiscretePolicy) -> Int[np.ndarray, " S"]:
    """Its action in each state, with all stages to go."""
    each = policy.coefficients[0]
    q = np.column_stack([each[:, 0], each[:, :1] + each[:, 1:]])
    return np.where(policy.is_possible[0][:, None], q, -np.inf).argmax(axis=0)
