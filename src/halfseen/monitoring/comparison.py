"""A policy against the rule of today, by trajectories that are dealt to either by chance.

Trajectory i goes to the policy (A = 1) with chance p. Its worth Y is what it earned; where trajectories are cut, the
doubly robust stand-in Y = v(S₁) + Σ_t δ_t/Ĝ(U_t⁻)·(R_t + v(S_{t+1}) − v(S_t)), with v the value of what is left under
its arm (least-squares temporal differences) and Ĝ by Kaplan and Meier: right where either of them is, and Y itself
where nothing is cut. Both are learned from the trajectories before. With c = (1 − p) v¹(S₁) + p v⁰(S₁),
E[(A − p)(Y − c)] = p(1 − p)·Δ. So a gambler bets on x_i(δ) = (A − p)(Y − c − δ(A − 1 + p)), whose mean is 0 where the
gain Δ is δ [WaudbySmithRamdas2024]_: wealth of 1/α against all gains up to δ is seen with chance α at most, at
whatever time one looks. Only what was dealt by chance counts, so a drift of the cell, which both arms see, is no gain.

Nobody knows the range of x_i, so each is clipped to the largest seen before it. That, and estimates under cuts, make α
an aim and no proof; `benchmarks/against.py` counts how often it is missed. `halfseen.monitoring.outcomes` weighs whole
trajectories and asks for their range; here what a trajectory did before its cut counts.
"""

from typing import NamedTuple

import numpy as np

from halfseen.censoring import KaplanMeier
from halfseen.shapes import Bool, Float, Int

FEWEST_OF_EITHER = 2
"""Trajectories of either arm from which is learned before the first one counts."""
MORE = 1.25
"""What counts is learned again once there are so many times as many."""
SMALLEST_SURVIVAL = 0.5
"""Chance of not being cut, below which weights do not grow further, and v is relied on."""
FEWEST_OF_ARM = 10
"""Of an arm, before it has a v and a Ĝ of its own."""
RIDGE = 1.0
"""Of the value of what is left [stages]."""
BETS = np.array([0.02, 0.15, 0.5, 0.95])
"""Shares of the stake that are put against the largest loss seen so far."""
STAKES = np.array([1.0, 1.0, 2.0, 2.0]) / 6.0
"""What is put on each of them: large gains are to be seen soon."""
NUM_HALVINGS, FARTHEST = 17, 64.0
"""Of the range in which a bound is sought; and how far it reaches, in the largest excess."""


class Courses(NamedTuple):
    """n trajectories that were dealt, in their order, and the m stages that they began."""

    is_policy: Bool[np.ndarray, " n"]
    """Of which arm."""
    chance: Float[np.ndarray, " n"]
    """With which it was dealt to the policy."""
    end_s: Float[np.ndarray, " n"]
    is_finished: Bool[np.ndarray, " n"]
    trajectory: Int[np.ndarray, " m"]
    """Number of each stage's trajectory, from 0, in order."""
    state: Float[np.ndarray, "m F"]
    reward: Float[np.ndarray, " m"]
    """NaN where not completed."""
    clock_s: Float[np.ndarray, " m"]
    """When the stage was completed [s]; NaN where not."""

    @property
    def num(self) -> int:
        """Number of trajectories."""
        return len(self.chance)

    def part(self, begin: int, end: int) -> "Courses":
        """Trajectories from `begin` to before `end`."""
        rows = slice(*np.searchsorted(self.trajectory, [begin, end]))
        parts = [each[begin:end] for each in self[:4]] + [each[rows] for each in self[4:]]
        return Courses(*parts)._replace(trajectory=self.trajectory[rows] - begin)

    def totals(self) -> Float[np.ndarray, " n"]:
        """What each earned while it was seen [reward]."""
        return np.bincount(self.trajectory, np.nan_to_num(self.reward), self.num)


class Counted(NamedTuple):
    """What each trajectory adds; none before there were enough to learn from."""

    chance: Float[np.ndarray, " n"]
    bet_on: Float[np.ndarray, " n"]
    """A − p."""
    excess: Float[np.ndarray, " n"]
    """Y − c [reward]."""
    share: Float[np.ndarray, " n"]
    """A − 1 + p, by which a gain raises it."""


class _Learned(NamedTuple):
    """Of the rule and of the policy: v as coefficients, and Ĝ; and what features are scaled by."""

    coefficients: Float[np.ndarray, "2 G"]
    survivals: list[KaplanMeier | None]
    centre: Float[np.ndarray, " G1"]
    spread: Float[np.ndarray, " G1"]
    range: tuple[float, float]


NOTHING = Counted(*np.zeros((4, 0)))


def counted(courses: Courses, known: Counted = NOTHING) -> Counted:
    """Weigh trajectories, each by those before it alone: the more there are, what the first ones add stays the same.

    Parameters
    ----------
    courses
        All of them.
    known
        What was found of the first of them, which is not worked out again.
    """
    arm = np.cumsum(courses.is_policy)
    enough = np.flatnonzero(np.minimum(arm, np.arange(1, courses.num + 1) - arm) >= FEWEST_OF_EITHER)
    begin = int(enough[0]) + 1 if len(enough) else courses.num
    done, parts = begin + len(known.excess), [known]
    while begin < courses.num:
        end = min(courses.num, max(begin + 1, int(MORE * begin)))
        if end > done:
            parts.append(_added(_learned(courses.part(0, begin)), courses.part(max(begin, done), end)))
        begin = end
    return Counted(*(np.concatenate(each) for each in zip(*parts, strict=True)))


def _columns(courses: Courses) -> Float[np.ndarray, "m G1"]:
    """The stage and the covariates."""
    first = np.searchsorted(courses.trajectory, np.arange(courses.num))
    return np.column_stack([np.arange(len(courses.trajectory)) - first[courses.trajectory], courses.state])


def _learned(past: Courses) -> _Learned:
    columns, totals = _columns(past), past.totals()
    spread = columns.std(axis=0)
    centre, spread = columns.mean(axis=0), np.where(spread > 0, spread, 1.0)
    survivals = [_survival(past, arm) for arm in (False, True)]
    features = np.column_stack([np.ones(len(columns)), (columns - centre) / spread])
    after = np.where(_goes_on(past)[:, None], np.roll(features, -1, axis=0), 0.0)
    weight = _weights(past, survivals)
    of_arm = [_of_arm(past, arm)[past.trajectory] for arm in (False, True)]
    each = [_value(features, after, past.reward, weight * rows) for rows in of_arm]
    return _Learned(np.stack(each), survivals, centre, spread, (totals.min(), totals.max()))


def _of_arm(past: Courses, arm: bool) -> Bool[np.ndarray, " n"]:
    """Which trajectories an arm is learned from: of both where it has few."""
    of = past.is_policy == arm
    return of if of.sum() >= FEWEST_OF_ARM else np.ones(past.num, dtype=bool)


def _survival(past: Courses, arm: bool) -> KaplanMeier | None:
    of = _of_arm(past, arm)
    return None if past.is_finished[of].all() else KaplanMeier().fit(past.end_s[of], past.is_finished[of])


def _weights(courses: Courses, survivals: list[KaplanMeier | None]) -> Float[np.ndarray, " m"]:
    """δ/Ĝ(U⁻) of each stage; Ĝ is 1 where nobody was cut."""
    is_done = ~np.isnan(courses.clock_s)
    weight = is_done.astype(np.float64)
    for arm, survival in enumerate(survivals):
        if survival is not None:
            rows = is_done & (courses.is_policy[courses.trajectory] == bool(arm))
            weight[rows] = 1.0 / np.maximum(survival.survival(courses.clock_s[rows]), SMALLEST_SURVIVAL)
    return weight


def _goes_on(courses: Courses) -> Bool[np.ndarray, " m"]:
    """Whether another stage of its trajectory comes after each."""
    return np.append(courses.trajectory[1:] == courses.trajectory[:-1], False)


def _value(
    features: Float[np.ndarray, "m G"],
    after: Float[np.ndarray, "m G"],
    reward: Float[np.ndarray, " m"],
    weight: Float[np.ndarray, " m"],
) -> Float[np.ndarray, " G"]:
    """θ with θᵀφ(S_t) = E[R_t + θᵀφ(S_{t+1})], by weighted least-squares temporal differences."""
    ridge = RIDGE * np.eye(features.shape[1])
    ridge[0, 0] = 1e-6
    weighted = features * weight[:, None]
    return np.linalg.solve(weighted.T @ (features - after) + ridge, weighted.T @ np.nan_to_num(reward))


def _added(learned: _Learned, new: Courses) -> Counted:
    first = np.searchsorted(new.trajectory, np.arange(new.num))
    columns = (_columns(new) - learned.centre) / learned.spread
    features = np.column_stack([np.ones(len(columns)), columns])
    values = np.clip(learned.coefficients @ features.T, *learned.range)
    arm, goes_on = new.is_policy[new.trajectory], _goes_on(new)
    own = np.where(arm, values[1], values[0])
    after = np.where(goes_on, np.roll(own, -1), 0.0)
    news = _weights(new, learned.survivals) * (np.nan_to_num(new.reward) + after - own)
    worth = own[first] + np.bincount(new.trajectory, news, new.num)
    p, a = new.chance, new.is_policy.astype(np.float64)
    return Counted(p, a - p, worth - (1.0 - p) * values[1][first] - p * values[0][first], a - 1.0 + p)


def log_wealth(of: Counted, gain: float, side: int = 1) -> Float[np.ndarray, " n"]:
    """Logarithm of the wealth after each trajectory of who bets that the policy gains more than this.

    Parameters
    ----------
    of
        What each trajectory adds.
    gain
        The gain [reward].
    side
        1, or −1 for who bets that it gains less.
    """
    beside = of.excess - gain * of.share
    # The first says what is large alone; what is larger than ever is lowered, whichever arm it is of.
    largest = np.maximum.accumulate(np.abs(beside))[:-1]
    lowered = np.clip(beside[1:], -largest, largest) / np.where(largest > 0.0, largest, 1.0)
    outcome = side * of.bet_on[1:] * lowered / np.maximum(of.chance, 1.0 - of.chance)[1:]
    wealth = np.cumsum(np.log1p(BETS[:, None] * outcome), axis=1)
    top = wealth.max(axis=0) if wealth.size else np.zeros(0)
    return np.append(np.zeros(min(len(beside), 1)), top + np.log(STAKES @ np.exp(wealth - top)))


def beats_at(of: Counted, gain: float, alpha: float, side: int = 1) -> int | None:
    """Number of counted trajectories after which it is seen that the policy gains more (or less); None if never."""
    above = np.flatnonzero(log_wealth(of, gain, side) >= -np.log(alpha))
    return int(above[0]) + 1 if len(above) else None


def bound(of: Counted, alpha: float, side: int = 1) -> float:
    """Bound the gain from below, or with side −1 from above [reward]; it is passed, ever, with chance `alpha` at most.

    ∓∞ where nothing is seen yet.
    """
    if not len(of.excess):
        return -side * np.inf
    far = FARTHEST * float(np.abs(of.excess).max()) + 1e-12
    out, within = -side * far, side * far
    if beats_at(of, out, alpha, side) is None:
        return -side * np.inf
    for _ in range(NUM_HALVINGS):
        middle = 0.5 * (out + within)
        out, within = (out, middle) if beats_at(of, middle, alpha, side) is None else (middle, within)
    return out
