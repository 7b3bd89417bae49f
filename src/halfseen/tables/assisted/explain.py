"""What fitted laws say of an action, in numbers: the chance of a grasp, the worth of a look, what is left."""

from typing import Any

import numpy as np

from halfseen.arrays import mapped
from halfseen.planners.belief import belief_of, grasp_probability, prior_grip
from halfseen.planners.one_step import ATTEMPT_S, NOW, left_price, table_of
from halfseen.tables.assisted.features import ahead_of
from halfseen.tables.assisted.policy import AssistedPolicy, LawPolicy
from halfseen.tables.laws import FittedLaws
from halfseen.tables.laws.evidence import Watched
from halfseen.world.actions import FINISH, ActionSpace, Verb
from halfseen.world.state import TableState

IN_SIGHT = 0.05
"""Hidden share below which an object is in plain sight."""


def implied(policy: LawPolicy, state: TableState, action: int) -> str:
    """Say what the laws of a policy's log imply for an action.

    Parameters
    ----------
    policy
        What decides.
    state
        One table, with an object on it.
    action
        A possible action.

    Examples
    --------
    >>> from halfseen.tables.present import first_state
    >>> from halfseen.world import Scene, WorldConfig
    >>> state = first_state(Scene(np.array([[0.0, 0.5], [0.0, 0.0]])), horizon=10, dirty_share=0.6).state
    >>> policy = AssistedPolicy(WorldConfig())
    >>> implied(policy, state, 2)
    'by the laws of its log a grasp holds with 0.87, and the WASH pays 1.62 on average'
    >>> implied(policy, state, 4)
    'by the laws of its log a grasp holds with 0.87, and the look is worth 3.09, for 0.30'
    >>> implied(policy, state, 0)
    'by the laws of its log 1.2 dirty objects would be left, for 6.0'
    """
    config, mended = policy.config, mapped(np.asarray, policy.mended(state))
    ahead = ahead_of(config, table_of(belief_of(config, mended)))
    told = "by the laws of its log"
    if action == FINISH:
        price = float(left_price(config, ahead.table))
        count = price / float(config.reward_dirty_left) if config.reward_dirty_left else 0.0
        return f"{told} {count:.1f} dirty objects would be left, for {-price:.1f}"
    space = ActionSpace(state.num_objects)
    verb, target = int(space.verb(action)), int(space.target(action))
    expected = ahead.look.expected[0]
    chance = float(expected[NOW][target])
    further = _further(policy, ahead, action)
    if verb == Verb.WASH:
        pays = float(ahead.look.worth[target])
        return f"{told} a grasp holds with {chance:.2f}, and the WASH pays {pays:.2f} on average{further}"
    cost = -float(config.reward_lift_per_s) * (float(config.transport_s) + float(expected[ATTEMPT_S][target]))
    worth = float(ahead.values[1][action - 1] - ahead.control) + cost
    return f"{told} a grasp holds with {chance:.2f}, and the look is worth {worth:.2f}, for {cost:.2f}{further}"


def _further(policy: LawPolicy, ahead: Any, action: int) -> str:
    """What further steps add, where that was simulated."""
    if not isinstance(policy, AssistedPolicy) or policy.excess is None:
        return ""
    return f"; further steps add {float(policy.excess(ahead)[action - 1]):.2f}"


def laws_in_words(laws: FittedLaws, tried: Watched) -> str:
    """Say what fitted laws amount to for the attempts of their log, and for a first look.

    Parameters
    ----------
    laws
        The laws.
    tried
        The attempts.
    """
    config: Any = laws.config
    grip = prior_grip(tried.grip.astype(np.float32))
    chance = grasp_probability(config, tried.occlusion.astype(np.float32), grip)
    parts = []
    for words, is_it in (
        ("in plain sight", tried.occlusion < IN_SIGHT),
        ("half hidden or more", tried.occlusion > 0.5),
    ):
        if is_it.any():
            parts.append(f"{chance[is_it].mean():.2f} of the {is_it.sum():,} objects that were {words}")
    held = f"a first grasp holds for {' and '.join(parts)}; " if parts else ""
    found, falsely = (float(each) for each in config.seeing.positive(0.0, 0.0))
    looks = f"a first look in full view calls dirty {found:.0%} of what is and {falsely:.0%} of what is not"
    return f"by its laws {held}{looks}"
