"""A randomised comparison of a policy with the rule of today: each trajectory is dealt to one of the two arms.

Trajectory i goes to the policy (A = 1) with probability p. Its outcome Y is its total reward. Under cuts, Y is the
doubly robust pseudo-outcome Y = v(S₁) + Σ_t δ_t/Ĝ(U_t⁻)·(R_t + v(S_{t+1}) − v(S_t)), with v the value function of both
arms together (least-squares temporal differences) and Ĝ the Kaplan–Meier estimate of its arm. It is unbiased if either
is correct, and equals the total reward without cuts. The same v for both arms keeps its error from being mistaken for a
gain where Ĝ is small. With the values v¹ and v⁰ of policy and rule, and c = (1 − p) v¹(S₁) + p v⁰(S₁),
E[(A − p)(Y − c)] = p(1 − p)·Δ. So a gambler bets on x_i(δ) = (A − p)(Y − c − δ(A − 1 + p)), whose mean is 0 if the
gain Δ is δ [WaudbySmithRamdas2024]_. Its wealth against all gains up to δ ever reaches 1/α with probability at most α.
All estimates are from earlier trajectories. Only randomly dealt trajectories count, so a drift of the cell, which
affects both arms, is not mistaken for a gain.

Where Ĝ is small, weights stop growing, and nobody was seen beyond the last cut: of arm a, a share ℓ_a of the weights is
lost. Its trajectories may have earned the most that any did, or the least, so the gain may seem too high by
D = ℓ₀ (high − v) + ℓ₁ (v − low), as where cuts hide the slow successes of the rule. The gambler bets on x_i(δ + D).

The range of x_i is unknown, so each is clipped to the largest absolute value before it. Clipping and the estimates
under cuts make α a target, not a guarantee; `benchmarks/against.py` counts how often it is missed.
`halfseen.monitoring.outcomes` weights whole trajectories and needs their range; here the stages before a cut count too.
"""

from typing import NamedTuple

import numpy as np

from halfseen.censoring import KaplanMeier
from halfseen.learning.behaviour import mean_and_scale
from halfseen.shapes import Bool, Float, Int

FEWEST_OF_EITHER = 2
"""Fewest finished trajectories of each arm to learn from before the first one counts."""
MORE = 1.25
"""Factor by which the number of trajectories grows between two fits of v and Ĝ."""
SMALLEST_SURVIVAL, NARROWS = 0.5, 2.0
"""Survival probability below which weights stop growing, so that v takes over: the first, or the second over √n where
that is less, for n trajectories to learn from. So an error of v matters less as evidence accumulates."""
FEWEST_OF_ARM = 10
"""Fewest trajectories of an arm that gets its own values and Ĝ."""
CAUTION = 0.25
"""Bets on a gain shrink as D grows, to nothing where it is this share of the range of totals."""
RIDGE = 1.0
"""Ridge penalty of v [stages]."""
BETS = np.array([0.02, 0.15, 0.5, 0.95])
"""Shares of the stake that are bet against the largest loss so far."""
STAKES = np.array([1.0, 1.0, 2.0, 2.0]) / 6.0
"""Initial wealth of each bet; more on large bets, which detect large gains early."""
NUM_HALVINGS, FARTHEST = 17, 64.0
"""Bisection steps for a bound; and the end of its search range, in multiples of the largest excess."""
NOISE = 1e-12
"""Size of a bound that is 0 but for rounding [reward]."""


class Courses(NamedTuple):
    """n dealt trajectories in order, and the m stages that they began."""

    is_policy: Bool[np.ndarray, " n"]
    """Whether it was dealt to the policy."""
    chance: Float[np.ndarray, " n"]
    """Probability with which it was dealt to the policy."""
    end_s: Float[np.ndarray, " n"]
    is_finished: Bool[np.ndarray, " n"]
    trajectory: Int[np.ndarray, " m"]
    """Index of each stage's trajectory, from 0, in order."""
    state: Float[np.ndarray, "m F"]
    reward: Float[np.ndarray, " m"]
    """NaN if the stage was not completed."""
    clock_s: Float[np.ndarray, " m"]
    """Time of completion of the stage [s]; NaN if it was not completed."""

    @property
    def num(self) -> int:
        """Number of trajectories."""
        return len(self.chance)

    def part(self, begin: int, end: int) -> "Courses":
        """Trajectories from `begin` up to, but not including, `end`."""
        rows = slice(*np.searchsorted(self.trajectory, [begin, end]))
        parts = [each[begin:end] for each in self[:4]] + [each[rows] for each in self[4:]]
        return Courses(*parts)._replace(trajectory=self.trajectory[rows] - begin)

    def totals(self) -> Float[np.ndarray, " n"]:
        """Observed total of each trajectory [reward]."""
        return np.bincount(self.trajectory, np.nan_to_num(self.reward), self.num)


class CountedTrajectories(NamedTuple):
    """Contribution of each trajectory; none before there were enough to learn from."""

    chance: Float[np.ndarray, " n"]
    bet_on: Float[np.ndarray, " n"]
    """A − p."""
    excess: Float[np.ndarray, " n"]
    """Y − c [reward]."""
    share: Float[np.ndarray, " n"]
    """A − 1 + p, the coefficient of the gain in the excess."""
    too_high: Float[np.ndarray, " n"]
    """D: by how much cuts may make the gain seem too high [reward]."""
    too_low: Float[np.ndarray, " n"]
    """The same, too low."""
    range: Float[np.ndarray, " n"]
    """Of the totals before [reward]."""


class _Learned(NamedTuple):
    """v⁰, v¹ and v as coefficients, Ĝ of the rule and of the policy, and the scaling of the features."""

    coefficients: Float[np.ndarray, "3 G"]
    survivals: list[KaplanMeier | None]
    centre: Float[np.ndarray, " G1"]
    spread: Float[np.ndarray, " G1"]
    range: tuple[float, float]
    smallest: float
    """Smallest Ĝ of a weight."""
    hidden: Float[np.ndarray, " 2"]
    """By how much cuts may make the gain seem too high, and too low [reward]."""


class _Wealth(NamedTuple):
    """Wealth of a gambler against one gain, on one side."""

    num: int
    """Number of trajectories that were bet on."""
    largest: float
    """Largest absolute excess over that gain [reward]."""
    of_bets: Float[np.ndarray, " 4"]
    """Current logarithm of the wealth of each of `BETS`."""
    best: float
    """Largest logarithm of the total wealth so far."""


class ComparisonCache:
    """Cache of a running comparison; no result depends on it."""

    def __init__(self) -> None:
        self.learned: dict[int, _Learned] = {}
        self._wealth: dict[tuple[float, int], _Wealth] = {}
        self._before = self._wealth

    def begin(self) -> None:
        """Start a new round of bounds; drop wealth that was not used since the last call."""
        self._before, self._wealth = self._wealth, {}

    def best(self, of: CountedTrajectories, gain: float, side: int) -> float:
        """Largest logarithm of the wealth so far, as in `log_wealth`; `of` may only grow between calls."""
        asked = gain, side
        known = self._wealth.get(asked) or self._before.get(asked) or _begun(of, gain, side)
        if known.num < len(of.excess):
            known = _gone_on(of, gain, side, known)[1]
        self._wealth[asked] = known
        return known.best


NOTHING = CountedTrajectories(*np.zeros((7, 0)))


def counted(
    courses: Courses, known: CountedTrajectories = NOTHING, kept: ComparisonCache | None = None
) -> CountedTrajectories:
    """Compute the contribution of each trajectory from earlier ones only; later trajectories do not change it.

    Parameters
    ----------
    courses
        All trajectories.
    known
        Contributions of the first trajectories, which are not computed again.
    kept
        Cache of the fits.
    """
    kept = ComparisonCache() if kept is None else kept
    finished = [np.cumsum(courses.is_finished & (courses.is_policy == arm)) for arm in (False, True)]
    enough = np.flatnonzero(np.minimum(*finished) >= FEWEST_OF_EITHER)
    begin = int(enough[0]) + 1 if len(enough) else courses.num
    done, parts = begin + len(known.excess), [known]
    while begin < courses.num:
        end = min(courses.num, max(begin + 1, int(MORE * begin)))
        if end > done:
            if begin not in kept.learned:
                kept.learned = {begin: _learned(courses.part(0, begin))}
            parts.append(_added(kept.learned[begin], courses.part(max(begin, done), end)))
        begin = end
    return CountedTrajectories(*(np.concatenate(each) for each in zip(*parts, strict=True)))


def _columns(courses: Courses) -> Float[np.ndarray, "m G1"]:
    """The stage and the covariates."""
    first = np.searchsorted(courses.trajectory, np.arange(courses.num))
    return np.column_stack([np.arange(len(courses.trajectory)) - first[courses.trajectory], courses.state])


def _learned(past: Courses) -> _Learned:
    columns, totals = _columns(past), past.totals()
    centre, spread = mean_and_scale(columns)
    survivals = [_survival(past, arm) for arm in (False, True)]
    features = np.column_stack([np.ones(len(columns)), (columns - centre) / spread])
    after = np.where(_goes_on(past)[:, None], np.roll(features, -1, axis=0), 0.0)
    smallest = min(SMALLEST_SURVIVAL, NARROWS / np.sqrt(past.num))
    weight = _weights(past, survivals, smallest)
    of_arm = [_of_arm(past, arm)[past.trajectory] for arm in (False, True)]
    each = [_value(features, after, past.reward, weight * rows) for rows in (*of_arm, 1.0)]
    learned = _Learned(np.stack(each), survivals, centre, spread, (totals.min(), totals.max()), smallest, np.zeros(2))
    return learned._replace(hidden=_hidden(past, learned))


def _hidden(past: Courses, learned: _Learned) -> Float[np.ndarray, " 2"]:
    """D on either side, of trajectories for which weights do not make up [reward]."""
    lost = []
    for arm, survival in zip((False, True), learned.survivals, strict=True):
        of = _of_arm(past, arm)
        weight = 1.0 if survival is None else _weight_at(past.end_s[of], survival, learned.smallest)
        lost.append(max(0.0, 1.0 - float((past.is_finished[of] * weight).mean())))
    worth = _values(past, learned)[2, np.searchsorted(past.trajectory, np.arange(past.num))].mean()
    low, high = learned.range
    return np.array([lost, lost[::-1]]) @ [high - worth, worth - low]


def _of_arm(past: Courses, arm: bool) -> Bool[np.ndarray, " n"]:
    """Trajectories that an arm is learned from: those of both arms if it has few."""
    of = past.is_policy == arm
    return of if of.sum() >= FEWEST_OF_ARM else np.ones(past.num, dtype=bool)


def _survival(past: Courses, arm: bool) -> KaplanMeier | None:
    of = _of_arm(past, arm)
    return None if past.is_finished[of].all() else KaplanMeier().fit(past.end_s[of], past.is_finished[of])


def _weights(courses: Courses, survivals: list[KaplanMeier | None], smallest: float) -> Float[np.ndarray, " m"]:
    """δ/Ĝ(U⁻) of each stage; Ĝ is 1 without cuts."""
    is_done = ~np.isnan(courses.clock_s)
    weight = is_done.astype(np.float64)
    for arm, survival in enumerate(survivals):
        if survival is not None:
            rows = is_done & (courses.is_policy[courses.trajectory] == bool(arm))
            weight[rows] = _weight_at(courses.clock_s[rows], survival, smallest)
    return weight


def _weight_at(time_s: Float[np.ndarray, " k"], survival: KaplanMeier, smallest: float) -> Float[np.ndarray, " k"]:
    return 1.0 / np.maximum(survival.survival(time_s), smallest)


def _goes_on(courses: Courses) -> Bool[np.ndarray, " m"]:
    """Whether each stage has a successor in its trajectory."""
    return np.append(courses.trajectory[1:] == courses.trajectory[:-1], False)


def _value(
    features: Float[np.ndarray, "m G"],
    after: Float[np.ndarray, "m G"],
    reward: Float[np.ndarray, " m"],
    weight: Float[np.ndarray, " m"],
) -> Float[np.ndarray, " G"]:
    """θ that solves θᵀφ(S_t) = E[R_t + θᵀφ(S_{t+1})], by weighted least-squares temporal differences."""
    ridge = RIDGE * np.eye(features.shape[1])
    ridge[0, 0] = 1e-6
    weighted = features * weight[:, None]
    return np.linalg.solve(weighted.T @ (features - after) + ridge, weighted.T @ np.nan_to_num(reward))


def _added(learned: _Learned, new: Courses) -> CountedTrajectories:
    first = np.searchsorted(new.trajectory, np.arange(new.num))
    of_rule, of_policy, value = _values(new, learned)
    after = np.where(_goes_on(new), np.roll(value, -1), 0.0)
    news = _weights(new, learned.survivals, learned.smallest) * (np.nan_to_num(new.reward) + after - value)
    worth = value[first] + np.bincount(new.trajectory, news, new.num)
    p, a = new.chance, new.is_policy.astype(np.float64)
    excess = worth - (1.0 - p) * of_policy[first] - p * of_rule[first]
    same = (np.full(new.num, each) for each in (*learned.hidden, np.ptp(learned.range)))
    return CountedTrajectories(p, a - p, excess, a - 1.0 + p, *same)


def _values(courses: Courses, learned: _Learned) -> Float[np.ndarray, "3 m"]:
    """v⁰, v¹ and v of each stage."""
    columns = (_columns(courses) - learned.centre) / learned.spread
    features = np.column_stack([np.ones(len(columns)), columns])
    # Sum each row separately: the last bit of a matrix product depends on the other rows.
    return np.clip((learned.coefficients[:, None] * features).sum(axis=2), *learned.range)


def log_wealth(of: CountedTrajectories, gain: float, side: int = 1) -> Float[np.ndarray, " n"]:
    """Logarithm of the wealth after each trajectory of a gambler who bets that the policy gains more than `gain`.

    Parameters
    ----------
    of
        Contribution of each trajectory.
    gain
        The gain [reward].
    side
        1, or −1 for a bet that it gains less.
    """
    return np.append(np.zeros(min(len(of.excess), 1)), _gone_on(of, gain, side, _begun(of, gain, side))[0])


def _against(
    of: CountedTrajectories, gain: float, side: int, begin: int
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """Excess over a gain and over what cuts may hide of it [reward], and the share of each bet that is placed."""
    hidden = (of.too_high if side > 0 else of.too_low)[begin:]
    beside = of.excess[begin:] - (gain + side * hidden) * of.share[begin:]
    far = np.maximum(CAUTION * of.range[begin:] + max(0.0, -side * gain), NOISE)
    return beside, np.maximum(0.0, 1.0 - hidden / far)


def _begun(of: CountedTrajectories, gain: float, side: int) -> _Wealth:
    """Initial wealth; the first trajectory is not bet on and only sets the scale."""
    first = np.abs(_against(of, gain, side, 0)[0][:1])
    return _Wealth(len(first), float(first.sum()), np.zeros(len(BETS)), 0.0)


def _gone_on(
    of: CountedTrajectories, gain: float, side: int, known: _Wealth
) -> tuple[Float[np.ndarray, " k"], _Wealth]:
    """Logarithm of the wealth after each of the k trajectories that were not bet on yet."""
    beside, placed = _against(of, gain, side, known.num)
    # Clip to the largest absolute value so far, in either arm.
    largest = np.maximum.accumulate(np.append(known.largest, np.abs(beside)))
    lowered = np.clip(beside, -largest[:-1], largest[:-1]) / np.where(largest[:-1] > 0.0, largest[:-1], 1.0)
    chance = of.chance[known.num :]
    outcome = side * placed * of.bet_on[known.num :] * lowered / np.maximum(chance, 1.0 - chance)
    wealth = np.column_stack([known.of_bets, np.log1p(BETS[:, None] * outcome)]).cumsum(axis=1)
    top = wealth[:, 1:].max(axis=0)
    after = top + np.log((STAKES[:, None] * np.exp(wealth[:, 1:] - top)).sum(axis=0))
    best = max(known.best, float(after.max(initial=-np.inf)))
    return after, _Wealth(len(of.excess), float(largest[-1]), wealth[:, -1], best)


def beats_at(of: CountedTrajectories, gain: float, alpha: float, side: int = 1) -> int | None:
    """Number of counted trajectories after which the policy is shown to gain more (or less); None if never."""
    above = np.flatnonzero(log_wealth(of, gain, side) >= -np.log(alpha))
    return int(above[0]) + 1 if len(above) else None


def bound(of: CountedTrajectories, alpha: float, side: int = 1, kept: ComparisonCache | None = None) -> float:
    """Lower bound of the gain, or upper bound with side −1 [reward]; ever wrong with probability at most `alpha`.

    ∓∞ while there is no evidence.
    """
    if not len(of.excess):
        return -side * np.inf
    kept, need = ComparisonCache() if kept is None else kept, -np.log(alpha)
    far = FARTHEST * float(np.abs(of.excess).max()) + NOISE
    out, within = -side * far, side * far
    if kept.best(of, out, side) < need:
        return -side * np.inf
    for _ in range(NUM_HALVINGS):
        middle = 0.5 * (out + within)
        out, within = (out, middle) if kept.best(of, middle, side) < need else (middle, within)
    return out
