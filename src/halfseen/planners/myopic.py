"""A look one step ahead for the robot that decides, with WAIT among its actions and the seconds paid.

It is the look of `one_step`. What lies beyond the step is tried by the fastest robot that reaches it and has a decision
left, and costs the price of its seconds, too. Where robots have laws of grasping of their own, it is tried by the one
of them to which that is worth the most. What another robot is washing counts for nobody, as it is tried already.
FINISH leaves to the others what they reach. WAIT gains the labels of the next look for the seconds in which this robot
is idle. While n robots go on, a second of one is taken to add 1/n of it to the table's clock.
"""

from typing import NamedTuple

import numpy as np

from halfseen.arrays import Array, library_of, record
from halfseen.planners import one_step
from halfseen.planners.one_step import NOW, Outlook
from halfseen.shapes import Bool, Float, Int
from halfseen.world.actions import Others, Verb, is_decider, others_of, possible_actions
from halfseen.world.config import WorldConfig
from halfseen.world.policy import ByValue
from halfseen.world.state import Robots, TableState

LEAST_LEFT = 0.3
"""What is at least expected to be left of an attempt that goes on, as a share of its expected time."""
OUT_OF_REACH = np.float32(1e30)
"""Price of a try that nobody can make."""
_ZERO, _ONE = np.float32(0.0), np.float32(1.0)


@record
class MyopicPolicy(ByValue):
    """The best action by a look one step ahead.

    Parameters
    ----------
    config
        The world that it believes in, with the price of time.
    """

    config: WorldConfig

    @property
    def num_robots(self) -> int | None:
        """K; any where one works alone."""
        return self.config.num_robots if self.config.num_robots > 1 else None

    def q_values(self, state: TableState) -> Float[Array, "*B A"]:
        """Worth of each action, WAIT last, above leaving all as it is; −∞ where it is impossible."""
        if state.robots is None:
            q = one_step.one_step_q(self.config, state)
            return q - q[..., :1]
        return _q_of_team(self.config, state, state.robots, others_of(state))


class _AtWork(NamedTuple):
    """Robots that go on, at a table."""

    effort: tuple[Float[Array, " N *B"], ...]
    """Price of the seconds of a try by the fastest of them that reaches it and has a decision left, under each law."""
    num_decisions: Int[Array, "*B"]
    """That they have after this one."""
    reward_per_s: Float[Array, "*B"]
    """Price of a second of one of them [1/s]."""


def _q_of_team(config: WorldConfig, state: TableState, robots: Robots, others: Others) -> Float[Array, "*B A"]:
    assert state.decider is not None
    xp = library_of(state.is_on_table)
    speed = xp.asarray(config.speed, dtype=np.float32)
    laws = tuple(config.as_robot(robot) for robot in range(config.num_robots if config.has_own_laws else 1))
    robot = state.decider if config.has_own_laws else xp.zeros_like(state.decider)
    table = one_step.table_of(config, state)
    setting = one_step.setting_of(laws, table, robot)
    # What another washes hides and is seen, but nobody tries it.
    look = one_step.outlook_of(config, table, setting._replace(label=setting.label * ~_washed(state, robots, others)))
    seconds = config.transport_s + xp.stack([each[one_step.ATTEMPT_S] for each in look.expected])
    everyone = others.goes_on | is_decider(state)
    with_me, without_me = (_at_work(config, state, robots, seconds, who) for who in (everyone, others.goes_on))
    own_s = xp.take_along_axis(seconds, robot[None, None], axis=0)[0] / speed[state.decider]
    tries = one_step.tries_after(one_step.tries_then(config, look, with_me.effort))
    gains = one_step.limited(tries, with_me.num_decisions)
    values = one_step.attempts_worth(config, look, gains[None], own_s, with_me.reward_per_s)
    # Anyone who is last to leave ends the trajectory, and nothing is looked at any more.
    finish = _value_now(config, look, without_me) * xp.any(others.goes_on, axis=-1)
    wait = _value_now(config, look, with_me) + with_me.reward_per_s * _wait_s(config, robots, others, seconds)
    q = xp.concatenate([one_step.laid_out(finish, values), wait[..., None]], axis=-1)
    return xp.where(possible_actions(state), q, np.float32(-np.inf))


def _washed(state: TableState, robots: Robots, others: Others) -> Bool[Array, " N *B"]:
    """What another robot is washing."""
    xp = library_of(robots.target)
    is_target = robots.target[..., None] == xp.arange(state.num_objects)
    is_washing = (others.is_at_object & (robots.verb == Verb.WASH))[..., None]
    return xp.moveaxis(xp.any(is_washing & is_target, axis=-2), -1, 0)


def _at_work(
    config: WorldConfig,
    state: TableState,
    robots: Robots,
    seconds: Float[Array, "L N *B"],
    goes_on: Bool[Array, "*B K"],
) -> _AtWork:
    assert state.workspace is not None
    xp, to_go = library_of(goes_on), robots.decisions_to_go - is_decider(state)
    reach = (goes_on & (to_go > 0))[..., None] & state.workspace.is_in_reach
    speed = xp.where(reach, xp.asarray(config.speed, dtype=np.float32)[:, None], _ZERO)
    speed = xp.moveaxis(speed, (-2, -1), (0, 1))
    if not config.has_own_laws:
        speed = xp.max(speed, axis=0, keepdims=True)
    reward_per_s = config.reward_per_s / xp.maximum(xp.sum(goes_on, axis=-1), 1).astype(np.float32)
    price = -reward_per_s * seconds / xp.where(speed > _ZERO, speed, _ONE)
    effort = tuple(xp.where(speed > _ZERO, price, OUT_OF_REACH))
    return _AtWork(effort, xp.sum(xp.where(goes_on, to_go, 0), axis=-1), reward_per_s)


def _value_now(config: WorldConfig, look: Outlook, team: _AtWork) -> Float[Array, "*B"]:
    """Value of the table as it stands."""
    tries = one_step.tries_of(config, look, tuple(each[NOW] for each in look.expected), team.effort, way=0)
    return one_step.limited(tries.sum(axis=2)[:, 0], team.num_decisions)


def _wait_s(config: WorldConfig, robots: Robots, others: Others, seconds: Float[Array, "L N *B"]) -> Float[Array, "*B"]:
    """Time until the first of the other robots is expected to be done; 0 where none is at work [s]."""
    xp = library_of(robots.since_s)
    speed = xp.asarray(config.speed, dtype=np.float32)
    of_robots = xp.broadcast_to(seconds, (robots.num_robots, *seconds.shape[1:]))
    expected_s = xp.take_along_axis(of_robots, xp.moveaxis(robots.target, -1, 0)[:, None], axis=1)[:, 0]
    expected_s = xp.moveaxis(expected_s, 0, -1) / speed
    left_s = xp.maximum(expected_s - robots.since_s, LEAST_LEFT * expected_s)
    is_leaving = robots.is_busy & (robots.verb == Verb.FINISH)
    left_s = xp.where(is_leaving, config.transport_s / speed, left_s)
    is_to_end = others.is_at_object | is_leaving
    first_s = xp.min(xp.where(is_to_end, left_s, np.float32(np.inf)), axis=-1)
    return xp.where(xp.any(is_to_end, axis=-1), first_s, _ZERO)
