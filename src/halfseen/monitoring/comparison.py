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


class _Wealth(NamedTuple):
    """Of who bets on one gain and side."""

    num: int
    """Trajectories that were bet on."""
    largest: float
    """Of what they brought beside that gain, either way [reward]."""
    of_bets: Float[np.ndarray, " 4"]
    """Logarithm of the wealth of each of `BETS` now."""
    best: float
    """Largest logarithm of the wealth of all so far."""


class Kept:
    """What a comparison that goes on need not work out again; nothing that comes out depends on it."""

    def __init__(self) -> None:
        self.learned: dict[int, _Learned] = {}
        self._wealth: dict[tuple[float, int], _Wealth] = {}
        self._before = self._wealth

    def begin(self) -> None:
        """Ask for bounds again: from now on, wealth that nobody asked for since the last time is forgotten."""
        self._before, self._wealth = self._wealth, {}

    def best(self, of: Counted, gain: float, side: int) -> float:
        """Largest logarithm of the wealth so far, as `log_wealth` has it; `of` has grown, if it changed."""
        asked = gain, side
        known = self._wealth.get(asked) or self._before.get(asked) or _begun(of, gain)
        if known.num < len(of.excess):
            known = _gone_on(of, gain, side, known)[1]
        self._wealth[asked] = known
        return known.best


NOTHING = Counted(*np.zeros((4, 0)))


def counted(courses: Courses, known: Counted = NOTHING, kept: Kept | None = None) -> Counted:
    """Weigh trajectories, each by those before it alone: the more there are, what the first ones add stays the same.

    Parameters
    ----------
    courses
        All of them.
    known
        What was found of the first of them, which is not worked out again.
    kept
        What was learned from them.
    """
    kept = Kept() if kept is None else kept
    arm = np.cumsum(courses.is_policy)
    enough = np.flatnonzero(np.minimum(arm, np.arange(1, courses.num + 1) - arm) >= FEWEST_OF_EITHER)
    begin = int(enough[0]) + 1 if len(enough) else courses.num
    done, parts = begin + len(known.excess), [known]
    while begin < courses.num:
        end = min(courses.num, max(begin + 1, int(MORE * begin)))
        if end > done:
            if begin not in kept.learned:
                kept.learned = {begin: _learned(courses.part(0, begin))}
            parts.append(_added(kept.learned[begin], courses.part(max(begin, done), end)))
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
    # A sum of its own for each row: with others beside it, a product of matrices differs in the last bit.
    values = np.clip((learned.coefficients[:, None] * features).sum(axis=2), *learned.range)
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
    return np.append(np.zeros(min(len(of.excess), 1)), _gone_on(of, gain, side, _begun(of, gain))[0])


def _begun(of: Counted, gain: float) -> _Wealth:
    """The first trajectory says what is large alone."""
    first = np.abs(of.excess[:1] - gain * of.share[:1])
    return _Wealth(len(first), float(first.sum()), np.zeros(len(BETS)), 0.0)


def _gone_on(of: Counted, gain: float, side: int, known: _Wealth) -> tuple[Float[np.ndarray, " k"], _Wealth]:
    """Logarithm of the wealth after each of the k trajectories that come after those that were bet on."""
    beside = of.excess[known.num :] - gain * of.share[known.num :]
    # What is larger than ever is lowered, whichever arm it is of.
    largest = np.maximum.accumulate(np.append(known.largest, np.abs(beside)))
    lowered = np.clip(beside, -largest[:-1], largest[:-1]) / np.where(largest[:-1] > 0.0, largest[:-1], 1.0)
    chance = of.chance[known.num :]
    outcome = side * of.bet_on[known.num :] * lowered / np.maximum(chance, 1.0 - chance)
    wealth = np.column_stack([known.of_bets, np.log1p(BETS[:, None] * outcome)]).cumsum(axis=1)
    top = wealth[:, 1:].max(axis=0)
    after = top + np.log((STAKES[:, None] * np.exp(wealth[:, 1:] - top)).sum(axis=0))
    best = max(known.best, float(after.max(initial=-np.inf)))
    return after, _Wealth(len(of.excess), float(largest[-1]), wealth[:, -1], best)


def beats_at(of: Counted, gain: float, alpha: float, side: int = 1) -> int | None:
    """Number of counted trajectories after which it is seen that the policy gains more (or less); None if never."""
    above = np.flatnonzero(log_wealth(of, gain, side) >= -np.log(alpha))
    return int(above[0]) + 1 if len(above) else None


def bound(of: Counted, alpha: float, side: int = 1, kept: Kept | None = None) -> float:
    """Bound the gain from below, or with side −1 from above [reward]; it is passed, ever, with chance `alpha` at most.

    ∓∞ where nothing is seen yet.
    """
    if not len(of.excess):
        return -side * np.inf
    kept, need = Kept() if kept is None else kept, -np.log(alpha)
    far = FARTHEST * float(np.abs(of.excess).max()) + 1e-12
    out, within = -side * far, side * far
    if kept.best(of, out, side) < need:
        return -side * np.inf
    for _ in range(NUM_HALVINGS):
        middle = 0.5 * (out + within)
        out, within = (out, middle) if kept.best(of, middle, side) < need else (middle, within)
    return out
