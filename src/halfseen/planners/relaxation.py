"""What nobody can beat on a table of any size: the value to one who is told more [BrownSmithSun2010]_.

Whoever is told more can do no worse. Three informants are here, each of which tells more than the one before:

- ``"looks"`` tells before the first action how well each object is gripped, and what as many looks at each object as
  the horizon allows would say if nothing hid it. No policy sees more labels, nor better ones: a label from behind
  another object is as good as one in full view that is sometimes turned round at random. Where errors persist, it tells
  what would be found in every view that an object of the table can have, from the most hidden to the one in the hand:
  views are nested, so whoever sees some of them can tell no more;
- ``"hidden"`` tells which objects are dirty instead;
- ``"everything"`` tells the time that every grasp will take as well: the exponential draw of every step.

Then no label adds anything, and a state is the set of objects on the table and the steps to go: 2^N sets, valued
backwards for many draws of what is told at once.
"""

from itertools import product
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike
from scipy.stats import binom

from halfseen.errors import ArgumentError
from halfseen.planners.exact_bellman import spread_over_labels
from halfseen.planners.exact_labels import Labels, dirty_in, labels_of, views_of
from halfseen.planners.exact_model import GridWorld
from halfseen.world.config import WorldConfig
from halfseen.world.grasping import AssumedGrasping
from halfseen.world.scene import Scene
from halfseen.world.seeing import is_independent

MAX_OBJECTS = 12
MAX_ENUMERATED = 20_000
"""Number of things that may be told up to which all of them are gone through, where grip offsets lie on a grid."""

_CELLS_AT_ONCE = 2_000_000

REVEALED = ("looks", "hidden", "everything")
"""What an informant may tell, from little to much."""


class RelaxationBound(NamedTuple):
    """An upper bound on the expected reward of every policy."""

    value: float
    standard_error: float
    """Of `value`, from the number of draws; 0 where nothing was drawn."""


class _Told(NamedTuple):
    """Some of what may be told of a table, and how likely each is."""

    dirty: Float[np.ndarray, "n N"]
    """P(DIRTY) given what is told."""
    grip_offset: Float[np.ndarray, "n N"]
    weight: Float[np.ndarray, " n"]


def information_relaxation_bound(
    scene: Scene | ArrayLike,
    config: WorldConfig,
    horizon: int | None = None,
    num_samples: int = 10_000,
    seed: int = 0,
    num_grip_nodes: int | None = None,
    reveals: str = "looks",
) -> RelaxationBound:
    """Bound what any policy can earn on a table, from above.

    Parameters
    ----------
    scene
        The table, or its ``hides``, shape (N, N).
    config
        The world.
    horizon
        Steps that a path may have, by default the world's.
    num_samples
        Number of draws of what is told.
    seed
        Of the draws.
    num_grip_nodes
        Grip offsets lie on this many Gauss–Hermite nodes, as for `solve_table`; by default they are normal, as in the
        world. On a grid nothing is drawn if no more than `MAX_ENUMERATED` things may be told, times apart.
    reveals
        What the informant tells, one of `REVEALED`; "looks" gives the tightest bound.

    Returns
    -------
    RelaxationBound
        The bound and its standard error.

    Raises
    ------
    ArgumentError
        A number is out of its range, `reveals` is unknown or does not fit the world's laws, or there are more than
        `MAX_OBJECTS` objects.

    Examples
    --------
    >>> from halfseen.world import WorldConfig
    >>> bound = information_relaxation_bound([[0.0, 0.6], [0.1, 0.0]], WorldConfig(), horizon=3, num_grip_nodes=7)
    >>> round(bound.value, 3), bound.standard_error
    (2.732, 0.0)
    """
    table = scene if isinstance(scene, Scene) else Scene(np.asarray(scene, dtype=np.float64))
    steps = config.horizon if horizon is None else horizon
    _check(table.num_objects, steps, num_samples, num_grip_nodes, reveals)
    _check_times_known(config, reveals)
    world = GridWorld(table, config, num_grip_nodes or 1)
    rng = np.random.default_rng(seed)
    dirty, of_dirty = _told_of_dirt(world, steps, reveals)
    num_told = (len(dirty) * (num_grip_nodes or np.inf)) ** table.num_objects
    is_exact = reveals != "everything" and num_told <= MAX_ENUMERATED
    if is_exact:
        told = _all_told(world, dirty, of_dirty)
    else:
        told = _drawn(world, dirty, of_dirty, num_samples, num_grip_nodes is not None, rng)
    values = np.concatenate([_values(world, part, steps, reveals, rng) for part in _parts(told)])
    value = float(told.weight @ values)
    error = 0.0 if is_exact else float(values.std(ddof=1) / np.sqrt(num_samples))
    return RelaxationBound(value, error)


def _check(num_objects: int, horizon: int, num_samples: int, num_grip_nodes: int | None, reveals: str) -> None:
    for name, number, least in (("horizon", horizon, 1), ("num_samples", num_samples, 2)):
        if number < least:
            raise ArgumentError(f"{name} is {number}; at least {least} is needed")
    if num_grip_nodes is not None and num_grip_nodes < 1:
        raise ArgumentError(f"num_grip_nodes is {num_grip_nodes}; at least 1 is needed, or None for normal offsets")
    if not 1 <= num_objects <= MAX_OBJECTS:
        raise ArgumentError(f"the scene has {num_objects} objects; the bound takes 1 to {MAX_OBJECTS}")
    if reveals not in REVEALED:
        raise ArgumentError(f"reveals is {reveals!r}; it is one of {', '.join(REVEALED)}")


def _check_times_known(config: WorldConfig, reveals: str) -> None:
    if reveals == "everything" and not isinstance(config.grasping, AssumedGrasping):
        name = type(config.grasping).__name__
        raise ArgumentError(f"reveals is 'everything', and grasping is {name}, whose times are not known: use 'hidden'")


def _told_of_dirt(
    world: GridWorld, horizon: int, reveals: str
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """P(DIRTY) of one object after each thing that may be told of it, and how likely that is."""
    dirty_share = float(world.config.dirty_share)
    if reveals != "looks":
        return np.array([0.0, 1.0]), np.array([1.0 - dirty_share, dirty_share])
    occlusions = np.unique(np.concatenate(world.occlusions))
    if not is_independent(world.seeing):
        views = views_of(world.seeing, occlusions)
        return _told_by_all_views(labels_of(world.seeing, views, float(np.log(dirty_share) - np.log1p(-dirty_share))))
    accuracy, of_clean = world.seeing.positive(occlusions, 0.0)
    _check_symmetric(accuracy, 1.0 - of_clean)
    best = float(np.maximum(accuracy, 1.0 - accuracy).max())
    labels = np.arange(horizon + 1)
    if_dirty = dirty_share * binom.pmf(labels, horizon, best)
    total = if_dirty + (1.0 - dirty_share) * binom.pmf(labels, horizon, 1.0 - best)
    return if_dirty / total, total


def _told_by_all_views(labels: Labels) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, " k"]]:
    """P(DIRTY) of one object after a look in every view, the most hidden first, and how likely that is."""
    looks, mass = labels.nothing, np.ones(1)
    for view in np.lexsort((-labels.views.occluded, labels.views.is_held)).tolist():
        look, looks = labels.look(looks, view), labels.after(looks, view)
        if look is not None:
            mass = spread_over_labels(mass, (look,), (labels.num_cells(looks),))
    return dirty_in(labels.log_odds(looks)), mass


def _check_symmetric(right_if_dirty: Float[np.ndarray, " k"], right_if_clean: Float[np.ndarray, " k"]) -> None:
    if not np.allclose(right_if_dirty, right_if_clean, rtol=0.0, atol=1e-12):
        raise ArgumentError(
            "reveals is 'looks', and labels are not right as often of dirty objects as of clean ones, so that none is "
            "the best of all: use 'hidden'"
        )


def _all_told(world: GridWorld, dirty: Float[np.ndarray, " k"], of_dirty: Float[np.ndarray, " k"]) -> _Told:
    num_objects = world.num_objects
    dirt = np.array(list(product(range(len(dirty)), repeat=num_objects)))
    node = np.array(list(product(range(world.num_grip_nodes), repeat=num_objects)))
    weight = np.outer(of_dirty[dirt].prod(axis=1), world.grip_prior[node].prod(axis=1)).ravel()
    grip_offset = world.grip + np.tile(world.grip_offsets[node], (len(dirt), 1))
    return _Told(np.repeat(dirty[dirt], len(node), axis=0), grip_offset, weight)


def _drawn(
    world: GridWorld,
    dirty: Float[np.ndarray, " k"],
    of_dirty: Float[np.ndarray, " k"],
    num_samples: int,
    is_on_grid: bool,
    rng: np.random.Generator,
) -> _Told:
    shape = (num_samples, world.num_objects)
    if is_on_grid:
        grip_offset = rng.choice(world.grip_offsets, p=world.grip_prior, size=shape)
    else:
        grip_offset = float(world.grasping.offset_std) * rng.standard_normal(shape)
    grip_offset = world.grip + grip_offset
    return _Told(rng.choice(dirty, p=of_dirty, size=shape), grip_offset, np.full(num_samples, 1.0 / num_samples))


def _parts(told: _Told) -> list[_Told]:
    """Bounded numbers of rows at a time."""
    num_rows, num_objects = told.dirty.shape
    size = max(1, _CELLS_AT_ONCE // 2**num_objects)
    return [_Told(*(leaf[start : start + size] for leaf in told)) for start in range(0, num_rows, size)]


def _values(
    world: GridWorld, told: _Told, horizon: int, reveals: str, rng: np.random.Generator
) -> Float[np.ndarray, " n"]:
    """Value of each thing told to the informed, all objects on the table and the whole horizon to go."""
    num_rows, num_objects = told.dirty.shape
    dirty_left = float(world.config.reward_dirty_left)
    sets = np.arange(2**num_objects)
    left = dirty_left * (told.dirty @ (sets >> np.arange(num_objects)[:, None] & 1))
    value = left
    for _ in range(horizon):
        pace = rng.standard_exponential((num_rows, 1)) if reveals == "everything" else None
        best = left.copy()
        for target in range(num_objects):
            there = sets[sets >> target & 1 == 1]
            probability, attempt_s = _attempts(world, told, target, there, pace)
            washed, stays = value[:, there ^ (1 << target)], value[:, there]
            config = world.config
            dirty = told.dirty[:, [target]]
            won = dirty * config.reward_wash_dirty + (1.0 - dirty) * config.reward_wash_clean
            wash = probability * (won + washed) + (1.0 - probability) * (config.reward_wash_failed + stays)
            lift = config.reward_lift_per_s * attempt_s + stays
            best[:, there] = np.maximum(best[:, there], np.maximum(wash, lift))
        value = best
    return value[:, -1]


def _attempts(
    world: GridWorld,
    told: _Told,
    target: int,
    there: np.ndarray,
    pace: Float[np.ndarray, "n 1"] | None,
) -> tuple[Float[np.ndarray, "n sets"], Float[np.ndarray, "n sets"]]:
    """P(an attempt on `target` succeeds) and its expected time [s], by which objects are there.

    `pace` holds the exponential draw of this step if it is known; then the probability is 0 or 1.
    """
    occluded = world.occlusions[target][world.level_by_subset[target, there]]
    law, offset, transport_s = world.grasping, told.grip_offset[:, [target]], float(world.config.transport_s)
    if pace is None:
        return -np.expm1(law.log_failure(occluded, offset)), transport_s + law.expected_s(occluded, offset)
    assert isinstance(law, AssumedGrasping), "checked where the draw is asked for"
    grasp_s = law.scale_s(occluded, offset) * pace
    return (grasp_s <= law.limit_s).astype(np.float64), transport_s + np.minimum(grasp_s, law.limit_s)
