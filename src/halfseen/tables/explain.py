"""The reason for an action at a table, in clauses that a person can check by looking.

A LIFT is explained by what it would reveal; a WASH by P(DIRTY) of its target, and by its cost if the object is clean.
Before the first label of an object, P(DIRTY) is the prior, which is no evidence: the explanation then says that nothing
is known.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from halfseen.arrays import Hides, mapped
from halfseen.planners.one_step import ATTEMPT_S, NOW, left_price, table_of
from halfseen.shapes import Bool, Float, Int
from halfseen.tables.assisted import AssistedPolicy, LawPolicy
from halfseen.tables.look_ahead import ahead_of
from halfseen.world.actions import FINISH, ActionSpace, Verb
from halfseen.world.state import TableState

_HIDES = 0.1
"""Share of another object that an object must hide to be mentioned."""
_SURE = 0.9
"""P(DIRTY) from which the cost of a wrong WASH is not mentioned."""
_SAME_LOG_ODDS = 1e-5
_MOST_TOLD = 2
"""Most objects behind another that are described one by one."""
_HIDDEN = ((_HIDES, ""), (0.35, "partly hidden"), (0.65, "half hidden"), (np.inf, "mostly hidden"))
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
class TableExplanation:
    """The facts about one table that explain an action.

    Parameters
    ----------
    is_there
        Whether each object is on the table; at least one is.
    hides
        ``hides[i, j]`` is the share of object i that object j alone hides now.
    is_dirty
        P(DIRTY) of each object.
    is_labelled
        Whether a look has labelled it.
    unseen
        Share of its surface that no label covers; NaN where that is not counted.
    failures
        Number of failed attempts.
    worst_wash
        Smallest reward of a WASH [reward]; None if unknown.
    """

    is_there: Bool[np.ndarray, " N"]
    hides: Hides
    is_dirty: Float[np.ndarray, " N"]
    is_labelled: Bool[np.ndarray, " N"]
    unseen: Float[np.ndarray, " N"]
    failures: Int[np.ndarray, " N"]
    worst_wash: float | None = None

    @classmethod
    def of(
        cls, state: TableState, dirty_share: float | None = None, worst_wash: float | None = None
    ) -> "TableExplanation":
        """Derive the facts from a state.

        `dirty_share` is P(DIRTY) of an object before any label; if None, every object counts as labelled. `worst_wash`
        is the smallest reward of a WASH [reward].
        """
        is_there, log_odds = np.asarray(state.is_on_table), np.asarray(state.log_odds, dtype=np.float64)
        seen = np.asarray(state.seen, dtype=np.float64)
        failed = np.asarray(state.attempt_object)[~np.asarray(state.attempt_succeeded)]
        is_labelled = np.ones(len(is_there), dtype=bool)
        if dirty_share is not None:
            prior = np.log(dirty_share) - np.log1p(-dirty_share)
            is_labelled = (np.abs(log_odds - prior) > _SAME_LOG_ODDS * max(1.0, abs(prior))) | (seen > 0.0)
        return cls(
            is_there=is_there,
            hides=np.where(is_there[None, :], np.asarray(state.hides, dtype=np.float64), 0.0),
            is_dirty=1.0 / (1.0 + np.exp(-log_odds)),
            is_labelled=is_labelled,
            unseen=np.where((seen > 0.0).any(), 1.0 - seen, np.nan),
            failures=np.sum(failed[:, None] == np.arange(len(is_there)), axis=0),
            worst_wash=worst_wash,
        )

    @property
    def occlusion(self) -> Float[np.ndarray, " N"]:
        """Hidden share of each object."""
        return 1.0 - np.prod(1.0 - self.hides, axis=1)

    def hidden_by(self, target: int) -> list[int]:
        """Objects on the table that `target` hides enough to be mentioned."""
        return np.flatnonzero(self.is_there & (self.hides[:, target] >= _HIDES)).tolist()

    def looks(self, index: int) -> list[str]:
        """Describe an object: its hidden share, and P(DIRTY)."""
        share = float(self.occlusion[index])
        word = _word(_HIDDEN, share)
        hidden = f"{word} ({share:.2f})" if word else "in plain sight"
        if not self.is_labelled[index]:
            return [hidden, "not labelled yet"]
        return [f"{hidden} and {_word(_DIRTY, self.is_dirty[index])} ({self.is_dirty[index]:.2f})"]

    def known_as(self, index: int) -> str:
        """P(DIRTY) of an object in words, in brackets."""
        if not self.is_labelled[index]:
            return " (not labelled yet)"
        return f" ({_word(_DIRTY, self.is_dirty[index])}, {self.is_dirty[index]:.2f})"


def action_reason(explanation: TableExplanation, action: int) -> str:
    """Explain an action.

    Examples
    --------
    >>> from halfseen.tables.present import first_state
    >>> from halfseen.world import Scene
    >>> state = first_state(Scene(np.array([[0.0, 0.5], [0.0, 0.0]])), horizon=10, dirty_share=0.6).state
    >>> explanation = TableExplanation.of(state, dirty_share=0.6, worst_wash=-10.0)
    >>> action_reason(explanation, 4)
    'it would uncover 50% of object 0, not labelled yet'
    >>> action_reason(explanation, 1)
    'it is half hidden (0.50), not labelled yet, and a wrong WASH costs up to 10'
    """
    if action == FINISH:
        return _left(explanation)
    actions = ActionSpace(len(explanation.is_there))
    verb, target = int(actions.verb(action)), int(actions.target(action))
    said = _revealed(explanation, target) if verb == Verb.LIFT else _described(explanation, target, verb)
    failures = int(explanation.failures[target])
    return said + (f"; it slipped {'once' if failures == 1 else f'{failures} times'}" if failures else "")


def _revealed(explanation: TableExplanation, target: int) -> str:
    """Say what a LIFT would reveal: the rest of the object itself, and the objects behind it."""
    occluded, unseen = float(explanation.occlusion[target]), float(explanation.unseen[target])
    behind = sorted(explanation.hidden_by(target), key=lambda k: -explanation.hides[k, target])
    shown = behind[:_MOST_TOLD]
    is_unknown = not explanation.is_labelled[[target, *shown]].any()
    known_as = {k: "" if is_unknown else explanation.known_as(k) for k in (target, *shown)}
    parts = []
    if occluded >= _HIDES:
        parts.append(f"show its own hidden {occluded:.0%}{known_as[target]}")
    elif unseen >= _HIDES:
        parts.append(f"show the {unseen:.0%} of it that no label has covered{known_as[target]}")
    if shown:
        bare = _listed([f"{explanation.hides[k, target]:.0%} of object {k}{known_as[k]}" for k in shown])
        more = f", and some of {_listed(sorted(behind[_MOST_TOLD:]))}" if behind != shown else ""
        parts.append(f"uncover {bare}{more}")
    if not parts:
        parts.append(f"show again what is in plain sight{known_as[target]}")
    return f"it would {' and '.join(parts)}{', not labelled yet' if is_unknown else ''}"


def _described(explanation: TableExplanation, target: int, verb: int) -> str:
    """Describe the target and the objects that it hides; for a WASH, also its cost if the target is clean."""
    clauses, hidden = explanation.looks(target), explanation.hidden_by(target)
    if hidden:
        clauses.append(f"it hides {_listed(hidden)}")
    if verb == Verb.WASH and (explanation.worst_wash or 0.0) < 0.0 and explanation.is_dirty[target] < _SURE:
        clauses.append(f"a wrong WASH costs up to {-(explanation.worst_wash or 0.0):.3g}")
    return f"it is {_listed(clauses, ', and ')}"


def _left(explanation: TableExplanation) -> str:
    """Describe the objects that a FINISH would leave."""
    labelled = [int(k) for k in np.flatnonzero(explanation.is_there & explanation.is_labelled)]
    count = int(explanation.is_there.sum())
    if not labelled:
        none = "the only object left is not" if count == 1 else f"none of the {count} objects left is"
        return f"{none} labelled yet"
    likely = max(labelled, key=lambda k: explanation.is_dirty[k])
    left = "the only object left" if count == 1 else f"the object most likely dirty of the {count} left, {likely},"
    return f"{left} is {_listed(explanation.looks(likely), ', and ')}"


def _word(bands: Sequence[tuple[float, str]], value: float) -> str:
    return next(word for bound, word in bands if value < bound)


def _listed(parts: Sequence[Any], last_with: str = " and ") -> str:
    *first, last = map(str, parts)
    return f"{', '.join(first)}{last_with}{last}" if first else last


def implied(policy: LawPolicy, state: TableState, action: int) -> str:
    """Describe what the laws of a policy's log imply for an action.

    Examples
    --------
    >>> from halfseen.tables.present import first_state
    >>> from halfseen.world import Scene, WorldConfig
    >>> state = first_state(Scene(np.array([[0.0, 0.5], [0.0, 0.0]])), horizon=10, dirty_share=0.6).state
    >>> policy = AssistedPolicy(WorldConfig())
    >>> implied(policy, state, 2)
    'under the laws fitted to its log a grasp holds with probability 0.87, and the WASH pays 1.62 on average'
    >>> implied(policy, state, 4)
    'under the laws fitted to its log a grasp holds with probability 0.87, and the look is worth 3.09 and costs 0.30'
    >>> implied(policy, state, 0)
    'under the laws fitted to its log 1.2 dirty objects would be left, which costs 6.0'
    """
    config, mended = policy.config, mapped(np.asarray, policy.mended(state))
    ahead = ahead_of(config, table_of(config, mended))
    by_laws = "under the laws fitted to its log"
    if action == FINISH:
        price = float(left_price(config, ahead.table))
        count = price / float(config.reward_dirty_left) if config.reward_dirty_left else 0.0
        return f"{by_laws} {count:.1f} dirty objects would be left, which costs {-price:.1f}"
    space = ActionSpace(state.num_objects)
    verb, target = int(space.verb(action)), int(space.target(action))
    expected = ahead.look.expected[0]
    chance = float(expected[NOW][target])
    further = ""
    if isinstance(policy, AssistedPolicy) and policy.excess is not None:
        further = f"; further steps add {float(policy.excess(ahead)[action - 1]):.2f}"
    if verb == Verb.WASH:
        pays = float(ahead.look.worth[target])
        return (
            f"{by_laws} a grasp holds with probability {chance:.2f}, and the WASH pays {pays:.2f} on average{further}"
        )
    cost = -float(config.reward_lift_per_s) * (float(config.transport_s) + float(expected[ATTEMPT_S][target]))
    worth = float(ahead.values[1][action - 1] - ahead.control) + cost
    return (
        f"{by_laws} a grasp holds with probability {chance:.2f}, and the look is worth {worth:.2f} and costs "
        f"{cost:.2f}{further}"
    )
