"""The contenders: each policy's name, label and kind, how it is made, and how long it takes to decide."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import partial
from timeit import timeit
from typing import Any

import numpy as np

from halfseen.figures import INK, ORANGE, OURS, PEER, PLANNER, SOFT
from halfseen.planners import named_policy
from halfseen.planners.pomdp import POMDPPolicy
from halfseen.shapes import Float
from halfseen.tables.assisted import AssistedPolicy, Excess
from halfseen.tables.features import NUM_FEATURES
from halfseen.tables.policy import LinearTablePolicy
from halfseen.workers.threads import one_thread
from halfseen.world import random
from halfseen.world.actions import Verb
from halfseen.world.config import WorldConfig
from halfseen.world.policy import ExploringPolicy, Policy
from halfseen.world.state import TableState

BEST = ("best_heuristic", "best_planner")
"""Roles of the heuristic and the planner that were the strongest on episodes of their own."""
LOG_RANDOM_SHARE = 0.5
"""Probability that a logged action was drawn uniformly at random; otherwise it is the strongest heuristic's."""
MOST_TIMED_S = 0.25  # limit for timing one policy, except for its last decision [s]
FEWEST_TIMED = 3


class StudyKind(StrEnum):
    """The kind of a policy."""

    LEARNED = "learned"
    HEURISTIC = "heuristic"
    PLANNER = "planner"
    PEER = "peer"
    LINEAR = "linear"
    OPTIMUM = "optimum"


COLOURS = dict(zip(StudyKind, (OURS, SOFT, PLANNER, PEER, ORANGE, INK), strict=True))
DASHES = {StudyKind.PLANNER: (5.0, 1.5, 1.0, 1.5)}  # lines of planners; others have even dashes


@dataclass(frozen=True)
class Entrant:
    """A policy that takes part, with its name in tables and its label in text.

    `make` makes it for a world; None if it is learned or known only by its value.
    """

    name: str
    label: str
    kind: StudyKind
    make: Callable[[WorldConfig], Policy] | None = None

    @property
    def look(self) -> dict[str, Any]:
        """Colour and dashes of its kind, and its label."""
        return {
            "color": COLOURS[self.kind],
            "linestyle": (0, DASHES.get(self.kind, (4.0, 2.0))),
            "label": self.label,
        }

    def policy(self, world: WorldConfig) -> Policy:
        """Make the policy for a world."""
        assert self.make is not None, f"{self.name} is not made for a world"
        return self.make(world)


def by_name(*contenders: Entrant) -> dict[str, Entrant]:
    """Contenders by their names."""
    return {each.name: each for each in contenders}


def _heuristic(name: str, label: str) -> Entrant:
    return Entrant(name, label, StudyKind.HEURISTIC, partial(named_policy, name))


LEARNED = Entrant("censored_q", "learned policy", StudyKind.LEARNED)
LINEAR = Entrant("linear_q", "eq. 3, linear, no laws", StudyKind.LINEAR)
ONE_STEP = Entrant("one-step", "Q₁, one step ahead", StudyKind.PLANNER, partial(POMDPPolicy, planning_horizon=1))
FITTED_ONE_STEP = Entrant("fitted-one-step", "Q₁, laws fitted", StudyKind.PEER, ONE_STEP.make)
FITTED_RULE = Entrant("fitted-rule", "best heuristic, laws fitted", StudyKind.HEURISTIC)
"""The strongest heuristic of a study, with laws fitted to the logs that a policy is learned from."""
OPTIMUM = Entrant("optimum", "optimum", StudyKind.OPTIMUM)
HEURISTICS = (
    _heuristic("greedy", "greedy"),
    _heuristic("history", "greedy with history"),
    _heuristic("greedy-penalty", "greedy, counting the penalty"),
    _heuristic("history-penalty", "history, counting the penalty"),
)
STRONGEST_RULE = by_name(*HEURISTICS)["history-penalty"]  # followed by the logging policy


def planner(num_simulations: int) -> Entrant:
    """A planner that looks to the end of a trajectory, with `num_simulations` per decision."""

    def make(world: WorldConfig) -> POMDPPolicy:
        return POMDPPolicy(world, planning_horizon=world.horizon, num_simulations=num_simulations)

    return Entrant(
        f"planner-{num_simulations}", f"POMDP planner, {num_simulations:,} simulations", StudyKind.PLANNER, make
    )


def fitted_planner(num_simulations: int) -> Entrant:
    """The same planner for a world whose laws were fitted to the logs that a policy is learned from."""
    name = f"fitted-planner-{num_simulations}"
    return Entrant(name, "planner, laws fitted", StudyKind.PEER, planner(num_simulations).make)


def horizon_planner(horizon: int, num_simulations: int) -> Entrant:
    """A planner that looks `horizon` steps ahead."""
    label = f"POMDP planner, {horizon} {'step' if horizon == 1 else 'steps'} ahead"
    make = partial(POMDPPolicy, planning_horizon=horizon, num_simulations=num_simulations)
    return Entrant(f"planner-{horizon}-ahead", label, StudyKind.PLANNER, make)


def logging_policy(world: WorldConfig) -> ExploringPolicy:
    """The strongest heuristic, with half of the actions drawn uniformly at random."""
    return ExploringPolicy(STRONGEST_RULE.policy(world), LOG_RANDOM_SHARE)


def timed_policy(who: Entrant, world: WorldConfig, laws: bool) -> Policy:
    """A policy with the decision time of a contender, which does not depend on the log or the laws.

    `laws` are those of the learned policy.
    """
    if who.kind == StudyKind.LEARNED and laws:
        return AssistedPolicy(world, None, Excess.none(world.horizon))
    if who.kind in (StudyKind.LEARNED, StudyKind.LINEAR):
        return LinearTablePolicy(np.zeros((world.horizon, len(Verb), NUM_FEATURES + 1), dtype=np.float32))
    return STRONGEST_RULE.policy(world) if who == FITTED_RULE else who.policy(world)


def decision_times_ms(
    policies: Mapping[str, Policy], states: Sequence[TableState]
) -> dict[str, Float[np.ndarray, " S"]]:
    """Time of a decision of each policy, in one thread [ms].

    Each decides once on each state, the policies in turn, so that anything that slows the machine affects all alike. A
    policy stops after `MOST_TIMED_S`.
    """
    key = random.key_of(0)
    times: dict[str, list[float]] = {name: [] for name in policies}
    with one_thread():
        for state in states:
            for name, policy in policies.items():
                if sum(times[name]) < 1e3 * MOST_TIMED_S or len(times[name]) < FEWEST_TIMED:
                    times[name].append(1e3 * timeit(partial(policy.decide, state, key), number=1))
    return {name: np.array(values) for name, values in times.items()}
