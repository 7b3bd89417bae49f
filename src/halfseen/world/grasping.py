"""Laws of grasping, which draw the outcome of an attempt: the interface, and the default law of the world.

The world, its logs and its Gymnasium environment only sample from a law (`GraspLaw`). Planners' beliefs and the exact
optimum also need its probabilities (`KnownGrasping`). A law is a frozen record of numbers and handles batches of
tables. Further laws here: one with parameters fitted to attempts, and one that gives each robot its own law.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, Protocol, runtime_checkable

import numpy as np

from halfseen.arrays import Amounts, Array, Flags, Number, Which, at, chosen, library_of, record
from halfseen.errors import ArgumentError
from halfseen.shapes import Bool, Float, Int
from halfseen.world import random
from halfseen.world.random import Key


class Arrangement(NamedTuple):
    """Arrangement of the N objects of a table, padding included, when an attempt begins."""

    hides: Float[Array, "*B N N"]
    """Share of object i's silhouette that object j alone hides."""
    is_on_table: Bool[Array, "*B N"]
    """False in the dishwasher, and for padding."""
    occlusion: Float[Array, "*B N"]
    grip: Float[Array, "*B N"]
    """Mean of each object's grip offset, given what is observed of it; 0 if nothing distinguishes it."""


class Attempt(NamedTuple):
    """Outcome of one attempt."""

    is_held: Flags
    """Whether the object was grasped (for other verbs, such as pushing: whether the verb succeeded)."""
    duration_s: Amounts
    """Positive; without transport [s]."""
    hides: Float[Array, "*B N N"]
    """Which object hides which afterwards; objects may have moved."""
    latent: Any


@runtime_checkable
class GraspLaw(Protocol):
    """Law of the outcome of attempts, for a batch of tables.

    The latent variable of a law holds properties of the objects that are never observed (such as how well each can be
    gripped): a record or array with a batch axis, or None. The law draws it when the table is set, receives it at every
    attempt, and returns its new value.
    """

    @property
    def limit_s(self) -> Number:
        """Longest duration of an attempt, and the duration of one that closes on nothing [s]."""
        ...

    def draw_latent(self, num_objects: int, key: Key) -> Any:
        """Draw the latent variable of a table that is being set.

        Parameters
        ----------
        num_objects
            N, padding included.
        key
            One for each table: the only source of randomness.
        """
        ...

    def attempt(self, table: Arrangement, latent: Any, verb: Which, target: Which, key: Key) -> Attempt:
        """Attempt a verb on an object that stands on the table.

        Parameters
        ----------
        table
            Arrangement of the objects.
        latent
            The latent variable.
        verb
            As in `halfseen.world.actions.Verb`. For FINISH the result is ignored.
        target
            Number of the object.
        key
            The only source of randomness.
        """
        ...


@runtime_checkable
class KnownGrasping(GraspLaw, Protocol):
    """A `GraspLaw` whose probabilities are known, for planners.

    Its latent variable is a number u for each object, from N(0, offset_std²), that no attempt changes. The grip offset
    of an object is `Arrangement.grip` + u, of which only the mean is observed. Given the offset and the occlusion,
    attempts are independent and identical for all verbs. They move nothing. The methods take arrays that broadcast.
    """

    @property
    def offset_std(self) -> Number:
        """Standard deviation of u."""
        ...

    def log_failure(self, occluded: Any, offset: Any) -> Any:
        """Log probability that an attempt fails at a hidden share in [0, 1] and a grip offset."""
        ...

    def expected_s(self, occluded: Any, offset: Any) -> Any:
        """Expected duration of an attempt, held or not, without transport [s]."""
        ...


@record
class AssumedGrasping:
    """Time to grasp T = exp(a + b·occ − grip − u)·E with E ~ Exp(1) and a hidden u ~ N(0, σ²) for each object.

    `Arrangement.grip` is 0 unless the scene gives it. An attempt succeeds if T ≤ τ and takes min(T, τ); nothing else
    moves. The default parameters are this project's own choice.

    Parameters
    ----------
    offset_std
        σ, standard deviation of u.
    log_time, log_time_per_occlusion
        a and b [log s].
    limit_s
        τ [s].

    Raises
    ------
    ArgumentError
        A number is not finite, σ is negative, or τ is not positive.
    """

    offset_std: Number = 1.0
    log_time: Number = 0.6
    log_time_per_occlusion: Number = 2.2
    limit_s: Number = 6.0

    def __post_init__(self) -> None:
        _check_numbers(vars(self))

    def draw_latent(self, num_objects: int, key: Key) -> Float[Array, "*B N"]:
        """Draw u of each object."""
        return self.offset_std * random.normal(key, num_objects)

    def attempt(
        self, table: Arrangement, latent: Float[Array, "*B N"], verb: Which, target: Which, key: Key
    ) -> Attempt:
        """Draw the time to grasp, the same for all verbs."""
        offset = at(table.grip, target) + at(latent, target)
        grasp_s = random.exponential(key) * self.scale_s(at(table.occlusion, target), offset)
        is_held = grasp_s <= self.limit_s
        return Attempt(is_held, library_of(grasp_s).minimum(grasp_s, self.limit_s), table.hides, latent)

    def scale_s(self, occluded: Any, offset: Any) -> Any:
        """Mean time to grasp without a limit: exp(a + b·occ − offset) [s]."""
        exponent = self.log_time + self.log_time_per_occlusion * occluded - offset
        return library_of(exponent).exp(exponent)

    def log_failure(self, occluded: Any, offset: Any) -> Any:
        """Log P(T > τ | occ, offset) = −τ / scale."""
        # The scale factors into occlusion and offset, which saves an exponential for every pair of them.
        return -self.limit_s / self.scale_s(occluded, 0.0) * library_of(offset).exp(offset)

    def expected_s(self, occluded: Any, offset: Any) -> Any:
        """E min(T, τ) = scale·(1 − P(T > τ)) [s]."""
        log_failure = self.log_failure(occluded, offset)
        return -self.scale_s(occluded, offset) * library_of(log_failure).expm1(log_failure)


@record
class FittedGrasping:
    """An attempt succeeds with probability expit(a + b·occ + grip + u), with a hidden u ~ N(0, σ²) for each object.

    Its log duration is normal, with different means for success and failure, and capped at the limit. Nothing else
    moves. The parameters are fitted to attempts, so they have no defaults.

    Parameters
    ----------
    log_odds
        a, log-odds of success on an object in full view with grip offset 0.
    log_odds_per_occlusion
        b, added to them for an object that is wholly hidden.
    offset_std
        σ, standard deviation of u.
    log_held_s, log_missed_s
        Mean log duration of an attempt that succeeds, and of one that fails [log s].
    log_std
        Standard deviation of both, above 0.
    limit_s
        Longest duration of an attempt [s].
    """

    log_odds: Number
    log_odds_per_occlusion: Number
    offset_std: Number
    log_held_s: Number
    log_missed_s: Number
    log_std: Number
    limit_s: Number

    def __post_init__(self) -> None:
        _check_numbers(vars(self))

    def draw_latent(self, num_objects: int, key: Key) -> Float[Array, "*B N"]:
        """Draw u of each object."""
        return self.offset_std * random.normal(key, num_objects)

    def attempt(
        self, table: Arrangement, latent: Float[Array, "*B N"], verb: Which, target: Which, key: Key
    ) -> Attempt:
        """Draw success, then duration; the same for all verbs."""
        held_key, time_key = random.split(key)
        log_failure = self.log_failure(at(table.occlusion, target), at(table.grip, target) + at(latent, target))
        is_held, xp = random.log_uniform(held_key) >= log_failure, library_of(log_failure)
        noise = self.log_std * random.normal(time_key)
        log_s = noise + xp.where(is_held, self.log_held_s, self.log_missed_s).astype(noise.dtype)
        return Attempt(is_held, xp.minimum(xp.exp(log_s), self.limit_s), table.hides, latent)

    def log_failure(self, occluded: Any, offset: Any) -> Any:
        """Log P(an attempt fails | occ, offset) = −log(1 + exp(a + b·occ + offset))."""
        odds = self._odds(occluded, offset)
        return -library_of(odds).log1p(odds)

    def failure(self, occluded: Any, offset: Any) -> Any:
        """P(an attempt fails | occ, offset), which is cheaper to compute than its logarithm."""
        return np.float32(1.0) / (np.float32(1.0) + self._odds(occluded, offset))

    def _odds(self, occluded: Any, offset: Any) -> Any:
        log_odds = self.log_odds + self.log_odds_per_occlusion * occluded
        xp = library_of(log_odds, offset)
        # A product, which saves an exponential for every pair of occlusion and offset.
        return xp.exp(log_odds) * xp.exp(offset)

    def expected_s(self, occluded: Any, offset: Any) -> Any:
        """Mean duration over both outcomes, each lognormal and capped at the limit [s]."""
        log_failure = self.log_failure(occluded, offset)
        held_s, missed_s = (self._mean_s(log_s) for log_s in (self.log_held_s, self.log_missed_s))
        return held_s + library_of(log_failure).exp(log_failure) * (missed_s - held_s)

    def _mean_s(self, log_s: Number) -> Any:
        """E min(exp(log_s + log_std·Z), limit_s), with Z ~ N(0, 1) [s]."""
        xp = library_of(log_s, self.log_std, self.limit_s)
        limit = (xp.log(self.limit_s) - log_s) / self.log_std
        within_s = xp.exp(log_s + self.log_std**2 / 2.0) * _below(limit - self.log_std)
        mean_s = within_s + self.limit_s * _below(-limit)
        # A NumPy float64 scalar would promote float32 arrays to float64.
        return float(mean_s) if xp is np else mean_s


def _check_numbers(numbers: Mapping[str, Any]) -> None:
    """Refuse numbers that make no law; under a JAX transformation, one may be a tracer without a value."""
    for name, value in numbers.items():
        least = {"offset_std": 0.0, "log_std": 1e-6, "limit_s": 1e-6}.get(name, -math.inf)
        if isinstance(value, (int, float)) and not least <= value < math.inf:
            from_on = f", {least:g} or more" if least >= 0.0 else ""
            raise ArgumentError(f"{name} of the law is {value}; give a finite number{from_on}")


def _below(limit: Any) -> Any:
    """P(Z < limit), Z ~ N(0, 1)."""
    if library_of(limit) is np:
        return math.erfc(-limit / math.sqrt(2.0)) / 2.0
    from jax.scipy.special import ndtr

    return ndtr(limit)


@record
class GraspingByRobot:
    """Each attempt follows the law of the robot that makes it (a `GraspLaw`; a `KnownGrasping` if all its laws are).

    The latent variable is a tuple with that of each law, all drawn from one key: an object that is hard to grip is so
    for all robots. Planners assume that u / offset_std of an object is the same for all robots. That holds if the laws
    draw u in the same way, as `AssumedGrasping` and `FittedGrasping` do, and laws on a grid among themselves.

    Parameters
    ----------
    laws
        Law of each robot, robot 0 first; they may be of different kinds.
    robot
        Number of the robot that makes the attempt, or one per batch member; its axes lead in the law's arguments.

    Raises
    ------
    ArgumentError
        There is no law, or an entry is not the law of one robot.
    """

    laws: tuple[GraspLaw, ...]
    robot: int | Int[Array, "*R"] = 0

    def __post_init__(self) -> None:
        if not self.laws:
            raise ArgumentError("laws is (): give the law of grasping of each robot, for at least one")
        for k, law in enumerate(self.laws):
            check_law(law, f"laws[{k}]")

    @property
    def limit_s(self) -> Number:
        """Longest duration of an attempt of the robot [s]."""
        return self._of(lambda law: law.limit_s)

    @property
    def offset_std(self) -> Number:
        """Standard deviation of u under the law of the robot."""
        return self._of(lambda law: law.offset_std)

    def draw_latent(self, num_objects: int, key: Key) -> tuple[Any, ...]:
        """Draw the latent variable of each law, all from the same key."""
        return tuple(law.draw_latent(num_objects, key) for law in self.laws)

    def attempt(self, table: Arrangement, latent: tuple[Any, ...], verb: Which, target: Which, key: Key) -> Attempt:
        """Attempt by the robot's law; the latents of the other laws do not change."""
        each = [law.attempt(table, own, verb, target, key) for law, own in zip(self.laws, latent, strict=True)]
        latents = tuple(
            chosen(library_of(self.robot).asarray(self.robot == k), tried.latent, own)
            for k, (tried, own) in enumerate(zip(each, latent, strict=True))
        )
        return self._chosen([tried._replace(latent=None) for tried in each])._replace(latent=latents)

    def log_failure(self, occluded: Any, offset: Any) -> Any:
        """Log probability that an attempt of the robot fails."""
        return self._of(lambda law: law.log_failure(occluded, offset))

    def expected_s(self, occluded: Any, offset: Any) -> Any:
        """Expected duration of an attempt of the robot [s]."""
        return self._of(lambda law: law.expected_s(occluded, offset))

    def _of(self, ask: Callable[[Any], Any]) -> Any:
        """Evaluate `ask` on the law of the robot."""
        return self._chosen([ask(law) for law in self.laws])

    def _chosen(self, each: Sequence[Any]) -> Any:
        if isinstance(self.robot, int | np.integer):
            return each[int(self.robot)]
        found = each[0]
        for robot, other in enumerate(each[1:], start=1):
            found = chosen(self.robot == robot, other, found)
        return found


def check_law(law: object, where: str) -> None:
    """Raise an `ArgumentError` that names `where` unless `law` is the law of grasping of one robot."""
    if isinstance(law, type | GraspingByRobot) or not isinstance(law, GraspLaw):
        raise ArgumentError(
            f"{where} is {law!r}, not a law of grasping of one robot; give one, such as AssumedGrasping() or "
            "the grasping of a calibrated Law"
        )
