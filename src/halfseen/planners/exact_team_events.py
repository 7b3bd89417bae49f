"""What may happen next to a team that is at work: who is done first, when, and what the camera sees then."""

from collections.abc import Iterator
from itertools import product
from typing import NamedTuple

import numpy as np

from halfseen.planners.exact_bellman import Grid, along
from halfseen.planners.exact_labels import Look
from halfseen.planners.exact_model import NOTHING, Held, Result, Tally, after_attempt_at, after_look, looks_of
from halfseen.planners.exact_team_model import FREE, PARKED, Doing, Doings, End, GridTeam, TeamNode, after_s, left_s
from halfseen.world.actions import WAIT, Verb


class Event(NamedTuple):
    """One way in which the first thing that ends may end."""

    probability: float
    reward: Grid
    """On the grid before the look, the price of the seconds until then included."""
    looks: tuple[Look | None, ...] | None
    """What the look does to each axis; None where nobody decides any more, and looks tell nothing of use."""
    gone: int | None
    """Object that has left the table."""
    after: TeamNode


class _Known(NamedTuple):
    """What is known of a robot once another is done."""

    probability: float
    doing: Doing
    is_up: bool
    """Whether it holds its object in the air."""


def events_of(model: GridTeam, node: TeamNode) -> Iterator[Event]:
    """Go through all that may happen next, while no robot is free."""
    for robot, doing in enumerate(node.doings):
        if not doing.is_at_work:
            continue
        for end, share in zip(doing.ends, model.shares(node.tally, robot, doing), strict=True):
            passed_s = left_s(doing, end)
            others = [_known_of(model, node, other, robot, passed_s) for other in range(len(node.doings))]
            for joint in product(*others):
                probability = share * float(np.prod([known.probability for known in joint]))
                yield _event(model, node, robot, end, passed_s, joint)._replace(probability=probability)


def _known_of(model: GridTeam, node: TeamNode, robot: int, ended: int, passed_s: float) -> list[_Known]:
    """What may be known of a robot when another is done first."""
    doing = node.doings[robot]
    if robot == ended or not doing.is_at_work:
        return [_Known(1.0, doing, False)]
    told: dict[bool, list[tuple[End, float]]] = {}
    for end, share in zip(doing.ends, model.shares(node.tally, robot, doing), strict=True):
        rest_s = left_s(doing, end) - passed_s
        # Of two things that end at once, that of the lower robot ends first.
        if rest_s > 0.0 or (rest_s == 0.0 and robot > ended):
            is_up = node.num_decisions > 0 and end.is_held and rest_s <= model.transport_s[robot]
            told.setdefault(is_up, []).append((end, share))
    return [
        _Known(sum(share for _, share in ends), after_s(doing, passed_s, tuple(end for end, _ in ends)), is_up)
        for is_up, ends in told.items()
    ]


def _event(model: GridTeam, node: TeamNode, robot: int, end: End, passed_s: float, joint: tuple[_Known, ...]) -> Event:
    """What comes of it; its probability is left open."""
    doing = node.doings[robot]
    reward: Grid = np.full((1,) * len(node.tally), float(model.config.reward_per_s) * passed_s)
    tally, gone, held = node.tally, None, NOTHING
    if doing.is_at_object:
        result = Result.FAILED if not end.is_held else Result.WASHED if doing.verb == Verb.WASH else Result.LIFTED
        tally = after_attempt_at(node.tally, doing.target, result, doing.level)
        gone = doing.target if result is Result.WASHED else None
        held = frozenset([doing.target]) if result is Result.LIFTED else NOTHING
        reward = reward + _paid(model, node.tally, doing, end)
    after = TeamNode(tally, _freed(joint, robot))
    if after.is_over or node.num_decisions == 0:
        return Event(0.0, reward, None, gone, after)
    held = held | {known.doing.target for known in joint if known.is_up}
    return Event(0.0, reward, looks_of(model.world, tally, held), gone, _looked_at(model, after, held))


def _looked_at(model: GridTeam, node: TeamNode, held: Held) -> TeamNode:
    return node._replace(tally=after_look(model.world, node.tally, held))


def _freed(joint: tuple[_Known, ...], ended: int) -> Doings:
    """What robots are at once one is done, and with it all that waited."""
    return tuple(
        Doing(doing.to_go, PARKED if r == ended and doing.verb == Verb.FINISH else FREE)
        if r == ended or doing.verb == WAIT
        else doing
        for r, (_, doing, _) in enumerate(joint)
    )


def _paid(model: GridTeam, tally: Tally, doing: Doing, end: End) -> Grid | float:
    """What an attempt pays that ends so."""
    config, told = model.config, tally[doing.target]
    if doing.verb == Verb.LIFT:
        return float(config.reward_lift_per_s) * end.duration_s
    if not end.is_held:
        return float(config.reward_wash_failed)
    assert told is not None, "nobody takes what another is at"
    dirty = along(model.world.dirty(doing.target, told.looks), doing.target, len(tally))
    return dirty * float(config.reward_wash_dirty) + (1.0 - dirty) * float(config.reward_wash_clean)
