"""Finite worlds whose states have names and nothing else: exact values, logs with cuts by severity, random kin.

Rewards are of the state that is entered; states at the end of the list end a trajectory.
"""

from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from halfseen.logs import Logs

HOURS = 4.0
"""Between decisions; a cut falls in the middle."""
MOST_STAGES = 1000


class Steps(NamedTuple):
    """Begun stages of simulated trajectories, by trajectory."""

    trajectory: np.ndarray
    stage: np.ndarray
    state: np.ndarray
    action: np.ndarray
    successor: np.ndarray
    """−1 where the trajectory was cut."""


class FiniteWorld:
    """A Markov decision process.

    Parameters
    ----------
    chance
        P(s′ | s, a), shape (S, A, S).
    reward
        Of each state that is entered.
    start
        Chance to begin in each state.
    is_end
        States that end a trajectory.
    severity
        Of each state, by which cuts are more frequent.
    """

    def __init__(
        self, chance: np.ndarray, reward: np.ndarray, start: np.ndarray, is_end: np.ndarray, severity: np.ndarray
    ) -> None:
        self.chance, self.reward, self.start, self.is_end, self.severity = chance, reward, start, is_end, severity
        self.num_states, self.num_actions = chance.shape[:2]

    @property
    def names(self) -> np.ndarray:
        return np.array([f"s{k:03d}" for k in range(self.num_states)], dtype=object)

    @property
    def actions(self) -> list[str]:
        return [f"a{k:02d}" for k in range(self.num_actions)]

    def values(self, policy: np.ndarray) -> np.ndarray:
        """V of a policy π(a | s) in every state, by linear equations."""
        on, moves = ~self.is_end, np.einsum("sa,sat->st", policy, self.chance)
        found = np.zeros(self.num_states)
        found[on] = np.linalg.solve(np.eye(on.sum()) - moves[np.ix_(on, on)], (moves @ self.reward)[on])
        return found

    def worth(self, policy: np.ndarray) -> float:
        """What a trajectory brings."""
        return float(self.start @ self.values(policy))

    def best(self) -> np.ndarray:
        """The best policy, by policy iteration."""
        policy = np.full((self.num_states, self.num_actions), 1.0 / self.num_actions)
        worth = -np.inf
        while (now := self.worth(policy)) > worth + 1e-12:
            worth, policy = now, np.eye(self.num_actions)[self.q(self.values(policy)).argmax(axis=1)]
        return policy

    def q(self, value: np.ndarray) -> np.ndarray:
        return self.chance @ (self.reward + np.where(self.is_end, 0.0, value))

    def hazard(self, policy: np.ndarray, share: float) -> np.ndarray:
        """Chance of a cut in a stage, by state, so that this share of a policy's trajectories is cut."""
        if share == 0:
            return np.zeros(self.num_states)
        low, high = 0.0, 10.0
        for _ in range(60):
            rate = (low + high) / 2
            low, high = (rate, high) if self._cut(policy, rate) < share else (low, rate)
        return self._hazard(high)

    def _hazard(self, rate: float) -> np.ndarray:
        return 1.0 - np.exp(-rate * 2.0 ** np.clip(self.severity, -3.0, 3.0))

    def _cut(self, policy: np.ndarray, rate: float) -> float:
        on, hazard = ~self.is_end, self._hazard(rate)
        moves = np.einsum("sa,sat->st", policy, self.chance) * (1.0 - hazard)[:, None]
        visits = np.linalg.solve((np.eye(on.sum()) - moves[np.ix_(on, on)]).T, self.start[on])
        return float(visits @ hazard[on])

    @cached_property
    def _jumps(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Cumulative chances of all cells in a row, each cell's shifted by its number; where they lead; cells' ends."""
        cell, successor = np.nonzero(self.chance.reshape(-1, self.num_states))
        total = np.cumsum(self.chance.reshape(-1, self.num_states)[cell, successor])
        ends = np.flatnonzero(np.append(np.diff(cell), 1))
        return total - np.append(0.0, total[ends])[cell] + cell, successor, ends

    def simulate(self, num: int, policy: np.ndarray, hazard: np.ndarray, rng: np.random.Generator) -> Steps:
        """Follow a policy, until the end or a cut."""
        up_to, leads_to, ends = self._jumps
        chosen = np.cumsum(policy, axis=1)
        who, state, steps = np.arange(num), rng.choice(self.num_states, num, p=self.start), []
        for stage in range(1, MOST_STAGES + 1):
            action = (rng.random(len(who))[:, None] * chosen[state, -1:] > chosen[state]).sum(axis=1)
            cell = state * self.num_actions + action
            jump = np.searchsorted(up_to, cell + rng.random(len(who)), side="right")
            successor = leads_to[np.minimum(jump, ends[cell])]
            is_cut = rng.random(len(who)) < hazard[state]
            steps.append((who, np.full(len(who), stage), state, action, np.where(is_cut, -1, successor)))
            goes_on = ~is_cut & ~self.is_end[successor]
            who, state = who[goes_on], successor[goes_on]
            if not len(who):
                break
        columns = [np.concatenate(column) for column in zip(*steps, strict=True)]
        order = np.lexsort((columns[1], columns[0]))
        return Steps(*(column[order] for column in columns))

    def log(self, steps: Steps, policy: np.ndarray) -> Logs:
        """Steps as a log; its covariate is the name of the state."""
        done = steps.successor >= 0
        is_last = np.append(np.diff(steps.trajectory) > 0, True)
        stages = pd.DataFrame(
            {
                "trajectory": steps.trajectory,
                "stage": steps.stage,
                "elapsed_s": np.where(done, HOURS * steps.stage, np.nan) * 3600.0,
                "action": np.array(self.actions, dtype=object)[steps.action],
                "reward": np.where(done, self.reward[steps.successor], np.nan),
                "probability": policy[steps.state, steps.action],
                "state": self.names[steps.state],
            }
        )
        end = HOURS * (steps.stage - np.where(done, 0.0, 0.5))[is_last] * 3600.0
        ending = np.where(done, "finished", "cut")[is_last]
        return Logs(stages, pd.DataFrame({"trajectory": steps.trajectory[is_last], "end_s": end, "ending": ending}))


def random_world(seed: int, skill: float = 0.05, num_own: float = 3.0, tilt: float = 1.0) -> tuple[FiniteWorld, Any]:
    """Draw a world of the shape of ICU-Sepsis, for tuning: 700 states that lead to some forty others, 25 actions.

    Parameters
    ----------
    seed
        Of the draw.
    skill
        How far the expert prefers what is better.
    num_own
        Mean number of actions with an effect of their own in a state; the others do what these do on average.
    tilt
        How much actions differ.

    Returns
    -------
    tuple
        The world, and its expert π(a | s).
    """
    rng, num, num_actions, reach = np.random.default_rng(seed), 700, 25, 40
    health = rng.normal(size=num)
    chance = np.zeros((num + 2, num_actions, num + 2))
    own = np.zeros((num + 2, num_actions), dtype=bool)
    for s in range(num):
        near = np.argsort(np.abs(health - health[s]) + rng.exponential(1.0, num))[:reach]
        base = rng.dirichlet(np.full(reach, 0.5))
        some = rng.choice(num_actions, min(num_actions, 1 + rng.geometric(1.0 / num_own)), replace=False)
        own[s, some] = True
        ends = 0.1 * np.array([1.0, 0.0]) + 0.1 * np.array([-1.0, 1.0]) / (1.0 + np.exp(2.0 * health[s] + 2.0))
        for a in some:
            step = 0.5 * base + 0.5 * rng.dirichlet(0.5 * base * reach + 0.02)
            step *= np.exp(rng.normal(0.0, tilt) * (health[near] - health[s]))
            ending = ends * np.exp(rng.normal(0.0, 0.5 * tilt, 2))
            ending *= min(1.0, 0.9 / ending.sum())
            chance[s, a, near], chance[s, a, num:] = step / step.sum() * (1.0 - ending.sum()), ending
        chance[s, ~own[s]] = chance[s, some].mean(axis=0)
    chance[num:, :, num:] = np.eye(2)[:, None, :]
    is_end = np.arange(num + 2) >= num
    start = np.append(rng.dirichlet(np.full(num, 0.5)), [0.0, 0.0])
    world = FiniteWorld(chance, (np.arange(num + 2) == num) * 1.0, start, is_end, np.append(-health, [0.0, 0.0]))
    return world, _expert(world, own, skill, rng)


def _expert(world: FiniteWorld, own: np.ndarray, skill: float, rng: np.random.Generator) -> np.ndarray:
    q = world.q(world.values(np.full(own.shape, 1.0 / own.shape[1])))
    spread = q.std(axis=1, keepdims=True)
    better = (q - q.mean(axis=1, keepdims=True)) / np.where(spread > 0, spread, 1.0)
    whim = rng.gumbel(size=own.shape) * rng.choice([0.5, 1.5, 3.0], size=(len(own), 1))
    odds = np.exp(skill * better + whim + 2.0 * own)
    return odds / odds.sum(axis=1, keepdims=True)
