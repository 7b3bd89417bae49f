"""What E of a team looks at: what the myopic look makes of each action, and what follows it on the team's table.

=====================  ==============================================================================================
1                      by verb, WAIT among them
short, near            by verb: what the myopic look takes the action to fall short of the best, and (short + 1)₊
what follows           the numbers of `halfseen.tables.team_features`: what is under way, what the team can still
                       clear, who reaches it, and for how long all will be busy
=====================  ==============================================================================================

With one robot the look at what labels may still reveal told E what it needed. With several the schedule matters as
much, of which the myopic look knows only that a second is shared.
"""

import numpy as np

from halfseen.arrays import Array, library_of
from halfseen.shapes import Float
from halfseen.tables.team_features import NUM_FEATURES, team_features
from halfseen.world.actions import VERB_NAMES, WAIT, ActionSpace
from halfseen.world.state import TableState

TEAM_FEATURES_VERSION = 1
"""Coefficients mean nothing beside other features: raise this number whenever a feature changes."""

NUM_VERBS = len(VERB_NAMES)
NUM_TEAM_FEATURES = 3 * NUM_VERBS + NUM_FEATURES

_ZERO, _ONE = np.float32(0.0), np.float32(1.0)


def team_described(state: TableState, q: Float[Array, "*B A"]) -> Float[Array, "*B A F"]:
    """Describe every action of the robot that decides.

    Parameters
    ----------
    state
        Tables of a team.
    q
        What the myopic look makes of each action; −∞ where it is impossible.
    """
    xp = library_of(q)
    verb = np.append(ActionSpace(state.num_objects).verbs, WAIT)
    is_verb = xp.asarray(np.eye(NUM_VERBS, dtype=np.float32)[verb])
    short = xp.where(q > -np.inf, q - xp.max(q, axis=-1, keepdims=True), _ZERO)
    numbers = (xp.ones_like(short), short / np.float32(5.0), xp.maximum(short + _ONE, _ZERO))
    by_verb = [each[..., None] * is_verb for each in numbers]
    return xp.concatenate([*by_verb, team_features(state)], axis=-1).astype(np.float32)
