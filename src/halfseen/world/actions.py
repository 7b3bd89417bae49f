"""WASH one, LIFT one, FINISH or WAIT: what a robot can do, may do now, and what other robots are at.

One integer stands for each action of a table with N objects, in this file alone. ``0`` is FINISH; then come the verbs
that have a target, each with its N actions: ``1 + i`` is WASH i, ``1 + N + i`` is LIFT i. Where several robots work,
WAIT comes last: it has no object, and lasts until the next event. Anyone who adds a verb adds it to `Verb`; no other
file computes with these numbers.

How long a team will be busy after each action, in attempts, has a lower bound in scheduling theory [Graham1969]_. An
object is work as far as it promises to be dirty, (4·(p − ½)) within 0 and 1. No plan is done before the robot that
alone can do most has done that, nor before all work is done if it were shared evenly:

    makespan ≥ max( max_r (begun_r + work that r alone reaches),  (Σ_r begun_r + all work) / robots that go on ).

What a robot is at counts 1 as it begins, and less the longer it has been at it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

from halfseen.arrays import Array, expit, library_of
from halfseen.shapes import Bool, Float, Int

FADES_PER_S = 0.03
"""How fast what is begun counts less towards a makespan [1/s]."""
WAITS = 0.5
"""What WAIT begins of one: half of what another robot is at."""
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


class Others(NamedTuple):
    """The robots that do not decide."""

    goes_on: Bool[Array, "*B K"]
    """Which of them will do something yet; who goes home no longer does."""
    is_at_object: Bool[Array, "*B K"]
    reached: Bool[Array, "*B N"]
    """What on the table those reach that go on."""
    taken: Bool[Array, "*B N"]
    num_at_work: Float[Array, "*B"]
    since_s: Float[Array, "*B"]
    """For how long those that are at work have been at it, in all [s]."""


def others_of(state: Any) -> Others:
    """Tell what the robots that do not decide are at, in a `TableState` with several."""
    robots = state.robots
    xp, is_other = library_of(state.is_on_table), ~is_decider(state)
    goes_on = is_other & ~robots.is_done & ~(robots.is_busy & (robots.verb == Verb.FINISH))
    at_work = is_other & robots.is_busy & (robots.verb != WAIT)
    is_at_object = at_work & (robots.verb > 0)
    is_target = robots.target[..., None] == xp.arange(state.num_objects)
    return Others(
        goes_on=goes_on,
        is_at_object=is_at_object,
        reached=state.is_on_table & xp.any(goes_on[..., None] & state.workspace.is_in_reach, axis=-2),
        taken=xp.any(is_at_object[..., None] & is_target, axis=-2),
        num_at_work=xp.sum(at_work, axis=-1).astype(np.float32),
        since_s=xp.sum(xp.where(at_work, robots.since_s, np.float32(0.0)), axis=-1),
    )


def reached_by_decider(state: Any) -> Bool[Array, "*B N"]:
    """What on the table is in reach of the robot that decides."""
    return state.is_on_table & of_robot(state.workspace.is_in_reach, state.decider)


def makespans(state: Any, others: Others) -> Float[Array, "*B A"]:
    """Bound of what follows each action, WAIT last; 0 where nothing is left to do."""
    xp, is_me, zero, num = library_of(state.log_odds), is_decider(state), np.float32(0.0), state.num_objects
    work = xp.clip(4.0 * (expit(state.log_odds) - 0.5), zero, np.float32(1.0))
    work = xp.where(state.is_on_table & ~others.taken, work, zero)
    begun = xp.where(others.is_at_object, xp.exp(-FADES_PER_S * state.robots.since_s), zero)
    # Rows: FINISH, WASH of each object, any LIFT, WAIT.
    is_kept = xp.asarray(np.concatenate([np.ones((1, num)), 1 - np.eye(num), np.ones((2, num))]) > 0)
    begins = xp.asarray([0.0, *[1.0] * (num + 1), WAITS], dtype=np.float32)[:, None]
    goes_on = others.goes_on[..., None, :] | (is_me[..., None, :] & (begins > 0.0))
    each = begun[..., None, :] + begins * is_me[..., None, :].astype(np.float32)
    left = xp.where(is_kept, work[..., None, :], zero)
    bound = _bound(goes_on[..., None] & state.workspace.is_in_reach[..., None, :, :], goes_on, each, left)
    of_lift = xp.broadcast_to(bound[..., -2:-1], work.shape)
    return xp.concatenate([bound[..., : num + 1], of_lift, bound[..., -1:]], axis=-1)


def _bound(
    reach: Bool[Array, "*#L K N"],
    goes_on: Bool[Array, "*#L K"],
    begun: Float[Array, "*#L K"],
    work: Float[Array, "*L N"],
) -> Float[Array, "*L"]:
    xp, zero = library_of(work), np.float32(0.0)
    num_reaching = xp.sum(reach, axis=-2)
    alone = xp.sum(xp.where(reach & (num_reaching == 1)[..., None, :], work[..., None, :], zero), axis=-1)
    longest = xp.max(xp.where(goes_on, begun + alone, zero), axis=-1)
    total = xp.sum(xp.where(num_reaching > 0, work, zero), axis=-1) + xp.sum(xp.where(goes_on, begun, zero), axis=-1)
    num_going_on = xp.maximum(xp.sum(goes_on, axis=-1), 1).astype(np.float32)
    return xp.maximum(longest, total / num_going_on)
