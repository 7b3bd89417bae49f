"""Why a policy takes one action on a table rather than the next best, in one sentence."""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from halfseen.policies.reasons import lead, next_best
from halfseen.shapes import Float
from halfseen.tables.explain import Grounds, table_grounds
from halfseen.world.actions import ActionSpace


def table_reason(grounds: Grounds, q: Float[np.ndarray, " A"], chance_best: Mapping[str, float] | None = None) -> str:
    """Say why the best action of one table is best.

    Parameters
    ----------
    grounds
        What there is to be said of the table.
    q
        Q of each action; −∞ where impossible.
    chance_best
        Probability that no action is better, by name; nothing where nobody knows it.

    Examples
    --------
    >>> from halfseen.tables.present import first_state
    >>> from halfseen.world import Scene
    >>> state = first_state(Scene(np.array([[0.0, 0.5], [0.0, 0.0]])), horizon=10, dirty_share=0.6).state
    >>> table_reason(Grounds.of(state, 0.6), np.array([0.0, 1.0, 0.5, 0.0, 1.8]))
    'LIFT 1: worth 0.80 more than WASH 0; it would lay bare 50% of object 0, of which nothing is known yet; as for \
WASH 0, it is half hidden (0.50), and nothing is known yet of whether it is dirty.'
    """
    names, best = ActionSpace(len(grounds.is_there)).names, int(np.argmax(q))
    own = table_grounds(grounds, best)
    told, other = [lead(names, q, best, chance_best or {}), own], next_best(q, best)
    # What a wrong WASH costs is told once.
    free = replace(grounds, worst_wash=None)
    rest = grounds if table_grounds(free, best) == own else free
    if other is not None and (against := table_grounds(rest, other)) != own:
        told.append(f"as for {names[other]}, {against}")
    return f"{'; '.join(told)}."
