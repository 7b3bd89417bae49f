"""What there is to be said of an action at a table, in clauses that a person can check by looking.

A LIFT is told by what it would reveal, a WASH by how sure it is that it is right, and what it costs if it is wrong.
Where no look has told anything of an object yet, P(DIRTY) is the prior, which is no evidence: that is said instead.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

from halfseen.arrays import Hides
from halfseen.world.actions import FINISH, ActionSpace, Verb
from halfseen.world.state import TableState

_HIDES = 0.1
"""Share of another object from which on an object counts as hiding it."""

_SURE = 0.9
"""P(DIRTY) from which on nobody asks what a wrong WASH costs."""

_SAME_LOG_ODDS = 1e-5

_MOST_TOLD = 2
"""Objects behind another that are told of one by one."""

_HIDDEN = ((0.35, "partly hidden"), (0.65, "half hidden"), (np.inf, "mostly hidden"))
_DIRTY = (
    (0.1, "almost surely clean"),
    (0.25, "probably clean"),
    (0.45, "rather clean than dirty"),
    (0.55, "as likely clean as dirty"),
    (0.75, "rather dirty than clean"),
    (0.9, "probably dirty"),
    (np.inf, "almost surely dirty"),
)


@dataclass(frozen=True, eq=False)
class Grounds:
    """What there is to be said of one table.

    Parameters
    ----------
    is_there
        What is on the table; at least one object.
    hides
        ``hides[i, j]`` is the share of object i that object j alone hides now.
    is_dirty
        P(DIRTY) of each.
    is_told
        Whether a look has told anything of it.
    unseen
        Share of its surface that no label has told of; NaN where that is not counted.
    failures
        How often it slipped.
    worst_wash
        Least that a WASH pays [reward]; None if nobody knows.
    """

    is_there: Bool[np.ndarray, " N"]
    hides: Hides
    is_dirty: Float[np.ndarray, " N"]
    is_told: Bool[np.ndarray, " N"]
    unseen: Float[np.ndarray, " N"]
    failures: Int[np.ndarray, " N"]
    worst_wash: float | None = None

    @classmethod
    def of(cls, state: TableState, dirty_share: float | None = None, worst_wash: float | None = None) -> "Grounds":
        """Read them off a state.

        Parameters
        ----------
        state
            One table with an object on it.
        dirty_share
            P(DIRTY) of an object before any label; None if nobody knows it, and then all counts as told.
        worst_wash
            Least that a WASH pays [reward]; None if nobody knows.
        """
        is_there, log_odds = np.asarray(state.is_on_table), np.asarray(state.log_odds, dtype=np.float64)
        seen = np.asarray(state.seen, dtype=np.float64)
        failed = np.asarray(state.attempt_object)[~np.asarray(state.attempt_succeeded)]
        is_told = np.ones(len(is_there), dtype=bool)
        if dirty_share is not None:
            prior = np.log(dirty_share) - np.log1p(-dirty_share)
            is_told = (np.abs(log_odds - prior) > _SAME_LOG_ODDS * max(1.0, abs(prior))) | (seen > 0.0)
        return cls(
            is_there=is_there,
            hides=np.where(is_there[None, :], np.asarray(state.hides, dtype=np.float64), 0.0),
            is_dirty=1.0 / (1.0 + np.exp(-log_odds)),
            is_told=is_told,
            unseen=np.where((seen > 0.0).any(), 1.0 - seen, np.nan),
            failures=np.sum(failed[:, None] == np.arange(len(is_there)), axis=0),
            worst_wash=worst_wash,
        )

    @property
    def occlusion(self) -> Float[np.ndarray, " N"]:
        """Hidden share of each object."""
        return 1.0 - np.prod(1.0 - self.hides, axis=1)

    def hidden_by(self, target: int) -> list[int]:
        """Objects on the table that one hides enough to be told of."""
        return np.flatnonzero(self.is_there & (self.hides[:, target] >= _HIDES)).tolist()


def table_grounds(grounds: Grounds, action: int) -> str:
    """Say what there is to be said of an action.

    Parameters
    ----------
    grounds
        What there is to be said.
    action
        A possible action.

    Examples
    --------
    >>> from halfseen.tables.present import first_state
    >>> from halfseen.world import Scene
    >>> state = first_state(Scene(np.array([[0.0, 0.5], [0.0, 0.0]])), horizon=10, dirty_share=0.6).state
    >>> grounds = Grounds.of(state, dirty_share=0.6, worst_wash=-10.0)
    >>> table_grounds(grounds, 4)
    'it would lay bare 50% of object 0, of which nothing is known yet'
    >>> table_grounds(grounds, 1)
    'it is half hidden (0.50), nothing is known yet of whether it is dirty, and a wrong WASH costs up to 10'
    """
    actions = ActionSpace(len(grounds.is_there))
    if action == FINISH:
        return _left(grounds)
    target = int(actions.target(action))
    of_verb = _GROUNDS.get(actions.verb(action), _described)
    failures = int(grounds.failures[target])
    slipped = f"; it slipped {'once' if failures == 1 else f'{failures} times'}" if failures else ""
    return of_verb(grounds, target) + slipped


def _revealed(grounds: Grounds, target: int) -> str:
    """What a LIFT would show: the rest of the object itself, and what stands behind it."""
    occluded, unseen = float(grounds.occlusion[target]), float(grounds.unseen[target])
    behind = sorted(grounds.hidden_by(target), key=lambda k: -grounds.hides[k, target])
    told = behind[:_MOST_TOLD]
    is_unknown = not grounds.is_told[[target, *told]].any()

    def known_as(index: int) -> str:
        return "" if is_unknown else f" ({_known_as(grounds, index)})"

    parts = []
    if occluded >= _HIDES:
        parts.append(f"show its own hidden {occluded:.0%}{known_as(target)}")
    elif unseen >= _HIDES:
        parts.append(f"show the {unseen:.0%} of it that no label has told of{known_as(target)}")
    if told:
        bare = _listed([f"{grounds.hides[k, target]:.0%} of object {k}{known_as(k)}" for k in told])
        more = f", and some of {_listed([str(k) for k in sorted(behind[_MOST_TOLD:])])}" if behind != told else ""
        parts.append(f"lay bare {bare}{more}")
    if not parts:
        parts.append(f"show once more what is in plain sight{known_as(target)}")
    return f"it would {' and '.join(parts)}{', of which nothing is known yet' if is_unknown else ''}"


def _washed(grounds: Grounds, target: int) -> str:
    """How sure it is that a WASH is right, and what it costs if it is not."""
    if grounds.worst_wash is None or grounds.worst_wash >= 0.0 or grounds.is_dirty[target] >= _SURE:
        return _described(grounds, target)
    return _described(grounds, target, f"a wrong WASH costs up to {-grounds.worst_wash:.3g}")


def _described(grounds: Grounds, target: int, *more: str) -> str:
    """How it looks, and whom it hides."""
    hidden = [f"it hides {_listed([str(k) for k in grounds.hidden_by(target)])}"] if grounds.hidden_by(target) else []
    return f"it is {_joined([*_looks(grounds, target), *hidden, *more])}"


_GROUNDS = {int(Verb.WASH): _washed, int(Verb.LIFT): _revealed}
"""Of another verb there is to be said how its object looks."""


def _known_as(grounds: Grounds, index: int) -> str:
    if not grounds.is_told[index]:
        return "nothing is known of it yet"
    return f"{_word(_DIRTY, grounds.is_dirty[index])}, {grounds.is_dirty[index]:.2f}"


def _looks(grounds: Grounds, index: int) -> list[str]:
    share = float(grounds.occlusion[index])
    hidden = "in plain sight" if share < _HIDES else f"{_word(_HIDDEN, share)} ({share:.2f})"
    if not grounds.is_told[index]:
        return [hidden, "nothing is known yet of whether it is dirty"]
    return [f"{hidden} and {_word(_DIRTY, grounds.is_dirty[index])} ({grounds.is_dirty[index]:.2f})"]


def _left(grounds: Grounds) -> str:
    """What a FINISH would leave."""
    told = [int(k) for k in np.flatnonzero(grounds.is_there & grounds.is_told)]
    count = int(grounds.is_there.sum())
    if not told:
        return f"nothing is known yet of the {'only object' if count == 1 else f'{count} objects'} left"
    likely = max(told, key=lambda k: grounds.is_dirty[k])
    left = "the only object left" if count == 1 else f"the likeliest dirty of the {count} objects left, {likely},"
    return f"{left} is {_joined(_looks(grounds, likely))}"


def _joined(parts: Sequence[str]) -> str:
    *first, last = parts
    return f"{', '.join(first)}, and {last}" if first else last


def _word(bands: Sequence[tuple[float, str]], value: float) -> str:
    return next(word for bound, word in bands if value < bound)


def _listed(parts: Sequence[str]) -> str:
    *first, last = parts
    return f"{', '.join(first)} and {last}" if first else last
