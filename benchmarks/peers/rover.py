"""RockSample for pomdp-py's POMCP: the steps of `worlds.rocks`, in Python that is as fast as Python gets.

A state counts for each rock how many checks said good less how many said bad. Rollouts prefer what Silver and Veness
(2010) tell their planner: sample a rock that checks speak for, never one that they do not; go where a rock that they do
not speak against is; check no rock twice more one way than the other, or five times; leave if all are bad.
"""

import random
import time
from collections.abc import Sequence
from functools import cache
from typing import Any

import numpy as np
from peers.belief import ByIdentity, planned, pomdp_py
from worlds.rocks import (
    CHECK,
    DISCOUNT,
    EAST,
    MOVES,
    NORTH,
    NUM,
    PAY,
    ROCKS,
    SAMPLE,
    SIZE,
    SOUTH,
    WEST,
    Seen,
    accuracy,
    begin,
    known_after,
    step,
)

DEPTH, EXPLORATION = 90, 5.0
"""Steps by which the discount is below .01; the constant of UCB1, chosen with `Preferred` on other worlds, of a few."""
ENOUGH, TOO_OFTEN, DRAWS = 2, 5, 2000
PLACES = [(x, y) for x in range(SIZE) for y in range(SIZE)]
ROCK_AT = {tuple(rock): k for k, rock in enumerate(ROCKS.tolist())}
GOALS, MOTIONS = ROCKS.tolist(), MOVES.tolist()
RIGHT = dict(zip(PLACES, accuracy(np.array(PLACES)).tolist(), strict=True))


class Action(ByIdentity, pomdp_py.Action):
    def __init__(self, number: int) -> None:
        self.number = number


class Observation(ByIdentity, pomdp_py.Observation):
    pass


ACTIONS = [Action(number) for number in range(CHECK + NUM)]
NOTHING, GOOD, BAD = (Observation() for _ in range(3))


class State(ByIdentity, pomdp_py.State):
    __slots__ = ("good", "place", "said", "times")

    def __init__(self, place: tuple[int, int], good: int, said: tuple[int, ...], times: tuple[int, ...]) -> None:
        self.place, self.good, self.said, self.times = place, good, said, times


def changed(values: tuple[int, ...], rock: int, value: int) -> tuple[int, ...]:
    return (*values[:rock], value, *values[rock + 1 :])


class RoverModel(pomdp_py.BlackboxModel):
    def sample(self, state: State, action: Action) -> tuple[State, Observation, float, int]:
        number, place = action.number, state.place
        if number >= CHECK:
            rock = number - CHECK
            is_good = (state.good >> rock & 1) == (random.random() < RIGHT[place][rock])
            said = changed(state.said, rock, state.said[rock] + (1 if is_good else -1))
            after = State(place, state.good, said, changed(state.times, rock, state.times[rock] + 1))
            return after, GOOD if is_good else BAD, 0.0, 1
        if number == SAMPLE:
            rock = ROCK_AT[place]
            pay = PAY if state.good >> rock & 1 else -PAY
            gone = changed(state.said, rock, -TOO_OFTEN), changed(state.times, rock, TOO_OFTEN)
            return State(place, state.good & ~(1 << rock), *gone), NOTHING, pay, 1
        goal = place[0] + MOTIONS[number][0], place[1] + MOTIONS[number][1]
        if goal[0] == SIZE:
            return state, NOTHING, PAY, DEPTH
        return State(goal, state.good, state.said, state.times), NOTHING, 0.0, 1


@cache
def possible(place: tuple[int, int], said: tuple[int, ...], times: tuple[int, ...]) -> list[Action]:
    """Moves on the map, to sample a rock that was not sampled, to check such rocks."""
    x, y = place
    there = [ACTIONS[EAST]]
    there += [ACTIONS[NORTH]] * (y > 0) + [ACTIONS[SOUTH]] * (y < SIZE - 1) + [ACTIONS[WEST]] * (x > 0)
    here = ROCK_AT.get(place)
    if here is not None and said[here] > -TOO_OFTEN:
        there.append(ACTIONS[SAMPLE])
    return there + [ACTIONS[CHECK + k] for k in range(NUM) if times[k] < TOO_OFTEN]


@cache
def preferred(place: tuple[int, int], said: tuple[int, ...], times: tuple[int, ...]) -> list[Action]:
    x, y = place
    here = ROCK_AT.get(place)
    if here is not None and said[here] > 0:
        return [ACTIONS[SAMPLE]]
    wanted = [GOALS[k] for k in range(NUM) if said[k] >= 0]
    if not wanted:
        return [ACTIONS[EAST]]
    there = [ACTIONS[NORTH]] * any(r[1] < y for r in wanted) + [ACTIONS[SOUTH]] * any(r[1] > y for r in wanted)
    there += [ACTIONS[EAST]] * any(r[0] > x for r in wanted) + [ACTIONS[WEST]] * any(r[0] < x for r in wanted)
    there += [ACTIONS[CHECK + k] for k in range(NUM) if abs(said[k]) < ENOUGH and times[k] < TOO_OFTEN]
    return there or [ACTIONS[EAST]]


class RoverPolicy(pomdp_py.RolloutPolicy):
    def get_all_actions(self, state: Any = None, history: Any = None) -> list[Action]:
        return possible(state.place, state.said, state.times)

    def rollout(self, state: State, history: Any = None) -> Action:
        return random.choice(preferred(state.place, state.said, state.times))


class Preferred(pomdp_py.ActionPrior):
    """What is preferred counts as tried ten times, and worth two good rocks; nothing is known of the rest."""

    def get_preferred_actions(self, state: State, history: Any) -> list[tuple[Action, int, float]]:
        known = state.place, state.said, state.times
        liked = preferred(*known)
        return [(action, 10, 2.0 * PAY) if action in liked else (action, 0, -1000.0) for action in possible(*known)]


def states(seen: Seen, said: tuple[int, ...], times: tuple[int, ...], rng: np.random.Generator) -> list[State]:
    """Draws from the exact posterior of one rover."""
    is_good = rng.random((DRAWS, NUM)) < seen.belief[0]
    place = tuple(seen.position[0].tolist())
    return [State(place, good, said, times) for good in (is_good @ (1 << np.arange(NUM))).tolist()]


def decided(drawn: Sequence[State], num_simulations: int) -> tuple[int, int, float]:
    """The step that the peer takes, its simulations, and how long they took [s]."""
    action, number, elapsed_s = planned(
        drawn,
        RoverModel(),
        RoverPolicy(),
        budget_s=-1.0,
        num_simulations=num_simulations,
        horizon=DEPTH,
        discount=DISCOUNT,
        exploration=EXPLORATION,
        prior=Preferred(),
    )
    return action.number, number, elapsed_s


def episode(num_simulations: int, seed: int) -> float:
    """What the peer earns in one world."""
    rng = np.random.default_rng([seed, 17])
    random.seed(seed)
    rovers, seen = begin(rng.random((1, NUM)) < 0.5)
    said, times, total = (0,) * NUM, (0,) * NUM, 0.0
    while not rovers.is_out[0]:
        number, _, _ = decided(states(seen, said, times, rng), num_simulations)
        action = np.array([number])
        moved, reward, read = step(rovers, action, rng.random(1))
        total += DISCOUNT ** int(seen.steps[0]) * float(reward[0])
        if number >= CHECK:
            rock = number - CHECK
            said, times = changed(said, rock, said[rock] + 2 * int(read[0]) - 1), changed(times, rock, times[rock] + 1)
        if number == SAMPLE:
            rock = ROCK_AT[tuple(seen.position[0].tolist())]
            said, times = changed(said, rock, -TOO_OFTEN), changed(times, rock, TOO_OFTEN)
        seen, rovers = known_after(seen, moved, action, read), moved
    return total


def pace() -> int:
    """Simulations that a second of this core makes, where an episode begins."""
    rng, number = np.random.default_rng(0), 2000
    drawn = states(begin(np.ones((1, NUM), dtype=bool))[1], (0,) * NUM, (0,) * NUM, rng)
    began = time.process_time()
    decided(drawn, number)
    return round(number / (time.process_time() - began))
