"""Explanations of a decision: the value of each action, its uncertainty, and the probability that it is best.

A state is explained by draws from a distribution of Q, such as that of a planner whose error is known. For the
uncertainty of a learned Q see `halfseen.policies.decision`.
"""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any, TypeAlias

import numpy as np

from halfseen.errors import ArgumentError
from halfseen.shapes import Bool, Float, Int
from halfseen.world.actions import FINISH, TARGETED, ActionSpace, Verb
from halfseen.world.state import TableState

Values: TypeAlias = Float[np.ndarray, " A"]
Draws: TypeAlias = Float[np.ndarray, "B A"]
Mask: TypeAlias = Bool[np.ndarray, " A"]

SAME_VALUE = 1e-6
"""Values in a draw that differ by less are tied [reward]; float32 resolves less than this."""
_SAME = 1e-4
_NUM_SHOWN = 8


@dataclass(frozen=True, eq=False)
class Explanation:
    """Values of the actions of one table, as expected rewards to the end of the trajectory, with their uncertainty.

    For impossible actions, values and intervals are −∞ and probabilities 0.

    Attributes
    ----------
    actions
        Names of the actions, as in `halfseen.world.actions`.
    values
        Q of each action [reward].
    low, high
        Interval that contains the true Q with probability `level`.
    probability_best
        Probability that no action is better. Equally good actions all count as best, so the sum over actions is 1 or
        more.
    lift_worth
        Q(LIFT i) minus the value of the best action other than a LIFT, for each object [reward].
    lift_low, lift_high
        Interval of `lift_worth`.
    level
        Coverage probability of the intervals.
    """

    actions: tuple[str, ...]
    values: Values
    low: Values
    high: Values
    probability_best: Values
    lift_worth: Float[np.ndarray, " N"]
    lift_low: Float[np.ndarray, " N"]
    lift_high: Float[np.ndarray, " N"]
    level: float

    @property
    def best(self) -> int:
        """Action with the largest value; the lowest in a tie."""
        return int(np.argmax(self.values))

    @property
    def probability_stop_is_right(self) -> float:
        """Probability that no action is better than FINISH now."""
        return float(self.probability_best[FINISH])

    def as_dict(self) -> dict:
        """Plain numbers for JSON; None for impossible actions."""
        facts: dict[str, Any] = asdict(self)
        for name, values in facts.items():
            if isinstance(values, np.ndarray):
                facts[name] = [float(number) if np.isfinite(number) else None for number in values]
        best, stop = self.actions[self.best], self.probability_stop_is_right
        return facts | {"actions": list(self.actions), "best": best, "probability_stop_is_right": stop}

    def __str__(self) -> str:
        possible = np.flatnonzero(np.isfinite(self.values))
        order = possible[np.argsort(-self.values[possible], kind="stable")]
        lines = [f"{'action':10}{'value':>8}  {f'{100.0 * self.level:g}% interval':>16}{'best':>7}"]
        for k in order[:_NUM_SHOWN]:
            interval = f"{self.low[k]:+.2f} to {self.high[k]:+.2f}"
            row = f"{self.actions[k]:10}{self.values[k]:+8.2f}  {interval:>16}{self.probability_best[k]:7.2f}"
            lines.append(row)
        if len(order) > _NUM_SHOWN:
            lines.append(f"and {len(order) - _NUM_SHOWN} more that are worth less")
        return "\n".join([*lines, self._sentence()])

    def _sentence(self) -> str:
        actions, best = ActionSpace(len(self.lift_worth)), self.best
        parts = [f"{self.actions[best]}: best with probability {self.probability_best[best]:.2f}"]
        lift = int(np.argmax(self.lift_worth))
        if np.isfinite(self.lift_worth[lift]):
            other = self.actions[int(np.argmax(np.where(actions.verbs == Verb.LIFT, -np.inf, self.values)))]
            subject = "worth" if actions.verb(best) == Verb.LIFT else f"LIFT {lift} is worth"
            low, high = self.lift_low[lift], self.lift_high[lift]
            parts.append(f"{subject} {self.lift_worth[lift]:+.2f} ({low:+.2f} to {high:+.2f}) over {other} now")
        parts.append(f"stopping now is right with probability {self.probability_stop_is_right:.2f}")
        return "; ".join(parts) + "."


def explained(values: Values, draws: Draws, is_possible: Mask, level: float = 0.9) -> Explanation:
    """Explain one state of a table by draws from the distribution of Q.

    Parameters
    ----------
    values
        Q of each action; ignored for impossible actions.
    draws
        Joint draws of Q over all actions, since errors common to all actions do not change which is best.
    is_possible
        Which actions the state allows; FINISH is among them.
    level
        Coverage probability of the intervals, in (0, 1).

    Returns
    -------
    Explanation
        Intervals are central quantiles of the draws; an action is best in a draw if no other is better by 1e-6.

    Raises
    ------
    ArgumentError
        The actions are not those of a table, FINISH is impossible, a number is not finite, there are no draws, or
        `level` is out of range.

    Examples
    --------
    One object; in three of four draws a look at it is best.

    >>> draws = np.array([[0.0, 1.0, 2.0], [0.0, 1.0, 1.5], [0.0, 2.0, 1.5], [0.0, 1.0, 3.0]])
    >>> print(explained(draws.mean(axis=0), draws, np.ones(3, dtype=bool)))
    action       value      90% interval   best
    LIFT 0       +2.00    +1.50 to +2.85   0.75
    WASH 0       +1.25    +1.00 to +1.85   0.25
    FINISH       +0.00    +0.00 to +0.00   0.00
    LIFT 0: best with probability 0.75; worth +0.75 (-0.35 to +1.85) over WASH 0 now; stopping now is right with \
probability 0.00.
    """
    _check(values, draws, is_possible, level)
    actions = ActionSpace.of_size(len(values))
    values = np.where(is_possible, values, -np.inf)
    draws = np.where(is_possible, draws, -np.inf)
    is_best = draws >= draws.max(axis=1, keepdims=True) - SAME_VALUE
    low, high = _interval(draws, is_possible, level)
    is_liftable = is_possible[actions.of(Verb.LIFT)]
    lift_low, lift_high = _interval(_lift_worth(draws), is_liftable, level)
    return Explanation(
        actions=actions.names,
        values=values,
        low=low,
        high=high,
        probability_best=np.where(is_possible, is_best.mean(axis=0), 0.0),
        lift_worth=_lift_worth(values),
        lift_low=lift_low,
        lift_high=lift_high,
        level=float(level),
    )


def alike(state: TableState) -> Int[np.ndarray, " A"]:
    """For each action, the lowest action equivalent to it up to the numbering of the objects.

    Two objects are interchangeable if swapping them leaves all that is observed unchanged: location, grip, log-odds,
    share seen, past attempts, and which object hides which. The same verb on either then has the same value, whatever
    the estimates.
    """
    there = np.asarray(state.is_on_table)
    known = np.stack([np.asarray(leaf, dtype=np.float64) for leaf in (state.log_odds, state.grip, state.seen)])
    hides = np.where(there[:, None] & there[None, :], np.asarray(state.hides), 0.0)
    tried = [_attempts(state, target) for target in range(state.num_objects)]
    first = np.arange(state.num_objects)
    for i in np.flatnonzero(there):
        for j in np.flatnonzero(there[:i]):
            order = np.arange(state.num_objects)
            order[[i, j]] = j, i
            is_same = (np.abs(known[:, i] - known[:, j]) < _SAME).all() and tried[i] == tried[j]
            if is_same and np.array_equal(hides[np.ix_(order, order)], hides):
                first[i] = j
                break
    actions = ActionSpace(state.num_objects)
    return np.concatenate([[FINISH], *(actions.encode(int(verb), first) for verb in TARGETED)])


def _attempts(state: TableState, target: int) -> Sequence[tuple[float, bool]]:
    is_mine = np.asarray(state.attempt_object) == target
    occluded = np.asarray(state.attempt_occlusion)[is_mine].tolist()
    return sorted(zip(occluded, np.asarray(state.attempt_succeeded)[is_mine].tolist(), strict=True))


def _lift_worth(values: Float[np.ndarray, "*S A"]) -> Float[np.ndarray, "*S N"]:
    actions = ActionSpace.of_size(values.shape[-1])
    others = values[..., actions.verbs != Verb.LIFT]
    return values[..., actions.of(Verb.LIFT)] - others.max(axis=-1, keepdims=True)


def _interval(
    draws: Float[np.ndarray, "B k"], is_possible: Bool[np.ndarray, " k"], level: float
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Central quantiles; −∞ where impossible."""
    ends = np.full((2, len(is_possible)), -np.inf)
    ends[:, is_possible] = np.quantile(draws[:, is_possible], [(1.0 - level) / 2.0, (1.0 + level) / 2.0], axis=0)
    return ends[0], ends[1]


def _check(values: Values, draws: Draws, is_possible: Mask, level: float) -> None:
    actions = ActionSpace.of_size(len(values))
    if len(values) != actions.num_actions or not is_possible[FINISH]:
        raise ArgumentError(
            f"there are {len(values)} actions and FINISH is {'' if is_possible[FINISH] else 'im'}possible; a "
            f"table needs FINISH, which is always possible, and {', '.join(verb.name for verb in TARGETED)} for "
            "each object"
        )
    if len(draws) == 0:
        raise ArgumentError("no draws of Q; give at least one")
    if not 0.0 < level < 1.0:
        raise ArgumentError(f"level is {level}; give a level between 0 and 1")
    wrong = is_possible & ~(np.isfinite(values) & np.isfinite(draws).all(axis=0))
    if wrong.any():
        action = int(np.argmax(wrong))
        raise ArgumentError(
            f"Q of {actions.names[action]} is not finite although the action is possible; give finite values and draws"
        )
