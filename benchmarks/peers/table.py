"""The table for pomdp-py's POMCP: the same world, in Python that is as fast as Python gets.

All that depends on which objects stand on the table is computed beforehand for each subset of them (a `mask`, an int):
occlusions, times to grasp, and for each set of dirty objects the probabilities of all label patterns, so that one
random number draws all labels. A state carries what the policy would know (log-odds, posteriors of the grips), so that
rollouts and priors are as good as our heuristics.

What the laws of grasping and seeing say is asked of `halfseen.planners.belief`. It is taken for granted that the time
to grasp is exponential, that the grip offset u divides its scale by exp(u) and has mean 0 for every object, and that
labels are independent and right as often of dirty objects as of clean ones.
"""

import math
from bisect import bisect
from operator import add
from random import random
from typing import Any

import numpy as np
from peers.belief import ByIdentity, planned, pomdp_py

from halfseen.planners.belief import (
    NUM_NODES,
    expected_attempt_s,
    failure_log_probability,
    known_seeing,
    offset_nodes,
    prior_grip,
)
from halfseen.world import TableState, WorldConfig

OVER = 1000
"""Steps that the last action takes: they end the simulation, whatever its depth."""

FINISH, WASH, LIFT = range(3)

GRID = np.linspace(-5.0, 5.0, 51)
"""Grip offsets that are drawn from, in standard deviations."""


class Action(ByIdentity, pomdp_py.Action):
    def __init__(self, number: int, verb: int, target: int) -> None:
        self.number, self.verb, self.target = number, verb, target


class Observation(ByIdentity, pomdp_py.Observation):
    def __init__(self, bits: int) -> None:
        self.bits = bits


class State(ByIdentity, pomdp_py.State):
    __slots__ = ("dirty", "ease", "grips", "mask", "odds", "steps_to_go")

    def __init__(self, mask: int, steps_to_go: int, dirty: int, ease: tuple, odds: tuple, grips: tuple) -> None:
        self.mask, self.steps_to_go, self.dirty, self.ease = mask, steps_to_go, dirty, ease
        self.odds, self.grips = odds, grips


class Grip(dict):
    """Posterior of one grip offset; as a dict, the probability of a grasp by the rate of its time."""

    def __init__(self, nodes: list[float], weights: list[float]) -> None:
        total = sum(weights)
        self.nodes, self.weights = nodes, [weight / total for weight in weights]
        self.successors: dict[tuple[float, bool], Grip] = {}

    def __missing__(self, rate: float) -> float:
        missed = sum(w * math.exp(-rate * ease) for w, ease in zip(self.weights, self.nodes, strict=True))
        self[rate] = 1.0 - missed
        return self[rate]

    def after(self, rate: float, is_grasped: bool) -> "Grip":
        successor = self.successors.get((rate, is_grasped))
        if successor is None:
            missed = [math.exp(-rate * ease) for ease in self.nodes]
            likelihood = [1.0 - chance for chance in missed] if is_grasped else missed
            weights = [w * chance for w, chance in zip(self.weights, likelihood, strict=True)]
            successor = self.successors[rate, is_grasped] = Grip(self.nodes, weights)
        return successor


class TableModel(pomdp_py.BlackboxModel):
    """One scene under one configuration, of some eight objects at most."""

    def __init__(self, config: WorldConfig, hides: np.ndarray) -> None:
        self.config, self.num_objects = config, len(hides)
        self.transport_s = float(config.transport_s)
        self.limit_s = self._limit_s()
        self.washed = (float(config.reward_wash_clean), float(config.reward_wash_dirty))
        self.failed, self.lift_per_s = float(config.reward_wash_failed), float(config.reward_lift_per_s)
        self.left = [float(config.reward_dirty_left) * mask.bit_count() for mask in range(2**self.num_objects)]
        nodes = np.asarray(offset_nodes(config), dtype=float)
        weights = np.exp(prior_grip(np.zeros(())).log_weights)
        self.offset_std = float(np.sqrt(weights @ nodes**2))
        self.prior = Grip(np.exp(nodes).tolist(), weights.tolist())
        self._name_actions()
        self._measure(hides)
        self._label()

    def sample(self, state: State, action: Action) -> tuple[State, Observation, float, int]:
        mask, dirty, verb, i = state.mask, state.dirty, action.verb, action.target
        if verb == FINISH:
            return state, self.nothing, self.left[mask & dirty], OVER
        rate = self.rates[mask][i]
        grasp_s = -math.log(1.0 - random()) * self.limit_s / (rate * state.ease[i])
        is_grasped = grasp_s <= self.limit_s
        held = self.num_objects
        if verb == WASH:
            reward = self.washed[dirty >> i & 1] if is_grasped else self.failed
            mask &= ~(is_grasped << i)
        else:
            reward = self.lift_per_s * (self.transport_s + (grasp_s if is_grasped else self.limit_s))
            held = i if is_grasped else held
        if state.steps_to_go == 1 or not mask:
            return state, self.nothing, reward + self.left[mask & dirty], OVER
        cumulative, evidence, observations = self.labels[held][mask]
        pattern = bisect(cumulative[mask & dirty], random())
        grips = list(state.grips)
        grips[i] = grips[i].after(rate, is_grasped)
        odds = tuple(map(add, state.odds, evidence[pattern]))
        after = State(mask, state.steps_to_go - 1, dirty, state.ease, odds, tuple(grips))
        return after, observations[is_grasped][pattern], reward, 1

    def states(self, seen: TableState, rng: np.random.Generator, num_draws: int) -> list[State]:
        """What is seen, with each of a number of draws of what is not, from its exact posterior."""
        mask = sum(1 << i for i, there in enumerate(np.asarray(seen.is_on_table)) if there)
        grips = [self.prior] * self.num_objects
        log_density = np.tile(-0.5 * GRID**2, (self.num_objects, 1))
        for i, rate, is_grasped in self._attempts(seen):
            grips[i] = grips[i].after(rate, is_grasped)
            failed = -rate * np.exp(self.offset_std * GRID)
            log_density[i] += np.log(-np.expm1(failed)) if is_grasped else failed
        for later in (m for m in range(mask + 1) if m & mask == m):
            for grip, rate in zip(grips, self.rates[later], strict=True):
                grip[rate]  # known before the clock starts
        known = tuple(np.asarray(seen.log_odds, dtype=float).tolist()), tuple(grips)
        is_dirty = rng.random((num_draws, self.num_objects)) < 1.0 / (1.0 + np.exp(-np.array(known[0])))
        dirty = (is_dirty @ (1 << np.arange(self.num_objects))).tolist()
        ease = np.exp(self.offset_std * drawn_on_grid(log_density, rng, num_draws)).tolist()
        steps_to_go = int(seen.steps_to_go)
        return [State(mask, steps_to_go, d, tuple(e), *known) for d, e in zip(dirty, ease, strict=True)]

    def worths(self, state: State) -> list[tuple[int, float]]:
        """What one try to WASH each object on the table brings, and spares, on average."""
        clean, dirty = self.washed[0] - self.failed, self.washed[1] - self.left[1] - self.washed[0]
        rates, odds, grips = self.rates[state.mask], state.odds, state.grips
        return [
            (i, grips[i][rates[i]] * (dirty / (1.0 + math.exp(-odds[i])) + clean) + self.failed)
            for i in self.members[state.mask]
        ]

    def _name_actions(self) -> None:
        size = self.num_objects
        self.finish = Action(0, FINISH, 0)
        self.wash = [Action(1 + i, WASH, i) for i in range(size)]
        self.lift = [Action(1 + size + i, LIFT, i) for i in range(size)]
        self.members = [[i for i in range(size) if mask >> i & 1] for mask in range(2**size)]
        self.actions = [
            (self.finish, *(self.wash[i] for i in members), *(self.lift[i] for i in members))
            for members in self.members
        ]

    def _measure(self, hides: np.ndarray) -> None:
        present = np.arange(2**self.num_objects)[:, None] >> np.arange(self.num_objects) & 1
        self.occlusion = 1.0 - np.prod(1.0 - present[:, None, :] * hides[None], axis=2)
        self.rates = self._rates(self.occlusion).tolist()
        """By mask and object: mean attempts' worth of the limit at grip offset 0."""

    def _attempts(self, seen: TableState) -> list[tuple[int, float, bool]]:
        """Object, rate and result of each past attempt."""
        tried = (seen.attempt_object, seen.attempt_occlusion, seen.attempt_succeeded)
        target, occluded, is_grasped = (np.asarray(of) for of in tried)
        past = zip(target.tolist(), self._rates(occluded).tolist(), is_grasped.tolist(), strict=True)
        return [attempt for attempt in past if attempt[0] >= 0]

    def _rates(self, occluded: np.ndarray) -> np.ndarray:
        log_failure = failure_log_probability(self.config, np.float32(occluded), np.zeros(()))
        return -np.asarray(log_failure[..., NUM_NODES // 2], dtype=float)

    def _limit_s(self) -> float:
        """Of an attempt: of an exponential time, the probability and the mean of min(T, limit) tell the limit."""
        at_zero = np.where(np.arange(NUM_NODES) == NUM_NODES // 2, 0.0, -np.inf).astype(np.float32)
        rate = float(self._rates(np.zeros(1))[0])
        at_zero = prior_grip(np.zeros(1))._replace(log_weights=np.asarray(at_zero)[None])
        tried_s = float(expected_attempt_s(self.config, np.zeros(1), at_zero)[0]) - self.transport_s
        return tried_s * rate / -math.expm1(-rate)

    def _accuracy(self, occluded: np.ndarray) -> np.ndarray:
        """Probability that the label of a dirty object says so."""
        return np.asarray(known_seeing(self.config).positive(np.float32(occluded), np.zeros(()))[0], dtype=float)

    def _label(self) -> None:
        """By object held (N for none) and mask: how likely the label patterns are, what they tell, and their names."""
        size, in_view = self.num_objects, self._accuracy(np.zeros(1))[0]
        names = [Observation(bits) for bits in range(2 ** (size + 1))]
        self.nothing = names[0]
        self.labels: list[dict[int, tuple]] = [{} for _ in range(size + 1)]
        accuracy = self._accuracy(self.occlusion)
        for mask, members in list(enumerate(self.members))[1:]:
            patterns = np.array([[k >> j & 1 for j in range(len(members))] for k in range(2 ** len(members))])
            bits = patterns @ np.array([1 << i for i in members], dtype=int)
            observations = [[names[b | is_grasped << size] for b in bits] for is_grasped in (False, True)]
            for held in (*members, size):
                right = accuracy[mask & ~(1 << held)][members]
                right[[i == held for i in members]] = in_view
                evidence = np.zeros((len(bits), size))
                evidence[:, members] = np.where(patterns, 1.0, -1.0) * np.log(right / (1.0 - right))
                is_right = patterns[:, None, :] == patterns[None]
                chance = np.prod(np.where(is_right, right, 1.0 - right), axis=2).cumsum(axis=1)
                chance[:, -1] = 1.0
                cumulative = dict(zip(bits.tolist(), chance.tolist(), strict=True))
                self.labels[held][mask] = cumulative, [tuple(row) for row in evidence.tolist()], observations


def drawn_on_grid(log_density: np.ndarray, rng: np.random.Generator, num_draws: int) -> np.ndarray:
    """Draw from a density on `GRID` for each object, evenly within its cells."""
    density = np.exp(log_density - log_density.max(axis=1, keepdims=True))
    below = np.cumsum(density, axis=1) / density.sum(axis=1, keepdims=True)
    rank = [np.searchsorted(of, rng.random(num_draws)) for of in below]
    place = np.minimum(np.stack(rank, axis=1), len(GRID) - 1)
    return GRID[place] + rng.uniform(-0.5, 0.5, place.shape) * (GRID[1] - GRID[0])


class RandomPolicy(pomdp_py.RolloutPolicy):
    """Possible actions only, all alike in rollouts."""

    def __init__(self, model: TableModel) -> None:
        self.model = model

    def get_all_actions(self, state: Any = None, history: Any = None) -> tuple[Action, ...]:
        return self.model.actions[state.mask]

    def rollout(self, state: State, history: Any = None) -> Action:
        actions = self.model.actions[state.mask]
        return actions[int(random() * len(actions))]


class HeuristicPolicy(RandomPolicy):
    """Rollouts wash what promises most now, else finish: our best heuristic, by what the state knows."""

    def rollout(self, state: State, history: Any = None) -> Action:
        best, chosen = 0.0, self.model.finish
        for i, worth in self.model.worths(state):
            if worth > best:
                best, chosen = worth, self.model.wash[i]
        return chosen


class HeuristicPrior(pomdp_py.ActionPrior):
    """What each action is worth by that heuristic, one try of each object, before it was tried; counts as `visits`."""

    def __init__(self, model: TableModel, visits: int) -> None:
        self.model, self.visits = model, visits

    def get_preferred_actions(self, state: State, history: Any) -> list[tuple[Action, int, float]]:
        model, visits = self.model, self.visits
        worths = model.worths(state)
        gains = [(i, worth, max(worth, 0.0)) for i, worth in worths]
        left = model.left[1] * sum(1.0 / (1.0 + math.exp(-state.odds[i])) for i, _ in worths)
        tries = max(1, sum(gain > 0.0 for _, _, gain in gains))
        total = sum(gain for _, _, gain in gains)
        # A look and a failed try cost a step: it counts where steps are scarce.
        later = min(1.0, (state.steps_to_go - 1) / tries)
        look = left + later * total + model.lift_per_s * (model.transport_s + 0.5 * model.limit_s)
        return [
            (model.finish, visits, left),
            *((model.wash[i], visits, left + worth + later * (total - gain)) for i, worth, gain in gains),
            *((model.lift[i], visits, look) for i, _ in worths),
        ]


def decided(
    model: TableModel, states: list[State], *, budget_s: float, rollouts: str, exploration: float, visits: int
) -> tuple[int, int, float]:
    """The action that the peer takes, its simulations, and how long they took [s]; `visits` 0 leaves the prior out.

    Where the time did not suffice for one simulation, its rollout policy decides.
    """
    policy = {"random": RandomPolicy, "heuristic": HeuristicPolicy}[rollouts](model)
    action, num_simulations, elapsed_s = planned(
        states,
        model,
        policy,
        budget_s=budget_s,
        horizon=states[0].steps_to_go,
        discount=1.0,
        exploration=exploration,
        prior=HeuristicPrior(model, visits) if visits else None,
    )
    return (action or policy.rollout(states[0])).number, num_simulations, elapsed_s
