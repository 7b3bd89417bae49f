"""The myopic look-ahead for the deciding robot of a team, with WAIT among its actions and the price of time.

It extends the look-ahead of `one_step`. Later tries are made by the fastest robot that reaches the object and has a
decision left, and cost the price of its seconds. If robots have their own laws of grasping, the robot with the largest
gain makes the try. Objects that another robot is washing are not tried again. FINISH leaves to the others the objects
that they reach. WAIT gains the labels of the next look, at the cost of this robot's idle seconds. While n robots go on,
a second of one robot is assumed to add 1/n second to the table's clock.
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
"""Lower bound on the expected remaining time of an attempt in progress, as a share of its expected time."""
OUT_OF_REACH = np.float32(1e30)
"""Price of a try that no robot can make."""
_ZERO, _ONE = np.float32(0.0), np.float32(1.0)


@record
class MyopicPolicy(ByValue):
    """Takes the best action by the myopic look-ahead.

    Parameters
    ----------
    config
        Its model of the world, with the price of time.
    """

    config: WorldConfig

    @property
    def num_robots(self) -> int | None:
        """K; None, for any number, if the model has a single robot."""
        return self.config.num_robots if self.config.num_robots > 1 else None

    def q_values(self, state: TableState) -> Float[Array, "*B A"]:
        """Value of each action, WAIT last, relative to leaving all objects; −∞ if impossible."""
        if state.robots is None:
            q = one_step.one_step_q(self.config, state)
            return q - q[..., :1]
        return _q_of_team(self.config, state, state.robots, others_of(state))


class _AtWork(NamedTuple):
    """Robots of a table that go on."""

    effort: tuple[Float[Array, " N *B"], ...]
    """Price of the time of a try by the fastest of them that reaches it and has a decision left, under each law."""
    num_decisions: Int[Array, "*B"]
    """Number of their decisions after this one."""
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
    # An object that another robot washes hides others and is seen, but is not tried.
    look = one_step.outlook_of(config, table, setting._replace(label=setting.label * ~_washed(state, robots, others)))
    seconds = config.transport_s + xp.stack([each[one_step.ATTEMPT_S] for each in look.expected])
    everyone = others.goes_on | is_decider(state)
    with_me, without_me = (_at_work(config, state, robots, seconds, who) for who in (everyone, others.goes_on))
    own_s = xp.take_along_axis(seconds, robot[None, None], axis=0)[0] / speed[state.decider]
    tries = one_step.tries_after(one_step.tries_then(config, look, with_me.effort))
    gains = one_step.limited(tries, with_me.num_decisions)
    values = one_step.attempts_worth(config, look, gains[None], own_s, with_me.reward_per_s)
    # The last robot to leave ends the trajectory, without a further look.
    finish = _value_now(config, look, without_me) * xp.any(others.goes_on, axis=-1)
    wait = _value_now(config, look, with_me) + with_me.reward_per_s * _wait_s(config, robots, others, seconds)
    q = xp.concatenate([one_step.laid_out(finish, values), wait[..., None]], axis=-1)
    return xp.where(possible_actions(state), q, np.float32(-np.inf))


def _washed(state: TableState, robots: Robots, others: Others) -> Bool[Array, " N *B"]:
    """Objects that another robot is washing."""
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
    """Expected time until the first of the other robots is done; 0 if none is at work [s]."""
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
