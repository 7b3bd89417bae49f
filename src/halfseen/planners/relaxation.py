"""An upper bound on the value of every policy, by information relaxation [BrownSmithSun2010]_.

A policy with more information can do no worse. There are three relaxations, each revealing more than the one before:

- ``"looks"`` reveals, before the first action, the grip offset of each object, and the labels of as many looks at it as
  the horizon allows, in full view. No policy sees more labels, nor better ones: the label of an occluded object is
  equivalent to one in full view that is randomly flipped. If errors persist, it reveals the labels of every possible
  view of an object, from the most hidden to the one in the hand: views are nested, so a subset of them has no more
  information;
- ``"hidden"`` reveals which objects are dirty instead;
- ``"everything"`` also reveals the duration of every grasp: the exponential draw of every step.

Labels then add no information, and a state is the set of objects on the table and the steps to go: 2^N sets, with
backward induction for many draws of the revealed information at once.
"""

from itertools import product
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from halfseen.errors import ArgumentError
from halfseen.planners.exact_labels import Labels, labels_of, spread_over_labels
from halfseen.planners.exact_table import GridWorld
from halfseen.shapes import Float
from halfseen.world.config import WorldConfig
from halfseen.world.grasping import AssumedGrasping, KnownGrasping
from halfseen.world.scene import Scene
from halfseen.world.seeing import is_independent

MAX_OBJECTS = 12
MAX_ENUMERATED = 20_000
"""Limit up to which the possible revealed information is enumerated, if grip offsets lie on a grid."""
_CELLS_AT_ONCE = 2_000_000
REVEALED = ("looks", "hidden", "everything")
"""Relaxations, from the least to the most information."""


class RelaxationBound(NamedTuple):
    """An upper bound on the expected reward of every policy."""

    value: float
    standard_error: float
    """Standard error of `value` over the draws; 0 if it was enumerated."""


def information_relaxation_bound(
    scene: Scene | ArrayLike,
    config: WorldConfig,
    horizon: int | None = None,
    num_samples: int = 10_000,
    seed: int = 0,
    num_grip_nodes: int | None = None,
    reveals: str = "looks",
) -> RelaxationBound:
    """Compute an upper bound on the expected reward of any policy on a table.

    Parameters
    ----------
    scene
        The table, or its ``hides``, shape (N, N).
    config
        The world.
    horizon
        Largest number of steps of a trajectory, by default the world's.
    num_samples
        Number of draws of the revealed information.
    seed
        Random seed of the draws.
    num_grip_nodes
        Number of Gauss–Hermite nodes of the grip offsets, as in `solve_table`; by default offsets are normal, as in the
        world. On a grid, up to `MAX_ENUMERATED` cases are enumerated instead of drawn, unless durations are revealed.
    reveals
        The relaxation, one of `REVEALED`; "looks" gives the tightest bound.

    Returns
    -------
    RelaxationBound
        The bound and its standard error.

    Raises
    ------
    ArgumentError
        A number is out of range, `reveals` is unknown or does not fit the world's laws, or there are more than
        `MAX_OBJECTS` objects.

    Examples
    --------
    >>> from halfseen.world import WorldConfig
    >>> bound = information_relaxation_bound([[0.0, 0.6], [0.1, 0.0]], WorldConfig(), horizon=3, num_grip_nodes=7)
    >>> round(bound.value, 3), bound.standard_error
    (2.732, 0.0)
    """
    table = scene if isinstance(scene, Scene) else Scene(np.asarray(scene, dtype=np.float64))
    steps, num_objects = config.horizon if horizon is None else horizon, table.num_objects
    if not 1 <= num_objects <= MAX_OBJECTS:
        raise ArgumentError(f"the scene has {num_objects} objects; the bound needs 1 to {MAX_OBJECTS}")
    for name, number, least in (("horizon", steps, 1), ("num_samples", num_samples, 2)):
        if number < least:
            raise ArgumentError(f"{name} is {number}; give at least {least}")
    if num_grip_nodes is not None and num_grip_nodes < 1:
        raise ArgumentError(f"num_grip_nodes is {num_grip_nodes}; give at least 1, or None for normal offsets")
    _check_revealed(config, reveals)
    world, rng = GridWorld(table, config, num_grip_nodes or 1), np.random.default_rng(seed)
    dirty, of_dirty = _possible_beliefs(world, steps, reveals)
    num_possible = (len(dirty) * (num_grip_nodes or np.inf)) ** num_objects
    is_exact = reveals != "everything" and num_possible <= MAX_ENUMERATED
    if is_exact:
        each = np.array(list(product(range(len(dirty)), range(world.num_grip_nodes))))
        combination = each[list(product(range(len(each)), repeat=num_objects))]
        weight = (of_dirty[combination[..., 0]] * world.grip_prior[combination[..., 1]]).prod(axis=1)
        is_dirty, offset = dirty[combination[..., 0]], world.grip_offsets[combination[..., 1]]
    else:
        shape, weight = (num_samples, num_objects), np.full(num_samples, 1.0 / num_samples)
        if num_grip_nodes is None:
            offset = float(world.grasping.offset_std) * rng.standard_normal(shape)
        else:
            offset = rng.choice(world.grip_offsets, p=world.grip_prior, size=shape)
        is_dirty = rng.choice(dirty, p=of_dirty, size=shape)
    size, pace = max(1, _CELLS_AT_ONCE // 2**num_objects), rng if reveals == "everything" else None
    parts = [slice(start, start + size) for start in range(0, len(weight), size)]
    values = np.concatenate([_values(world, is_dirty[part], world.grip + offset[part], steps, pace) for part in parts])
    error = 0.0 if is_exact else float(values.std(ddof=1) / np.sqrt(num_samples))
    return RelaxationBound(float(weight @ values), error)


def _check_revealed(config: WorldConfig, reveals: str) -> None:
    if reveals not in REVEALED:
        raise ArgumentError(f"reveals is {reveals!r}; give one of {', '.join(REVEALED)}")
    if reveals == "everything" and not isinstance(config.grasping, AssumedGrasping):
        name = type(config.grasping).__name__
        raise ArgumentError(f"reveals is 'everything', but grasping is {name}, whose times are not known; use 'hidden'")


def _possible_beliefs(
    world: GridWorld, horizon: int, reveals: str
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """P(DIRTY) of one object given each possible revelation, and the probability of each."""
    from scipy.stats import binom

    dirty_share = float(world.config.dirty_share)
    if reveals != "looks":
        return np.array([0.0, 1.0]), np.array([1.0 - dirty_share, dirty_share])
    occlusions = np.unique(np.concatenate(world.occlusions))
    if not is_independent(world.seeing):
        return _beliefs_by_all_views(labels_of(world.seeing, occlusions, dirty_share))
    right_if_dirty, wrong_if_clean = world.seeing.positive(occlusions, 0.0)
    if not np.allclose(right_if_dirty, 1.0 - wrong_if_clean, rtol=0.0, atol=1e-12):
        raise ArgumentError(
            "reveals is 'looks', but labels are not equally accurate for dirty and clean objects, so no look "
            "is the best; use 'hidden'"
        )
    best, labels = float(np.maximum(right_if_dirty, 1.0 - right_if_dirty).max()), np.arange(horizon + 1)
    if_dirty = dirty_share * binom.pmf(labels, horizon, best)
    total = if_dirty + (1.0 - dirty_share) * binom.pmf(labels, horizon, 1.0 - best)
    is_possible = total > 0.0  # labels that are always right never contradict each other
    return if_dirty[is_possible] / total[is_possible], total[is_possible]


def _beliefs_by_all_views(labels: Labels) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """P(DIRTY) of one object given the labels of every view, the most hidden first, and their probabilities."""
    looks, mass = labels.nothing, np.ones(1)
    for view in np.lexsort((-labels.views.occluded, labels.views.is_held)).tolist():
        look = labels.look(looks, view)
        if look is not None:
            looks = look.looks
            mass = spread_over_labels(mass, (look,), labels.cells(looks).seen.shape)
    return labels.cells(looks).dirty, mass


def _values(
    world: GridWorld,
    dirty: Float[np.ndarray, "n N"],
    offset: Float[np.ndarray, "n N"],
    horizon: int,
    paces: np.random.Generator | None,
) -> Float[np.ndarray, " n"]:
    """Value given each draw of the revealed information, with all objects on the table and the whole horizon to go.

    Revealed are P(DIRTY), the grip offset and, if `paces` are drawn, the exponential draw of each step.
    """
    num_objects, config, law = dirty.shape[1], world.config, world.grasping
    sets = np.arange(2**num_objects)
    left = float(config.reward_dirty_left) * (dirty @ (sets >> np.arange(num_objects)[:, None] & 1))
    won = dirty * config.reward_wash_dirty + (1.0 - dirty) * config.reward_wash_clean
    value = left
    for _ in range(horizon):
        pace = None if paces is None else paces.standard_exponential((len(dirty), 1))
        best = left.copy()
        for target in range(num_objects):
            there = sets[sets >> target & 1 == 1]
            occluded = world.occlusions[target][world.level_by_subset[target, there]]
            probability, attempt_s = _attempts(law, occluded, offset[:, [target]], pace)
            washed, stays = value[:, there ^ (1 << target)], value[:, there]
            wash = probability * (won[:, [target]] + washed) + (1.0 - probability) * (config.reward_wash_failed + stays)
            lift = config.reward_lift_per_s * (float(config.transport_s) + attempt_s) + stays
            best[:, there] = np.maximum(best[:, there], np.maximum(wash, lift))
        value = best
    return value[:, -1]


def _attempts(
    law: KnownGrasping,
    occluded: Float[np.ndarray, " sets"],
    offset: Float[np.ndarray, "n 1"],
    pace: Float[np.ndarray, "n 1"] | None,
) -> tuple[Float[np.ndarray, "n sets"], Float[np.ndarray, "n sets"]]:
    """P(an attempt succeeds), 0 or 1 if its exponential draw is known, and its expected time without transport [s]."""
    if pace is None:
        return -np.expm1(law.log_failure(occluded, offset)), law.expected_s(occluded, offset)
    assert isinstance(law, AssumedGrasping), "checked where the draw is asked for"
    grasp_s = law.scale_s(occluded, offset) * pace
    return (grasp_s <= law.limit_s).astype(np.float64), np.minimum(grasp_s, law.limit_s)
