"""The tiger for pomdp-py's POMCP; leaner than the models that it ships, which make new objects at every step."""

from random import random
from typing import Any

from peers.belief import ByIdentity, planned, pomdp_py

OVER = 1000
"""Steps that the last action takes: they end the simulation, whatever its depth."""

RIGHT, DISCOUNT = 0.85, 0.95
LISTEN, OPEN_LEFT = 0, 1


class Action(ByIdentity, pomdp_py.Action):
    def __init__(self, number: int) -> None:
        self.number = number


class Observation(ByIdentity, pomdp_py.Observation):
    pass


class State(ByIdentity, pomdp_py.State):
    def __init__(self, side: int, steps_to_go: int) -> None:
        self.side, self.steps_to_go = side, steps_to_go


class TigerModel(pomdp_py.BlackboxModel):
    def __init__(self, horizon: int) -> None:
        self.heard = [Observation(), Observation()]
        self.states = [[State(side, to_go) for side in (0, 1)] for to_go in range(horizon + 1)]

    def sample(self, state: State, action: Action) -> tuple[State, Observation, float, int]:
        number, side, draw = action.number, state.side, random()
        num_steps = OVER if state.steps_to_go == 1 else 1
        later = self.states[state.steps_to_go - 1]
        if number == LISTEN:
            return later[side], self.heard[side if draw < RIGHT else 1 - side], -1.0, num_steps
        return later[draw < 0.5], self.heard[0], -100.0 if number == OPEN_LEFT + side else 10.0, num_steps


class RandomPolicy(pomdp_py.RolloutPolicy):
    """Any action in roll-outs."""

    def __init__(self) -> None:
        self.actions = tuple(Action(number) for number in range(3))

    def get_all_actions(self, state: Any = None, history: Any = None) -> tuple[Action, ...]:
        return self.actions

    def rollout(self, state: State, history: Any = None) -> Action:
        return self.actions[int(3 * random())]


class ListeningPolicy(RandomPolicy):
    """Roll-outs only listen."""

    def rollout(self, state: State, history: Any = None) -> Action:
        return self.actions[LISTEN]


def decided(
    left_chance: float, steps_to_go: int, *, budget_s: float, rollouts: str, exploration: float
) -> tuple[int, int, float]:
    """The action that the peer takes, its simulations, and how long they took [s]."""
    model = TigerModel(steps_to_go)
    left, right = model.states[steps_to_go]
    # The belief is handed out draw by draw: more of them than the shortest budgets use.
    states = [left if random() < left_chance else right for _ in range(1000 + int(200_000 * budget_s))]
    action, num_simulations, elapsed_s = planned(
        states,
        model,
        {"random": RandomPolicy, "listening": ListeningPolicy}[rollouts](),
        budget_s=budget_s,
        horizon=steps_to_go,
        discount=DISCOUNT,
        exploration=exploration,
    )
    return action.number, num_simulations, elapsed_s
