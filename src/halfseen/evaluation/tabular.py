"""Whether policies of a table of states beat the logging policy: doubly robust by state and action, cross-fitted.

With ν(s, a) the expected number of visits of a policy to a cell per trajectory, without cuts, and m(s, a) the expected
number of its completions in a logged one, a trajectory contributes

    V̂(S₁) + Σ_t ν̂(S_t, A_t)/m̂(S_t, A_t) · (R_t + V̂(S_{t+1}) − Q̂(S_t, A_t))

over its completed stages, with mean the value of the policy if either Q̂ or ν̂/m̂ is right [KallusUehara2020]_; m
includes that cuts come sooner in some states. Q̂, ν̂ and m̂ are fitted outside the trajectory's fold, like the policy:
means of cells, shrunk as those that the policy was learned from (`halfseen.learning.tabular`). Transitions do not
depend on the stage, so a completed stage is used for each number of stages to go, as there; one that the horizon ended
is used for the last only.
"""

from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse

from halfseen.evaluation.targets import CrossFitted
from halfseen.evaluation.verdict import Verdict
from halfseen.learning.discrete_policy import DiscretePolicy
from halfseen.learning.q_model import QModel
from halfseen.learning.rows import TrajectoryArrays
from halfseen.logs import Logs
from halfseen.shapes import Bool, Float, Int

FEWEST_STAGES = 10.0
"""Harmonic mean of the completed stages in the cells that policies visit; with fewer, no interval is valid."""
WIDER = 3.0
"""The variance is multiplied by 1 + `WIDER`/stages for the noise in means of few stages: our choice, made on random
worlds in which all actions are equal (`benchmarks/published/icu_verdicts.py` evaluates on others)."""
ROUNDING = 1e-12


class Gain(NamedTuple):
    """Gain of policies over the logging policy."""

    value: float
    low: float
    high: float
    num_stages: float
    """Harmonic mean of the completed stages in the cells that the policies visit, in the fold with the fewest."""

    def verdict(self, level: float) -> tuple[Verdict, str]:
        """The verdict, and its reason."""
        if self.num_stages < FEWEST_STAGES:
            few = f"the actions of the policy were completed {self.num_stages:.1f} times a state"
            return "inconclusive", f"{few}, but {FEWEST_STAGES:.0f} are needed; record more"
        found: Verdict = "better" if self.low > 0 else "not better" if self.high < 0 else "inconclusive"
        more = f"{abs(self.value):.3g} {'more' if self.value >= 0 else 'less'}"
        within = f"{level:.0%} interval {self.low:.3g} to {self.high:.3g} more"
        return found, f"it earns {more} than the logging policy ({within})"


class _CompletedRows(NamedTuple):
    """Completed stages."""

    trajectory: Int[np.ndarray, " m"]
    state: Int[np.ndarray, " m"]
    action: Int[np.ndarray, " m"]
    successor: Int[np.ndarray, " m"]
    """S after a trajectory finished."""
    reward: Float[np.ndarray, " m"]
    stage: Int[np.ndarray, " m"]
    """From 0."""

    def at(self, rows: Bool[np.ndarray, " m"]) -> "_CompletedRows":
        return _CompletedRows(*(each[rows] for each in self))


def gain_of(policy: CrossFitted, model: QModel, logs: Logs, kappa: float, level: float = 0.95) -> Gain:
    """Estimate the gain over the logging policy of policies that were learned without each fold.

    They use one covariate, the name of a state, which the model's task numbers; the mean of a state counts for κ
    stages.
    """
    trajectories = model.lay_out(logs)
    shape = len(policy.policies[0].coefficients[0, 0]), trajectories.is_possible.shape[-1]
    rows, first = _rows_of(trajectories, shape[0]), trajectories.features[:, 0, 0, 0].astype(np.int64) - 1
    gains, num_stages = np.zeros(len(first)), []
    for k, one in enumerate(policy.policies):
        is_in = policy.fold[rows.trajectory] == k
        world = _World(rows.at(~is_in), first[policy.fold != k], shape, kappa, policy.horizon)
        choices = _choices_of(one)
        ours, theirs = (world.added(which, rows.at(is_in), first) for which in (choices, None))
        num_stages.append(world.num_stages(choices))
        is_more = np.abs(ours - theirs) > ROUNDING * np.abs(theirs).max()
        gains = np.where(policy.fold == k, np.where(is_more, ours - theirs, 0.0), gains)
    value, error, fewest = float(gains.mean()), float(gains.std(ddof=1) / np.sqrt(len(gains))), min(num_stages)
    reach = NormalDist().inv_cdf((1.0 + level) / 2.0) * error * (1.0 + WIDER / fewest) ** 0.5
    return Gain(value, value - reach, value + reach, fewest)


class _Means:
    """Estimates from some completed stages for each state, and for each action there."""

    def __init__(self, rows: _CompletedRows, shape: tuple[int, int], num: int, kappa: float) -> None:
        self.num_actions, (num_states, num_actions) = shape[1], shape
        cell, size = rows.state * num_actions + rows.action, num_states * num_actions
        self.reward, self.moves, n = _means(cell, rows, size, num_states)
        self.reward_of_state, self.moves_of_state, n_of_state = _means(rows.state, rows, num_states, num_states)
        self.n, self.kept = n, n / np.maximum(n + kappa, np.finfo(float).tiny)
        self.completed, self.completed_of_state = n / num, n_of_state / num

    def following(self, choice: Int[np.ndarray, " S"] | None) -> tuple[Float[np.ndarray, " S"], Any]:
        """Reward, and transition matrix, if this action is taken in each state; None for the logging policy."""
        if choice is None:
            return self.reward_of_state, self.moves_of_state
        at = np.arange(len(choice)) * self.num_actions + choice
        kept = self.kept[at]
        reward = kept * self.reward[at] + (1.0 - kept) * self.reward_of_state
        return reward, _scaled(kept, self.moves[at]) + _scaled(1.0 - kept, self.moves_of_state)

    def ratio(
        self, rows: _CompletedRows, visits: Float[np.ndarray, " S"], choice: Int[np.ndarray, " S"] | None
    ) -> Float[np.ndarray, " m"]:
        """ν̂/m̂ of each row."""
        if choice is None:
            came, completed = visits[rows.state], self.completed_of_state[rows.state]
        else:
            came = np.where(rows.action == choice[rows.state], visits[rows.state], 0.0)
            completed = self.completed[rows.state * self.num_actions + rows.action]
        return np.divide(came, completed, out=np.zeros(len(came)), where=completed > 0)


class _World:
    """Model of the world, and of policies in it, from the trajectories outside a fold."""

    def __init__(
        self, rows: _CompletedRows, first: Int[np.ndarray, " n"], shape: tuple[int, int], kappa: float, horizon: int
    ) -> None:
        self.every = _Means(rows, shape, len(first), kappa)
        self.going = _Means(rows.at(rows.stage < horizon - 1), shape, len(first), kappa)
        self.start, self.horizon = np.bincount(first, minlength=shape[0]) / len(first), horizon

    def added(
        self, choices: Int[np.ndarray, "T S"] | None, rows: _CompletedRows, first: Int[np.ndarray, " n"]
    ) -> Float[np.ndarray, " n"]:
        """Contribution of each trajectory to the value of a policy, by stage and state; None for the logging policy."""
        chosen = [None if choices is None else choices[t] for t in range(self.horizon)]
        ways = [(self.every if t == self.horizon - 1 else self.going).following(chosen[t]) for t in range(self.horizon)]
        value = [np.zeros(len(self.start))]
        for reward, moves in reversed(ways):
            value.insert(0, self._known(reward + (moves @ value[0] if len(value) > 1 else 0.0)))
        total, visits, going = value[0][first], self.start, rows.at(rows.stage < self.horizon - 1)
        for t, (_, moves) in enumerate(ways):
            is_last = t == self.horizon - 1
            some, means = (rows, self.every) if is_last else (going, self.going)
            follows = 0.0 if is_last else np.append(value[t + 1], 0.0)[some.successor]
            wrong = some.reward + follows - value[t][some.state]
            total = total + np.bincount(some.trajectory, means.ratio(some, visits, chosen[t]) * wrong, len(first))
            visits = moves.T @ visits
        return total

    def num_stages(self, choices: Int[np.ndarray, "T S"]) -> float:
        """Harmonic mean of the completed stages in the cells that a policy visits."""
        visits, inverse, total = self.start, 0.0, 0.0
        # Of a single stage, all stages are the last one.
        means = self.going if self.horizon > 1 else self.every
        for choice in choices[: max(self.horizon - 1, 1)]:
            n = means.n[np.arange(len(choice)) * means.num_actions + choice]
            inverse, total = inverse + float((visits / np.maximum(n, 0.5)).sum()), total + float(visits.sum())
            visits = means.following(choice)[1].T @ visits
        return total / inverse if inverse > 0 else np.inf

    def _known(self, value: Float[np.ndarray, " S"]) -> Float[np.ndarray, " S"]:
        """The same; an unseen state has the mean value of the others."""
        seen = self.every.completed_of_state
        return np.where(seen > 0, value, np.average(value, weights=seen))


def _means(
    group: Int[np.ndarray, " m"], rows: _CompletedRows, size: int, num_states: int
) -> tuple[Float[np.ndarray, " g"], Any, Int[np.ndarray, " g"]]:
    """Mean reward, distribution of successors and number of rows by group; 0 for an empty one."""
    n = np.bincount(group, minlength=size)
    each, goes_on = 1.0 / np.maximum(n, 1), rows.successor < num_states
    pairs = (group[goes_on], rows.successor[goes_on])
    shares = scipy.sparse.csr_matrix((each[pairs[0]], pairs), shape=(size, num_states))
    return np.bincount(group, rows.reward, size) * each, shares, n


def _scaled(by: Float[np.ndarray, " S"], moves: Any) -> Any:
    return scipy.sparse.diags(by) @ moves


def _rows_of(trajectories: TrajectoryArrays, num_states: int) -> _CompletedRows:
    number = trajectories.features[:, :, 0, 0].astype(np.int64) - 1
    successor = np.where(trajectories.is_last, num_states, np.pad(number[:, 1:], ((0, 0), (0, 1)), constant_values=-1))
    done = trajectories.is_completed & (successor >= 0)
    who, stage = np.nonzero(done)
    action, reward = trajectories.action[done], trajectories.reward[done]
    return _CompletedRows(who, number[done], action, successor[done], reward, stage)


def _choices_of(policy: DiscretePolicy) -> Int[np.ndarray, "T S"]:
    """The policy's action in each stage and state."""
    q = policy.coefficients.copy()
    q[..., 1:] += q[..., :1]
    return np.argmax(np.where(policy.is_possible[..., None], q, -np.inf), axis=1)
