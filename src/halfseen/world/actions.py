"""The actions WASH, LIFT, FINISH and WAIT: their encoding, which are possible, and what other robots are doing.

Each action of a table with N objects is encoded as an integer. ``0`` is FINISH. The verbs with a target follow, each
with N actions: ``1 + i`` is WASH i, ``1 + N + i`` is LIFT i. For several robots, WAIT comes last: it has no object and
lasts until the next event. New verbs are added to `Verb`; no other file depends on this encoding.

Scheduling theory gives a lower bound on a team's makespan after each action, in attempts [Graham1969]_. An object that
is dirty with probability p counts as work 4·(p − ½), clipped to [0, 1]. No schedule ends before the robot with the
most work that only it can reach, nor before an even split of all work:

    makespan ≥ max( max_r (begun_r + work that r alone reaches),  (Σ_r begun_r + all work) / robots that go on ).

An action in progress counts 1 when it begins, and less as it goes on.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np

from halfseen.arrays import Array, expit, library_of
from halfseen.shapes import Bool, Float, Int

FADES_PER_S = 0.03
"""Decay rate of an action in progress in the makespan [1/s]."""
WAITS = 0.5
"""Work that WAIT adds to the makespan: half an attempt."""
FINISH = 0


class Verb(IntEnum):
    """Verbs of a robot."""

    FINISH = 0
    WASH = 1
    LIFT = 2


TARGETED = tuple(verb for verb in Verb if verb is not Verb.FINISH)
"""Verbs with a target object."""
WAIT = 1 + len(TARGETED)
"""Verb of a robot that does nothing until the next event; its action number is `wait_of`."""
VERB_NAMES = (*(verb.name for verb in Verb), "WAIT")
"""Indexed by verb."""


def wait_of(num_objects: int) -> int:
    """Action number of WAIT on a table with N objects."""
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
        """Action space with `num_actions` actions."""
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
        """Encode an action, or an array of actions, as integers; `target` is ignored for FINISH."""
        return (verb > 0) * (1 + (verb - 1) * self.num_objects + target)

    def verb(self, action: Any) -> Any:
        """Verb of each action, as in `Verb`."""
        return 1 + (action - 1) // self.num_objects

    def target(self, action: Any) -> Any:
        """Object of each action; 0 for FINISH, which has none."""
        return (action > 0) * ((action - 1) % self.num_objects)

    def of(self, verb: Verb) -> slice:
        """Slice of a verb's actions among all actions."""
        if verb is Verb.FINISH:
            return slice(0, 1)
        first = self.encode(int(verb), 0)
        return slice(first, first + self.num_objects)

    @property
    def slices(self) -> list[slice]:
        """Slice of each verb's actions among all actions, by verb."""
        return [self.of(verb) for verb in Verb]

    def join(self, finish: Float[Array, "*S"], of_verb: Mapping[Verb, Float[Array, "*S N"]]) -> Float[Array, "*S A"]:
        """Concatenate the value of FINISH and the per-object values of the other verbs in action order.

        A missing verb gets −∞, so that no policy takes it.
        """
        xp = library_of(finish, *of_verb.values())
        if len(of_verb) < len(TARGETED):
            unknown = xp.full((*finish.shape, self.num_objects), -xp.inf, dtype=finish.dtype)
            of_verb = dict.fromkeys(TARGETED, unknown) | dict(of_verb)
        return xp.concatenate([finish[..., None], *(of_verb[verb] for verb in TARGETED)], axis=-1)


def possible_actions(state: Any) -> Bool[Array, "*B A"]:
    """Return which actions are possible.

    FINISH always is, and every other verb on each object on the table. In a team, the deciding robot may act on objects
    that are in its reach, not taken by another robot, and not near another robot's target. It may WAIT while another
    robot carries out an action that ends by itself.

    Parameters
    ----------
    state
        A `TableState`, or another record with is_on_table, axes (B, N), such as a belief.
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
    """One-hot mask of the robot that decides."""
    decider: Any = state.decider
    return library_of(decider).arange(state.num_robots) == decider[..., None]


def worthwhile_actions(state: Any) -> Bool[Array, "*B A"]:
    """Return which of the possible actions a learned policy chooses from: a robot only waits for an object.

    WAIT is kept only if an object in reach is more likely dirty than clean and is blocked by another robot. Otherwise
    waiting gains nothing, but would be overestimated: each further decision adds a maximum over the errors of Q.
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
    """Which of them will still act; a robot on its way home will not."""
    is_at_object: Bool[Array, "*B K"]
    reached: Bool[Array, "*B N"]
    """Objects on the table in reach of a robot that goes on."""
    taken: Bool[Array, "*B N"]
    num_at_work: Float[Array, "*B"]
    since_s: Float[Array, "*B"]
    """Total elapsed time of the actions in progress [s]."""


def others_of(state: Any) -> Others:
    """Summarise what the robots that do not decide are doing, in the `TableState` of a team."""
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
    """Objects on the table in reach of the robot that decides."""
    return state.is_on_table & of_robot(state.workspace.is_in_reach, state.decider)


def makespans(state: Any, others: Others) -> Float[Array, "*B A"]:
    """Lower bound on the makespan after each action, WAIT last; 0 if no work is left."""
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
