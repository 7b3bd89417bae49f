"""Fits of a few parameters to many points: a trust region, reflected at bounds [BranchColemanLi1999]_.

A point's residual r counts as 2·(√(1 + r²) − 1): square where small, linear where large. Each step is, to the last bit,
that of ``scipy.optimize.least_squares`` with ``loss="soft_l1"``. What that checks and wraps at every call takes longer
than the sums of so few parameters do; and here fits from several starts ask for their residuals together.

Parameters are scaled by the root of their room, the distance to the bound that each moves towards (1 where there is
none). ``g`` is the slope of the cost, ``J`` how residuals change with scaled parameters, and ``U s Vᵀ`` the
decomposition of J above the curvature that bounds add.

Shapes are checked where places and bounds come in. What a step asks of them, thousands of times a cloud, is not checked
again, which takes longer than the step.
"""

from collections.abc import Generator, Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from typing import Protocol, TypeAlias, no_type_check, runtime_checkable

import numpy as np
from scipy.linalg import get_lapack_funcs

from halfseen.arrays import Rows
from halfseen.shapes import Float

# Relative changes of cost and parameters, and slope, below which a fit has settled.
TOLERANCE = 1e-8
# Residuals are asked for so many times at most.
MOST_EVALUATIONS = 30
# A damping is right if its step ends this near to the radius, relative to it; it is mended so many times at most.
DAMPING_TOLERANCE, MOST_DAMPINGS = 0.01, 10
# A step keeps to this share of the way to a bound, at least.
SMALLEST_SHARE = 0.995
EPS = float(np.finfo(np.float64).eps)
# As `scipy.linalg.svd` calls them, which checks more than it decomposes here.
_decomposed, _memory_needed = get_lapack_funcs(("gesdd", "gesdd_lwork"), dtype=np.float64)

Free: TypeAlias = Float[np.ndarray, " p"]
Frees: TypeAlias = Float[np.ndarray, "k p"]


@runtime_checkable
class Misses(Protocol):
    """What is fitted."""

    def at(self, p: Frees) -> tuple[Float[np.ndarray, "k rows"], Float[np.ndarray, "k p rows"]]:
        """Residuals of several sets of parameters, and how each parameter changes them, in memory of their own."""
        ...


@dataclass(frozen=True, eq=False)
class Place:
    """Where a fit is.

    Parameters
    ----------
    p, residuals
        Parameters, and what is left with them.
    cost
        Half the sum of the robust squares.
    weighed, slopes
        Residuals and how parameters change them, weighed so that squares have slope and curvature of the robust cost.
    """

    p: Free
    residuals: Rows
    cost: float
    weighed: Rows
    slopes: Float[np.ndarray, "p rows"]


@dataclass(frozen=True, eq=False)
class Bounds:
    """Smallest and largest value of each parameter; infinite where there is none."""

    low: Free
    high: Free

    @cached_property
    def bounded(self) -> list[int]:
        """Parameters that have bounds."""
        return np.flatnonzero(np.isfinite(self.low)).tolist()

    @no_type_check
    def hold(self, p: Free) -> bool:
        """Whether parameters are within."""
        return bool(((p >= self.low) & (p <= self.high)).all())

    def room(self, p: Free, g: Free) -> tuple[Free, Free]:
        """Distance to the bound that each parameter moves towards, 1 if there is none, and how that changes with it."""
        room, change = np.ones_like(p), np.zeros_like(p)
        for i in self.bounded:
            if g[i] < 0:
                room[i], change[i] = self.high[i] - p[i], -1.0
            elif g[i] > 0:
                room[i], change[i] = p[i] - self.low[i], 1.0
        return room, change

    def reach(self, p: Free, way: Free) -> tuple[float, Free]:
        """How far one can go a way, in multiples of it, and along which parameters (±1) a bound is met there."""
        far = np.full_like(p, np.inf)
        moves = way != 0
        with np.errstate(over="ignore"):
            far[moves] = np.maximum((self.low - p)[moves] / way[moves], (self.high - p)[moves] / way[moves])
        nearest = np.min(far)
        return nearest, (far == nearest) * np.sign(way)

    @no_type_check
    def inside(self, p: Free) -> Free:
        """Move what is on a bound, or beyond, just off it."""
        if ((p > self.low) & (p < self.high)).all():
            return p
        return np.clip(p, np.nextafter(self.low, self.high), np.nextafter(self.high, self.low))


def fitted(misses: Misses, starts: Sequence[Free], bounds: Bounds) -> list[Place]:
    """Fit parameters from several starts within the bounds, side by side.

    Parameters
    ----------
    misses
        What is fitted.
    starts, bounds
        Where the parameters begin, and what they are held to.
    """
    trajectories = [_trajectory(start, bounds) for start in starts]
    asked, found = {k: next(trajectory) for k, trajectory in enumerate(trajectories)}, {}
    while asked:
        for k, place in zip(list(asked), _places(misses, np.stack(list(asked.values()))), strict=True):
            try:
                asked[k] = trajectories[k].send(place)
            except StopIteration as end:
                found[k] = end.value
                del asked[k]
    return [found[k] for k in range(len(trajectories))]


def _places(misses: Misses, p: Frees) -> list[Place]:
    residuals, slopes = misses.at(p)
    squared = residuals**2
    spread = 1 + squared
    cost = 0.5 * np.add.reduce(2 * (np.sqrt(spread) - 1), axis=1)
    weight = spread**-0.5
    scale = np.sqrt(np.maximum(weight - spread**-1.5 * squared, EPS))
    slopes *= scale[:, None]
    return list(map(Place, p, residuals, cost, residuals * (weight / scale), slopes))


def _trajectory(start: Free, bounds: Bounds) -> Generator[Free, Place, Place]:
    """Ask for the place of parameters until they have settled."""
    here, num_asked = (yield start), 1
    model = _Model(here, bounds)
    radius, damping = _length(start / np.sqrt(model.room)) or 1.0, 0.0
    while model.steepest >= TOLERANCE and num_asked < MOST_EVALUATIONS:
        model.decompose()
        gain, is_settled = -1.0, False
        while gain <= 0 and num_asked < MOST_EVALUATIONS and not is_settled:
            scaled, damping = model.damped_step(radius, damping)
            step, scaled, hoped_gain = model.held_step(scaled, radius)
            there = yield bounds.inside(here.p + step)
            num_asked += 1
            gain = here.cost - there.cost
            new_radius, ratio = _next_radius(radius, gain, hoped_gain, _length(scaled))
            is_settled = bool(gain < TOLERANCE * here.cost and ratio > 0.25) or bool(
                _length(step) < TOLERANCE * (TOLERANCE + _length(here.p))
            )
            if not is_settled:
                damping *= radius / new_radius
                radius = new_radius
        if gain > 0:
            here = there
        if is_settled:
            break
        model = _Model(here, bounds)
    return here


@no_type_check
class _Model:
    """The cost near to a place, as a quadratic of scaled parameters."""

    def __init__(self, place: Place, bounds: Bounds) -> None:
        self.p, self.bounds, self.residuals, self.slopes = place.p, bounds, place.weighed, place.slopes
        self.g = self.slopes.dot(self.residuals)
        self.room, self.room_change = bounds.room(self.p, self.g)
        self.steepest = np.abs(self.g * self.room).max()

    def decompose(self) -> None:
        num_free, num_rows = self.slopes.shape
        self.scale = np.sqrt(self.room)
        self.curvature = self.g * self.room_change
        self.scaled_g = self.scale * self.g
        both = np.zeros((num_rows + num_free, num_free))
        self.J = np.multiply(self.slopes.T, self.scale, out=both[:num_rows])
        both[num_rows:] = np.diag(np.sqrt(self.curvature))
        u, self.s, v, _ = _decomposed(both, full_matrices=0, lwork=_memory(*both.shape))
        self.V = v.T
        self.Uf = u.T.dot(np.concatenate([self.residuals, np.zeros(num_free)]))
        self.share = max(SMALLEST_SHARE, 1 - self.steepest)

    def damped_step(self, radius: float, damping: float) -> tuple[Free, float]:
        """Scaled step to the minimum within the radius, and its damping [NocedalWright2006]_, section 4.3."""
        s, Uf = self.s, self.Uf
        is_full_rank = s[-1] > EPS * len(self.residuals) * s[0]
        if is_full_rank:
            step = -self.V.dot(Uf / s)
            if _length(step) <= radius:
                return step, 0.0
        sUf, square = s * Uf, s**2
        square_sUf = sUf**2

        def beyond(damping: float) -> tuple[float, float]:
            denominator = square + damping
            length = _length(sUf / denominator)
            return length - radius, -np.add.reduce(square_sUf / denominator**3) / length

        high, low = _length(sUf) / radius, 0.0
        if is_full_rank:
            over, slope = beyond(0.0)
            low = -over / slope
        elif damping == 0:
            damping = max(0.001 * high, (low * high) ** 0.5)
        for _ in range(MOST_DAMPINGS):
            if damping < low or damping > high:
                damping = max(0.001 * high, (low * high) ** 0.5)
            over, slope = beyond(damping)
            if over < 0:
                high = damping
            ratio = over / slope
            low = max(low, damping - ratio)
            damping -= (over + radius) * ratio / radius
            if abs(over) < DAMPING_TOLERANCE * radius:
                break
        step = -self.V.dot(sUf / (square + damping))
        step *= radius / _length(step)
        return step, damping

    def held_step(self, scaled: Free, radius: float) -> tuple[Free, Free, float]:
        """Step within the bounds, the same scaled, and what it is hoped to gain: the best of three."""
        step = self.scale * scaled
        if self.bounds.hold(self.p + step):
            return step, scaled, -self._change(scaled)
        to_bound, met = self.bounds.reach(self.p, step)
        mirrored = np.where(met != 0, -scaled, scaled)
        step, scaled = step * to_bound, scaled * to_bound
        tries = [self._reflected(step, scaled, mirrored, to_bound, radius)]
        scaled = scaled * self.share
        tries.insert(0, (self._change(scaled), step * self.share, scaled))
        tries.append(self._downhill(radius))
        change, step, scaled = min(reversed(tries), key=lambda each: each[0])
        return step, scaled, -change

    def _change(self, scaled: Free) -> float:
        """How a step changes the cost."""
        across = self.J.dot(scaled)
        return 0.5 * (across.dot(across) + (scaled * self.curvature).dot(scaled)) + scaled.dot(self.scaled_g)

    def _reflected(
        self, step: Free, scaled: Free, mirrored: Free, to_bound: float, radius: float
    ) -> tuple[float, Free, Free]:
        """Go on from the bound in the mirrored direction."""
        way = self.scale * mirrored
        to_edge = _to_edge(scaled, mirrored, radius)
        next_bound, _ = self.bounds.reach(self.p + step, way)
        far = min(next_bound, to_edge)
        if not far > 0:
            return np.inf, step, scaled
        near = (1 - self.share) * to_bound / far
        far = self.share * next_bound if far == next_bound else to_edge
        if not near <= far:
            return np.inf, step, scaled
        along, before = self.J.dot(mirrored), self.J.dot(scaled)
        a = 0.5 * (along.dot(along) + (mirrored * self.curvature).dot(mirrored))
        b = self.scaled_g.dot(mirrored) + before.dot(along) + (scaled * self.curvature).dot(mirrored)
        c = 0.5 * before.dot(before) + self.scaled_g.dot(scaled) + 0.5 * (scaled * self.curvature).dot(scaled)
        length, change = _lowest(a, b, c, near, far)
        scaled = mirrored * length + scaled
        return change, scaled * self.scale, scaled

    def _downhill(self, radius: float) -> tuple[float, Free, Free]:
        """Go straight down."""
        scaled = -self.scaled_g
        way = self.scale * scaled
        to_edge = radius / _length(scaled)
        to_bound, _ = self.bounds.reach(self.p, way)
        far = self.share * to_bound if to_bound < to_edge else to_edge
        along = self.J.dot(scaled)
        a = 0.5 * (along.dot(along) + (scaled * self.curvature).dot(scaled))
        length, change = _lowest(a, self.scaled_g.dot(scaled), 0.0, 0.0, far)
        return change, way * length, scaled * length


def soft_l1(residuals: Rows) -> Rows:
    """Robust square of residuals.

    Parameters
    ----------
    residuals
        In units of the noise.
    """
    return 2 * (np.sqrt(1 + residuals**2) - 1)


@no_type_check
def _next_radius(radius: float, gain: float, hoped_gain: float, length: float) -> tuple[float, float]:
    """Radius after a step, and which share of what was hoped for it gained."""
    ratio = gain / hoped_gain if hoped_gain > 0 else float(hoped_gain == gain == 0)
    if ratio < 0.25:
        return 0.25 * length, ratio
    return (2.0 * radius if ratio > 0.75 and length > 0.95 * radius else radius), ratio


@no_type_check
def _to_edge(start: Free, way: Free, radius: float) -> float:
    """How far a way leads to the edge of the trust region, in multiples of it."""
    a, b, c = way.dot(way), start.dot(way), start.dot(start) - radius**2
    q = -(b + np.copysign(np.sqrt(b * b - a * c), b))
    return max(q / a, c / q)


@no_type_check
def _lowest(a: float, b: float, c: float, near: float, far: float) -> tuple[float, float]:
    """Where ``a·t² + b·t + c`` is least between two places, and how low it is there."""
    places = [near, far]
    if a != 0 and near < -0.5 * b / a < far:
        places.append(-0.5 * b / a)
    values = [t * (a * t + b) + c for t in places]
    best = int(np.argmin(values))
    return places[best], values[best]


@no_type_check
def _length(vector: Free) -> float:
    return np.sqrt(vector.dot(vector))


@cache
def _memory(num_rows: int, num_columns: int) -> int:
    return int(_memory_needed(num_rows, num_columns, compute_uv=1, full_matrices=0)[0])
