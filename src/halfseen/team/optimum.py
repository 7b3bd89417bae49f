"""The exact optimum of a small team, and the exact value of any policy of a team in the same model.

Backwards over what all robots know, which is enough as all know the same [SmallwoodSondik1973]_:

    V(known) = max_a Σ_b P(b | known, a) (R_b + V(known_b)),    0 where the path is over.

Each thing that may be known is valued once.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from halfseen.errors import ArgumentError
from halfseen.team.optimum_model import Branch, Known, SmallTeam
from halfseen.team.policy import TeamPolicy
from halfseen.team.state import Robots, TeamState, Workspace
from halfseen.world.state import NO_ATTEMPT, TableState

_ASKED_AT_ONCE, _ASKED_IN_STEP = 128, 32


@dataclass(frozen=True, eq=False)
class TeamOptimum:
    """The best that a small team can do, as far as it was asked for.

    Parameters
    ----------
    team
        The team and its table.
    """

    team: SmallTeam
    _values: dict[Known, float] = field(default_factory=dict, repr=False)

    @property
    def value(self) -> float:
        """Expected reward of the best policy, before the first look."""
        return sum(branch.probability * self.value_of(branch.known) for branch in self.team.first())

    @property
    def num_states(self) -> int:
        """How many different things to know were valued so far."""
        return len(self._values)

    def value_of(self, known: Known) -> float:
        """Expected reward of the best policy from here on."""
        if known.is_over:
            return 0.0
        if known not in self._values:
            self._values[known] = max(self.q_values(known).values())
        return self._values[known]

    def q_values(self, known: Known) -> dict[int, float]:
        """Expected reward of each possible action, the best policy following."""
        return {
            action: sum(p * (reward + self.value_of(after)) for p, reward, after in self.team.branches(known, action))
            for action in self.team.possible(known)
        }


def team_policy_value(team: SmallTeam, policy: TeamPolicy, key: Array | None = None) -> float:
    """Exact expected reward of a policy in a small team, before the first look.

    It is asked once in everything that it can come to know, with a key of its own: a policy that samples is valued for
    the draws of `key`.

    Parameters
    ----------
    team
        The team and its table.
    policy
        Any policy of a team.
    key
        What it draws from, by default ``jax.random.key(0)``.

    Raises
    ------
    ArgumentError
        The policy chose an action that is not possible.
    """
    key = jax.random.key(0) if key is None else key
    asked = partial(jax.lax.map, lambda each: policy.decide(*each).action, batch_size=_ASKED_IN_STEP)
    decide = jax.jit(lambda *states_and_keys: asked(states_and_keys))
    total, reached = 0.0, _reached(team.first())
    for depth in range(team.config.num_stages):
        if not reached:
            break
        actions = _asked(team, list(reached), decide, jax.random.fold_in(key, depth))
        branches: list[Branch] = []
        for (known, mass), action in zip(reached.items(), actions, strict=True):
            if action not in team.possible(known):
                raise ArgumentError(f"the policy chose action {action}, and {team.possible(known)} are possible")
            branches += [b._replace(probability=mass * b.probability) for b in team.branches(known, action)]
        total += sum(p * reward for p, reward, _ in branches)
        reached = _reached(branches)
    return total


def team_state(team: SmallTeam, known: Known) -> TeamState:
    """What a robot that decides sees, as policies take it."""
    num_objects, room = len(known.cups), team.config.num_stages
    attempts = [(i, *each) for i, cup in enumerate(known.cups) if cup is not None for each in cup.attempts]
    spare = room - len(attempts)
    cups = [(0.0, 0.0, ()) if cup is None else cup for cup in known.cups]
    table = TableState(
        hides=jnp.asarray(team.hides, dtype=jnp.float32),
        is_object=jnp.ones(num_objects, dtype=bool),
        is_on_table=jnp.asarray([cup is not None for cup in known.cups]),
        grip=jnp.zeros(num_objects, dtype=jnp.float32),
        log_odds=jnp.asarray([cup[0] for cup in cups], dtype=jnp.float32),
        seen=jnp.asarray([cup[1] for cup in cups], dtype=jnp.float32),
        lifts=jnp.asarray([sum(held for _, held in cup[2]) for cup in cups], dtype=jnp.int32),
        attempt_object=jnp.asarray([i for i, _, _ in attempts] + [NO_ATTEMPT] * spare, dtype=jnp.int32),
        attempt_occlusion=jnp.asarray([at for _, at, _ in attempts] + [0.0] * spare, dtype=jnp.float32),
        attempt_succeeded=jnp.asarray([held for _, _, held in attempts] + [False] * spare),
        steps_to_go=jnp.asarray(spare, dtype=jnp.int32),
    )
    robots = Robots(
        is_busy=jnp.asarray([task is not None for task in known.tasks]),
        is_parked=jnp.asarray(known.is_parked),
        verb=jnp.asarray([0 if task is None else task.verb for task in known.tasks], dtype=jnp.int32),
        target=jnp.asarray([0 if task is None else task.target for task in known.tasks], dtype=jnp.int32),
        since_s=jnp.asarray([0.0 if task is None else task.since_s for task in known.tasks], dtype=jnp.float32),
        decisions_to_go=jnp.asarray(known.to_go, dtype=jnp.int32),
    )
    workspace = Workspace(jnp.asarray(team.is_in_reach), jnp.asarray(team.is_near))
    return TeamState(table, robots, workspace, jnp.asarray(known.free[0], dtype=jnp.int32))


def _reached(branches: list[Branch]) -> dict[Known, float]:
    """Probability of everything that may be known, and still asks for a decision."""
    masses: dict[Known, float] = {}
    for probability, _, known in branches:
        if not known.is_over:
            masses[known] = masses.get(known, 0.0) + probability
    return masses


def _asked(team: SmallTeam, reached: list[Known], decide: Callable[..., Array], key: Array) -> list[int]:
    """What a policy does in each; asked many at a time, and always as many, so that it is compiled once."""
    actions: list[int] = []
    for begin in range(0, len(reached), _ASKED_AT_ONCE):
        some = reached[begin : begin + _ASKED_AT_ONCE]
        padded = some + some[-1:] * (_ASKED_AT_ONCE - len(some))
        each = [team_state(team, known) for known in padded]
        states = jax.tree.map(lambda *leaves: jnp.asarray(np.stack(leaves)), *each)
        keys = jax.random.split(jax.random.fold_in(key, begin), _ASKED_AT_ONCE)
        actions += np.asarray(decide(states, keys))[: len(some)].tolist()
    return actions
