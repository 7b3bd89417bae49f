"""What speaks for an action at a table, in one clause: how the object looks, how it slipped, whom it hides."""

from collections.abc import Sequence

import numpy as np

from halfseen.world.action_space import FINISH, ActionSpace
from halfseen.world.state import TableState

_HIDES = 0.1
"""Share of another object from which on an object counts as hiding it."""

_HIDDEN = ((0.1, "in plain sight"), (0.35, "partly hidden"), (0.65, "half hidden"), (np.inf, "mostly hidden"))
_DIRTY = (
    (0.1, "almost surely clean"),
    (0.25, "probably clean"),
    (0.45, "rather clean than dirty"),
    (0.55, "as likely clean as dirty"),
    (0.75, "rather dirty than clean"),
    (0.9, "probably dirty"),
    (np.inf, "almost surely dirty"),
)


def table_grounds(state: TableState, action: int) -> str:
    """Say what the action looks at.

    Parameters
    ----------
    state
        One table with an object on it.
    action
        A possible action.

    Examples
    --------
    >>> from halfseen.tables.present import first_state
    >>> from halfseen.world import Scene
    >>> state = first_state(Scene(np.array([[0.0, 0.5], [0.0, 0.0]])), horizon=10, dirty_share=0.6).state
    >>> table_grounds(state, 4)
    'it is in plain sight (0.00) and rather dirty than clean (0.60), and it hides 0'
    """
    is_there = np.asarray(state.is_on_table)
    hides = np.where(is_there[None, :], np.asarray(state.hides, dtype=np.float64), 0.0)
    occluded = 1.0 - np.prod(1.0 - hides, axis=1)
    is_dirty = 1.0 / (1.0 + np.exp(-np.asarray(state.log_odds, dtype=np.float64)))
    if action == FINISH:
        likely = int(np.argmax(np.where(is_there, is_dirty, -1.0)))
        count = int(is_there.sum())
        left = "the only object left" if count == 1 else f"the likeliest dirty of the {count} objects left, {likely},"
        return f"{left} is {_looks(occluded[likely], is_dirty[likely])}"
    target = int(ActionSpace(len(is_there)).target(action))
    failures = int(np.sum((np.asarray(state.attempt_object) == target) & ~np.asarray(state.attempt_succeeded)))
    slipped = f", it slipped {'once' if failures == 1 else f'{failures} times'}" if failures else ""
    hidden = np.flatnonzero(is_there & (hides[:, target] >= _HIDES))
    more = f", and it hides {_listed(hidden.tolist())}" if len(hidden) else ""
    return f"it is {_looks(occluded[target], is_dirty[target])}{slipped}{more}"


def _looks(occluded: float, is_dirty: float) -> str:
    return f"{_word(_HIDDEN, occluded)} ({abs(occluded):.2f}) and {_word(_DIRTY, is_dirty)} ({is_dirty:.2f})"


def _word(bands: Sequence[tuple[float, str]], value: float) -> str:
    return next(word for bound, word in bands if value < bound)


def _listed(numbers: Sequence[int]) -> str:
    *first, last = [str(number) for number in numbers]
    return f"{', '.join(first)} and {last}" if first else last
