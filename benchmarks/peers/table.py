"""The table for pomdp-py's POMCP: the same world, in Python that is as fast as Python gets.

All that depends on which objects stand on the table is computed beforehand for each subset of them (a `mask`, an int):
occlusions, times to grasp, and for each set of dirty objects the chances of all label patterns, so that one random
number draws all labels. A state carries what the policy would know (log-odds, posteriors of the grips), so that
roll-outs and priors are as good as our heuristics.
"""

import math
from bisect import bisect
from operator import add
from random import random
from typing import Any

import numpy as np
from peers.belief import ByIdentity, planned, pomdp_py

from halfseen.planners.belief import offset_nodes, prior_grip
from halfseen.world import TableState, WorldConfig
from halfseen.world.state import HiddenState

OVER = 1000
"""Steps that the last action takes: they end the simulation, whatever its depth."""

FINISH, WASH, LIFT = range(3)


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
    """Posterior of one grip offset; as a dict, the chance of a grasp by the share of time lost to occlusion."""

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
        self.limit_s, self.transport_s = float(config.grasping.limit_s), float(config.transport_s)
        self.washed = (float(config.reward_wash_clean), float(config.reward_wash_dirty))
        self.failed, self.lift_per_s = float(config.reward_wash_failed), float(config.reward_lift_per_s)
        self.left = [float(config.reward_dirty_left) * mask.bit_count() for mask in range(2**self.num_objects)]
        self.prior = Grip(np.exp(offset_nodes(config)).tolist(), np.exp(prior_grip()).tolist())
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

    def states(self, seen: TableState, hidden: HiddenState) -> list[State]:
        """What is seen, with each of a batch of draws of what is not."""
        mask = sum(1 << i for i, there in enumerate(np.asarray(seen.is_on_table)) if there)
        grips = [self.prior] * self.num_objects
        attempts = (seen.attempt_object, seen.attempt_occlusion, seen.attempt_succeeded)
        for i, occluded, is_grasped in zip(*(np.asarray(of).tolist() for of in attempts), strict=True):
            if i >= 0:
                grips[i] = grips[i].after(self._rate(occluded), is_grasped)
        for later in (m for m in range(mask + 1) if m & mask == m):
            for grip, rate in zip(grips, self.rates[later], strict=True):
                grip[rate]  # known before the clock starts
        known = tuple(np.asarray(seen.log_odds, dtype=float).tolist()), tuple(grips)
        dirty = (np.asarray(hidden.is_dirty) @ (1 << np.arange(self.num_objects))).tolist()
        ease = np.exp(np.asarray(hidden.grasp_trait, dtype=float)).tolist()
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
        self.rates = [[self._rate(occluded) for occluded in row] for row in self.occlusion.tolist()]
        """By mask and object: mean attempts' worth of the limit at grip offset 0."""

    def _rate(self, occluded: float) -> float:
        return self.limit_s / float(self.config.grasping.scale_s(occluded, 0.0))

    def _label(self) -> None:
        """By object held (N for none) and mask: chances of the label patterns, what they tell, and their names."""
        size, config = self.num_objects, self.config
        names = [Observation(bits) for bits in range(2 ** (size + 1))]
        self.nothing = names[0]
        self.labels: list[dict[int, tuple]] = [{} for _ in range(size + 1)]
        for mask, members in list(enumerate(self.members))[1:]:
            patterns = np.array([[k >> j & 1 for j in range(len(members))] for k in range(2 ** len(members))])
            bits = patterns @ np.array([1 << i for i in members], dtype=int)
            observations = [[names[b | is_grasped << size] for b in bits] for is_grasped in (False, True)]
            for held in (*members, size):
                occluded = self.occlusion[mask & ~(1 << held)][members]
                occluded[[i == held for i in members]] = 0.0
                right = config.seeing.accuracy(occluded)
                evidence = np.zeros((len(bits), size))
                evidence[:, members] = np.where(patterns, 1.0, -1.0) * np.log(right / (1.0 - right))
                is_right = patterns[:, None, :] == patterns[None]
                chance = np.prod(np.where(is_right, right, 1.0 - right), axis=2).cumsum(axis=1)
                chance[:, -1] = 1.0
                cumulative = dict(zip(bits.tolist(), chance.tolist(), strict=True))
                self.labels[held][mask] = cumulative, [tuple(row) for row in evidence.tolist()], observations


class RandomPolicy(pomdp_py.RolloutPolicy):
    """Possible actions only, all alike in roll-outs."""

    def __init__(self, model: TableModel) -> None:
        self.model = model

    def get_all_actions(self, state: Any = None, history: Any = None) -> tuple[Action, ...]:
        return self.model.actions[state.mask]

    def rollout(self, state: State, history: Any = None) -> Action:
        actions = self.model.actions[state.mask]
        return actions[int(random() * len(actions))]


class HeuristicPolicy(RandomPolicy):
    """Roll-outs wash what promises most now, else finish: our best heuristic, by what the state knows."""

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
    """The action that the peer takes, its simulations, and how long they took [s]; `visits` 0 leaves the prior out."""
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
    return action.number, num_simulations, elapsed_s
