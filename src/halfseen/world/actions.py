"""WASH one, LIFT one, FINISH or WAIT: one integer for each action of a table with N objects, in this file alone.

``0`` is FINISH; then come the verbs that have a target, each with its N actions: ``1 + i`` is WASH i, ``1 + N + i`` is
LIFT i. Where several robots work, WAIT comes last: it has no object, and lasts until the next event. Anyone who adds a
verb adds it to `Verb`; no other file computes with these numbers.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np

from halfseen.arrays import Array, library_of
from halfseen.shapes import Bool, Float, Int

FINISH = 0


class Verb(IntEnum):
    """What the robot can do."""

    FINISH = 0
    WASH = 1
    LIFT = 2


TARGETED = tuple(verb for verb in Verb if verb is not Verb.FINISH)
"""Verbs that are done to an object."""

WAIT = 1 + len(TARGETED)
"""Verb of a robot that does nothing until the next event; the number of the action is `wait_of`."""

VERB_NAMES = (*(verb.name for verb in Verb), "WAIT")
"""By number of the verb."""


def wait_of(num_objects: int) -> int:
    """Number of the action WAIT on a table with N objects."""
    return ActionSpace(num_objects).num_actions


@dataclass(frozen=True)
class ActionSpace:
    """The actions of a table with N objects.

    Parameters
    ----------
    num_objects
        N, at least 1.

    Examples
    --------
    >>> space = ActionSpace(2)
    >>> space.names
    ('FINISH', 'WASH 0', 'WASH 1', 'LIFT 0', 'LIFT 1')
    >>> space.encode(Verb.LIFT, 1), space.verb(4), space.target(4)
    (4, 2, 1)
    """

    num_objects: int

    @classmethod
    def of_size(cls, num_actions: int) -> "ActionSpace":
        """Space with so many actions."""
        return cls((num_actions - 1) // len(TARGETED))

    @property
    def num_actions(self) -> int:
        """Number A of actions."""
        return 1 + len(TARGETED) * self.num_objects

    @property
    def names(self) -> tuple[str, ...]:
        """Name of each action, such as ``"WASH 0"``."""
        return (Verb.FINISH.name, *(f"{verb.name} {k}" for verb in TARGETED for k in range(self.num_objects)))

    @property
    def verbs(self) -> Int[np.ndarray, " A"]:
        """Verb of each action, as in `Verb`."""
        return np.asarray(self.verb(np.arange(self.num_actions)))

    def encode(self, verb: Any, target: Any) -> Any:
        """Integer of an action, or of an array of them; `target` is ignored for FINISH."""
        return (verb > 0) * (1 + (verb - 1) * self.num_objects + target)

    def verb(self, action: Any) -> Any:
        """Verb of each action, as in `Verb`."""
        return 1 + (action - 1) // self.num_objects

    def target(self, action: Any) -> Any:
        """Object of each action; 0 for FINISH, which has none."""
        return (action > 0) * ((action - 1) % self.num_objects)

    def of(self, verb: Verb) -> slice:
        """Where the actions of a verb stand among all."""
        if verb is Verb.FINISH:
            return slice(0, 1)
        first = self.encode(int(verb), 0)
        return slice(first, first + self.num_objects)

    @property
    def slices(self) -> list[slice]:
        """Where the actions of each verb stand among all, by verb."""
        return [self.of(verb) for verb in Verb]

    def join(self, finish: Float[Array, "*S"], of_verb: Mapping[Verb, Float[Array, "*S N"]]) -> Float[Array, "*S A"]:
        """Lay out values of FINISH, and by object of other verbs, in the order of the actions.

        A verb that is left out is worth −∞: a policy that does not know it never takes it.
        """
        xp = library_of(finish, *of_verb.values())
        if len(of_verb) < len(TARGETED):
            unknown = xp.full((*finish.shape, self.num_objects), -xp.inf, dtype=finish.dtype)
            of_verb = dict.fromkeys(TARGETED, unknown) | dict(of_verb)
        return xp.concatenate([finish[..., None], *(of_verb[verb] for verb in TARGETED)], axis=-1)


def possible_actions(state: Any) -> Bool[Array, "*B A"]:
    """Which actions there are.

    FINISH always, and every other verb on what stands on the table. Of several robots, the one that decides may do what
    is in its reach, in nobody's hand and not near what another robot is at; and WAIT where another is busy with
    something that ends by itself.

    Parameters
    ----------
    state
        A `TableState`, or what else tells by is_on_table, axes (B, N), which objects stand on tables, as a belief.
    """
    robots, is_free = getattr(state, "robots", None), state.is_on_table
    xp = library_of(is_free)
    always = xp.ones_like(is_free[..., :1])
    if robots is None:
        return xp.concatenate([always, *[is_free] * len(TARGETED)], axis=-1)
    is_at_work = robots.is_busy & ~is_decider(state) & (robots.verb != WAIT)
    near = xp.take_along_axis(state.workspace.is_near, robots.target[..., None], axis=-2)
    is_taken = xp.any((is_at_work & (robots.verb > 0))[..., None] & near, axis=-2)
    is_free = is_free & of_robot(state.workspace.is_in_reach, state.decider) & ~is_taken
    return xp.concatenate([always, *[is_free] * len(TARGETED), xp.any(is_at_work, axis=-1)[..., None]], axis=-1)


def of_robot(values: Array, robot: Int[Array, "*B"]) -> Array:
    """``values[..., robot, :]`` for each member of a batch."""
    return library_of(values).take_along_axis(values, robot[..., None, None], axis=-2)[..., 0, :]


def is_decider(state: Any) -> Bool[Array, "*B K"]:
    """Which of several robots decides."""
    decider: Any = state.decider
    return library_of(decider).arange(state.num_robots) == decider[..., None]


def worthwhile_actions(state: Any) -> Bool[Array, "*B A"]:
    """Which of the possible actions a policy that is learned chooses from: a robot waits for something, or not at all.

    WAIT only where something that the robot reaches, and that is rather dirty than clean, is in another robot's hands
    or way. Elsewhere the robot could as well do or leave now what it may do then; and as every decision more is one
    more maximum over errors of Q, waiting for nothing looked better than it is.
    """
    is_possible = possible_actions(state)
    if state.robots is None:
        return is_possible
    xp = library_of(is_possible)
    is_free = is_possible[..., ActionSpace(state.num_objects).of(Verb.WASH)]
    is_wanted = state.is_on_table & of_robot(state.workspace.is_in_reach, state.decider) & (state.log_odds > 0.0)
    waits = is_possible[..., -1] & xp.any(is_wanted & ~is_free, axis=-1)
    return xp.concatenate([is_possible[..., :-1], waits[..., None]], axis=-1)
