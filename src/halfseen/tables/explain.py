"""Why an action at a table: in clauses that a person can check by looking, and how sure a learned Q may be of it.

*In words.* A LIFT is told by what it would reveal, a WASH by how sure it is that it is right, and what it costs if it
is wrong. Where no look has told anything of an object yet, P(DIRTY) is the prior, which is no evidence: that is said
instead.

*How sure.* What Q is when trajectories are drawn anew with replacement (`bootstrap`) are draws of what Q may be. They
know the sampling error of the log, though too little of it: λ shrinks all of them alike. They do not know that Q may
not be linear in its features, which more trajectories do not mend. So their deviations from the mean are stretched: by
a factor, and as far as an error of Q asks for that no log ever takes away. Both numbers were chosen on tables of three
cups over six steps and two over eight, in the world's default numbers, and checked on others:
``benchmarks/calibration.py``.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from halfseen.arrays import Hides
from halfseen.errors import ArgumentError
from halfseen.shapes import Bool, Float, Int
from halfseen.tables.policy import LinearTablePolicy
from halfseen.world.actions import FINISH, ActionSpace, Verb, possible_actions
from halfseen.world.explanation import Explanation, alike, explained
from halfseen.world.state import TableState, check_goes_on

if TYPE_CHECKING:
    from halfseen.learning.q_learner import CensoredQLearner
    from halfseen.logs import Logs
else:
    CensoredQLearner = Logs = Any  # A decision is put into words without a learner.
from typing import Any

from halfseen.arrays import mapped
from halfseen.planners.belief import belief_of
from halfseen.planners.one_step import ATTEMPT_S, NOW, left_price, table_of
from halfseen.tables.assisted import AssistedPolicy, LawPolicy
from halfseen.tables.look_ahead import ahead_of

_HIDES = 0.1
"""Share of another object from which on an object counts as hiding it."""

_SURE = 0.9
"""P(DIRTY) from which on nobody asks what a wrong WASH costs."""

_SAME_LOG_ODDS = 1e-5

_MOST_TOLD = 2
"""Objects behind another that are told of one by one."""

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

WIDENED = 1.5
"""By which the deviations of the bootstrap are multiplied, where it knows the whole error."""

LASTING_ERROR = 0.1
"""Error of Q that no log takes away, in standard deviations of what a stage pays."""


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

    def looks(self, index: int) -> list[str]:
        """How an object looks: how much of it is hidden, and how dirty."""
        share = float(self.occlusion[index])
        word = _word(_HIDDEN, share)
        hidden = f"{word} ({share:.2f})" if word else "in plain sight"
        if not self.is_told[index]:
            return [hidden, "nothing is known yet of whether it is dirty"]
        return [f"{hidden} and {_word(_DIRTY, self.is_dirty[index])} ({self.is_dirty[index]:.2f})"]

    def known_as(self, index: int) -> str:
        """How dirty an object looks, in brackets."""
        if not self.is_told[index]:
            return " (nothing is known of it yet)"
        return f" ({_word(_DIRTY, self.is_dirty[index])}, {self.is_dirty[index]:.2f})"


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
    if action == FINISH:
        return _left(grounds)
    actions = ActionSpace(len(grounds.is_there))
    verb, target = int(actions.verb(action)), int(actions.target(action))
    said = _revealed(grounds, target) if verb == Verb.LIFT else _described(grounds, target, verb)
    failures = int(grounds.failures[target])
    return said + (f"; it slipped {'once' if failures == 1 else f'{failures} times'}" if failures else "")


def _revealed(grounds: Grounds, target: int) -> str:
    """What a LIFT would show: the rest of the object itself, and what stands behind it."""
    occluded, unseen = float(grounds.occlusion[target]), float(grounds.unseen[target])
    behind = sorted(grounds.hidden_by(target), key=lambda k: -grounds.hides[k, target])
    told = behind[:_MOST_TOLD]
    is_unknown = not grounds.is_told[[target, *told]].any()
    known_as = {k: "" if is_unknown else grounds.known_as(k) for k in (target, *told)}
    parts = []
    if occluded >= _HIDES:
        parts.append(f"show its own hidden {occluded:.0%}{known_as[target]}")
    elif unseen >= _HIDES:
        parts.append(f"show the {unseen:.0%} of it that no label has told of{known_as[target]}")
    if told:
        bare = _listed([f"{grounds.hides[k, target]:.0%} of object {k}{known_as[k]}" for k in told])
        more = f", and some of {_listed(sorted(behind[_MOST_TOLD:]))}" if behind != told else ""
        parts.append(f"lay bare {bare}{more}")
    if not parts:
        parts.append(f"show once more what is in plain sight{known_as[target]}")
    return f"it would {' and '.join(parts)}{', of which nothing is known yet' if is_unknown else ''}"


def _described(grounds: Grounds, target: int, verb: int) -> str:
    """How it looks, and whom it hides; of a WASH, what it costs if it is not dirty."""
    clauses, hidden = grounds.looks(target), grounds.hidden_by(target)
    if hidden:
        clauses.append(f"it hides {_listed(hidden)}")
    if verb == Verb.WASH and (grounds.worst_wash or 0.0) < 0.0 and grounds.is_dirty[target] < _SURE:
        clauses.append(f"a wrong WASH costs up to {-(grounds.worst_wash or 0.0):.3g}")
    return f"it is {_listed(clauses, ', and ')}"


def _left(grounds: Grounds) -> str:
    """What a FINISH would leave."""
    told = [int(k) for k in np.flatnonzero(grounds.is_there & grounds.is_told)]
    count = int(grounds.is_there.sum())
    if not told:
        return f"nothing is known yet of the {'only object' if count == 1 else f'{count} objects'} left"
    likely = max(told, key=lambda k: grounds.is_dirty[k])
    left = "the only object left" if count == 1 else f"the likeliest dirty of the {count} objects left, {likely},"
    return f"{left} is {_listed(grounds.looks(likely), ', and ')}"


def _word(bands: Sequence[tuple[float, str]], value: float) -> str:
    return next(word for bound, word in bands if value < bound)


def _listed(parts: Sequence[Any], last_with: str = " and ") -> str:
    *first, last = map(str, parts)
    return f"{', '.join(first)}{last_with}{last}" if first else last


@dataclass(frozen=True, eq=False)
class LearnedExplainer:
    """Explains the decisions of a policy that was learned from a log.

    Parameters
    ----------
    policy
        What was learned.
    replicates
        The same, learned from trajectories drawn anew; its coefficients have a leading axis.
    lasting_error
        Standard deviation of the error of Q that no log takes away [reward].
    """

    policy: LinearTablePolicy
    replicates: LinearTablePolicy
    lasting_error: float = 0.0

    @classmethod
    def of(
        cls, learner: CensoredQLearner, logs: Logs, num_replicates: int = 100, random_state: int = 0
    ) -> "LearnedExplainer":
        """Draw trajectories anew and fit each draw.

        Parameters
        ----------
        learner
            Fitted to `logs`, which are of tables.
        logs
            The log that it was fitted to.
        num_replicates
            B; probabilities of being best are multiples of 1/B.
        random_state
            Seed of the draws.

        Raises
        ------
        ArgumentError
            The learner is not one of tables, has not been fitted to this log, or `num_replicates` is below 2.
        """
        from halfseen.learning.resampling import bootstrap

        if num_replicates < 2:
            raise ArgumentError(f"num_replicates is {num_replicates}; at least 2 are needed")
        if not isinstance(getattr(learner, "policy_", None), LinearTablePolicy):
            raise ArgumentError("the learner has no policy_ of tables; fit it to a log of tables first")
        paid = logs.stages["reward"].to_numpy(dtype=np.float64, na_value=np.nan)
        lasting_error = LASTING_ERROR * float(np.nanstd(paid))
        return cls(learner.policy_, bootstrap(learner, logs, num_replicates, random_state).replicates, lasting_error)

    def explain(self, state: TableState, level: float = 0.9) -> Explanation:
        """Explain what the policy would do at one table.

        Parameters
        ----------
        state
            One table, with a step to go.
        level
            Probability with which the intervals are to hold.

        Returns
        -------
        Explanation
            Its values are those that `policy` goes by (lower confidence bounds, with pessimism), so its best action is
            the one that `policy` takes; intervals and probabilities are those of Q itself.

        Raises
        ------
        ArgumentError
            `level` is out of range, or the trajectory is over.
        """
        check_goes_on(state)
        drawn = replace(self.policy, coefficients=self.replicates.coefficients).estimates(state)
        values, q, is_possible = self.policy.q_values(state), self.policy.estimates(state), possible_actions(state)
        # In float32 interchangeable objects differ by rounding, and that must not choose.
        same = alike(state)
        values, q, draws = (leaf[..., same].astype(np.float64) for leaf in (values, q, drawn))
        is_known = is_possible & np.isfinite(values)
        return explained(values, _stretched(q, draws, is_known, self.lasting_error), is_known, level)


def _stretched(
    q: Float[np.ndarray, " A"], draws: Float[np.ndarray, "B A"], is_known: Bool[np.ndarray, " A"], lasting_error: float
) -> Float[np.ndarray, "B A"]:
    """Draws of Q about Q, as far apart as its whole error."""
    known = draws[:, is_known]
    deviation = known - known.mean(axis=0)
    spread = np.sqrt(np.mean(deviation**2))
    factor = np.hypot(WIDENED, lasting_error / spread if spread > 0 else 0.0)
    stretched = np.full(draws.shape, -np.inf)
    stretched[:, is_known] = q[is_known] + factor * deviation
    return stretched


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
