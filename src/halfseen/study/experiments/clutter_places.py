"""The numbers of the map: at each place of clutter and costs a fresh log, a learned policy, and the heuristics."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import pandas as pd
from scipy import stats
from scipy.optimize import brentq

from halfseen.errors import ArgumentError
from halfseen.planners.belief import known_grasping
from halfseen.shapes import Float
from halfseen.study.compare import over_repetitions
from halfseen.study.experiment import PieceOf, Pieces, Row, Tables
from halfseen.study.pipeline import CUT_KIND, EVALUATION, LOGS, PILOT, Source
from halfseen.study.policies import HEURISTICS, LEARNED
from halfseen.study.setting import Setting
from halfseen.world.config import WorldConfig
from halfseen.world.cuts import cut_rate
from halfseen.world.scene import Scene
from halfseen.world.state import pad_scenes

LEARN = "learn"
ENOUGH = "heuristic is enough"
UNDECIDED = "inconclusive"
NO_SCALE = "heuristic earns nothing"
"""The heuristic earns next to nothing above FINISH at once, so a share of its earnings is meaningless."""
MAP_SEED, TABLES = 16, 2
NEXT_TO_NOTHING = 0.05  # share of the loss of FINISH at once that a heuristic must earn to be a scale
RAW_SHAPE = 0.5
"""Shape of the gamma distribution of pairwise occlusion; below 1, few pairs hide much and many hide next to nothing."""
LawNumber = Literal["gain", "facing"]
"""Quality of labels: the gain of `AssumedSeeing`, or the surface that a look shows in `PersistentSeeing`."""


@dataclass(frozen=True)
class Place:
    """One place of the map: N, the mean hidden share of an object while all stand, and three numbers of the world.

    These are the `LawNumber` of its law of seeing, `WorldConfig.reward_wash_clean`, and the spread of grip offsets. The
    last field is whether its laws are the assumed ones, whatever the study's are.
    """

    num_objects: int
    occlusion: float
    labels: float
    reward_wash_clean: float
    grip_offset_std: float
    is_assumed: bool = False

    @classmethod
    def of(cls, world: WorldConfig, is_assumed: bool = False) -> "Place":
        """The place with a world's own numbers; its clutter is arbitrary."""
        spread = float(known_grasping(world).offset_std)
        number = float(getattr(world.seeing, label_number(world)))
        return cls(0, 0.0, number, float(world.reward_wash_clean), spread, is_assumed)

    def world(self, base: WorldConfig) -> WorldConfig:
        """The world of this place; all other numbers are those of `base`, or of the assumed laws."""
        base = assumed(base) if self.is_assumed else base
        grasping: Any = base.grasping
        seeing: Any = base.seeing
        return replace(
            base,
            grasping=replace(grasping, offset_std=self.grip_offset_std),
            seeing=replace(seeing, **{label_number(base): self.labels}),
            reward_wash_clean=self.reward_wash_clean,
        )


def label_number(world: WorldConfig) -> LawNumber:
    """Name of the number for the quality of labels in a world."""
    for name in get_args(LawNumber):
        if hasattr(world.seeing, name):
            return name
    raise ArgumentError(
        f"the map varies how good labels are, but {type(world.seeing).__name__} has none of "
        f"{', '.join(get_args(LawNumber))}; give a world with AssumedSeeing or PersistentSeeing"
    )


def label_share(number: float, world: WorldConfig) -> float:
    """A `label_number` as shown to readers: share of right labels in full view, or of the surface shown."""
    return number + float(getattr(world.seeing, "floor", 0.0))


def assumed(world: WorldConfig) -> WorldConfig:
    """The same world under the assumed laws."""
    own = WorldConfig()
    return replace(world, grasping=own.grasping, seeing=own.seeing, transport_s=own.transport_s)


FACTORS = ("num_objects", "occlusion", "labels", "reward_wash_clean", "grip_offset_std")
"""Factors in which places differ, besides the laws."""


@dataclass(frozen=True)
class ClutterDesign:
    """The map: at every clutter, the world's own numbers, and each of the variations below by itself.

    Clutter is the number of objects N and the mean hidden share of an object. In each repetition, policies are learned
    from `num_trajectories` over `num_tables` random tables, with `cut_share` of them cut independently; with `laws`,
    laws fitted to the same log assist. Learning is worthwhile if it gains more than `worthwhile_share` of what the best
    heuristic earns above FINISH at once. Scales multiply the world's own quality of labels and spread of grip offsets.
    """

    num_objects: tuple[int, ...] = (3, 6, 9)
    occlusions: tuple[float, ...] = (0.1, 0.3, 0.5)
    label_scales: tuple[float, ...] = (0.5, 1.0, 1.5)
    wash_clean_rewards: tuple[float, ...] = (-5.0, -10.0, -20.0)
    grip_scales: tuple[float, ...] = (0.5, 1.0, 1.5)
    num_trajectories: int = 200
    cut_share: float = 1 / 2
    num_tables: int = 20
    episodes_per_table: int = 10
    worthwhile_share: float = 0.05
    laws: bool = True
    most_repetitions: int | None = 8

    def __post_init__(self) -> None:
        for clutter in product(self.num_objects, self.occlusions):
            check_clutter(*clutter)
        if not 0.0 < self.cut_share < 1.0:
            raise ArgumentError(f"cut_share of the map is {self.cut_share}; give a share between 0 and 1")

    def places(self, setting: Setting) -> list[Place]:
        """All places: every clutter in the world and in each of its variations; and under the assumed laws."""
        kinds = dict.fromkeys(kind for panels in self.panels(setting) for kind in panels)
        clutters = product(kinds, self.num_objects, self.occlusions)
        return [replace(kind, num_objects=num, occlusion=occlusion) for kind, num, occlusion in clutters]

    def panels(self, setting: Setting) -> list[list[Place]]:
        """Kinds of worlds, as columns of the map.

        These are quality of labels by cost of washing a clean object, with a column for each cost; last the spread of
        grip offsets, and the assumed laws if the study's differ.
        """
        own = Place.of(setting.world)
        numbers = (min(_scaled_number(own.labels, scale), 1.0) for scale in sorted(self.label_scales))
        labels = [replace(own, labels=number) for number in numbers]
        columns = [
            [replace(each, reward_wash_clean=reward) for each in labels]
            for reward in sorted(self.wash_clean_rewards, reverse=True)
        ]
        spreads = (_scaled_number(own.grip_offset_std, scale) for scale in sorted(self.grip_scales))
        last = [replace(own, grip_offset_std=spread) for spread in spreads]
        others = [] if setting.law is None else [Place.of(assumed(setting.world), is_assumed=True)]
        return [*columns, [*last, *others]]

    def prepare(self, setting: Setting) -> PieceOf:
        """Calibrate the cuts at each place, from a pilot of its own."""
        pilots = (
            self._source(setting, place, 0).play(self.num_trajectories, MAP_SEED + PILOT)
            for place in self.places(setting)
        )
        return {"rates": [cut_rate(pilot, self.cut_share, CUT_KIND) for pilot in pilots]}

    def repeat(self, setting: Setting, prepared: PieceOf, index: int) -> PieceOf:
        """Learn and play at every place: a row for each."""
        places = zip(self.places(setting), prepared["rates"], strict=True)
        return {"index": index, "map": [self.at(setting, place, rate, index) for place, rate in places]}

    def at(self, setting: Setting, place: Place, rate: float, index: int) -> Row:
        """Learn and play at one place: the place, and the mean reward of each policy.

        It depends on other places only through the largest N, to which all tables are padded so that one compiled call
        serves all places.
        """
        source = self._source(setting, place, index)
        episodes = source.play(self.num_trajectories, MAP_SEED + LOGS)
        cuts = source.cut(episodes, rate, CUT_KIND)
        learned = source.logged(episodes, laws=self.laws).learn_one(cuts, self.num_trajectories)
        policies = {LEARNED.name: learned} | {each.name: each.policy(source.world) for each in HEURISTICS}
        num_episodes = self.num_tables * self.episodes_per_table
        rewards = {
            name: source.evaluate(policy, num_episodes, MAP_SEED + EVALUATION).means()["reward"]
            for name, policy in policies.items()
        }
        return asdict(place) | {"rewards": rewards}

    def _source(self, setting: Setting, place: Place, index: int) -> Source:
        """A source of trajectories; at one N all places have the same tables, denser or looser."""
        rng = np.random.default_rng([setting.seed, index, TABLES, place.num_objects])
        grips = () if place.is_assumed else setting.grips
        scenes = random_tables(place.num_objects, place.occlusion, self.num_tables, rng, grips)
        return Source(place.world(setting.world), pad_scenes(scenes, max(self.num_objects)), setting.seed, index)

    def tabulate(self, setting: Setting, pieces: Pieces) -> Tables:
        """Make the table ``map``."""
        return {"map": table_of(self, setting.world, pieces.repetitions)}


def _scaled_number(number: float, scale: float) -> float:
    # Rounds the product, as binary arithmetic would show extra digits; the world's own number stays unchanged.
    return number if scale == 1.0 else float(f"{number * scale:.6g}")


def random_tables(
    num_objects: int, occlusion: float, num_tables: int, rng: np.random.Generator, grips: Sequence[float] = ()
) -> tuple[Scene, ...]:
    """Random tables with the same mean occlusion, with grip offsets drawn from `grips`, if any.

    Objects stand one behind the other in a random order, and object i is hidden by every nearer j:
    hides[i, j] = 1 − exp(−s·r_ij) with r_ij ~ Gamma(0.5), so that few pairs hide much. The occlusion of i is
    1 − exp(−s·Σ_j r_ij), and s is chosen so that its mean over the objects of the table is `occlusion`. With the same
    `rng`, tables of another occlusion are these, denser or looser. The nearest object is in full view, so the mean is
    below (N − 1) / N.
    """
    check_clutter(num_objects, occlusion)
    hides = [_scaled(_raw(num_objects, rng), occlusion) for _ in range(num_tables)]
    grip = rng.choice(grips, (num_tables, num_objects)) if len(grips) else np.zeros((num_tables, num_objects))
    return tuple(Scene(hides[k], f"random table {k}", grip[k]) for k in range(num_tables))


def _raw(num_objects: int, rng: np.random.Generator) -> Float[np.ndarray, "N N"]:
    behind = np.tril(rng.gamma(RAW_SHAPE, size=(num_objects, num_objects)), -1)
    order = rng.permutation(num_objects)
    return behind[np.ix_(order, order)]


def _scaled(raw: Float[np.ndarray, "N N"], occlusion: float) -> Float[np.ndarray, "N N"]:
    if occlusion == 0.0:
        return np.zeros_like(raw)
    hidden = raw.sum(axis=1)
    # 1 − exp(−x) ≤ x, so the scale is at least occlusion / mean(hidden).
    least = float(np.log(occlusion) - np.log(np.mean(hidden))) - 1.0
    log_scale: Any = brentq(lambda log: float(np.mean(-np.expm1(-np.exp(log) * hidden))) - occlusion, least, 100.0)
    return -np.expm1(-np.exp(log_scale) * raw)


def check_clutter(num_objects: int, occlusion: float) -> None:
    """Refuse a mean occlusion that no table with this number of objects has."""
    largest = (num_objects - 1) / num_objects if num_objects > 0 else 0.0
    if num_objects < 1 or not (0.0 <= occlusion < largest or occlusion == 0.0):
        raise ArgumentError(
            f"a mean occlusion of {occlusion} with {num_objects} objects; the nearest is in full view, so it must be "
            f"0 or lie below {largest:.3g}"
        )


class GainShare(NamedTuple):
    """Gain as a share of the heuristic's earnings above FINISH at once, with its 95 % interval; NaN without a scale."""

    share: float
    low: float
    high: float


def table_of(design: ClutterDesign, world: WorldConfig, pieces: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """One row for each place of the map.

    The best heuristic of a place is the one of four with the largest mean reward on the episodes of the comparison:
    choosing it with hindsight favours it. Columns are num_objects, occlusion, labels, reward_wash_clean,
    grip_offset_std, is_assumed, num_trajectories, cut_share, repetitions, censored_q, best_heuristic, heuristic_reward,
    finish_reward, gain, gain_se, gain_share, gain_share_low, gain_share_high and verdict.
    """
    return pd.DataFrame(
        [_row(design, world, [piece["map"][k] for piece in pieces]) for k in range(len(pieces[0]["map"]))]
    )


def _row(design: ClutterDesign, world: WorldConfig, met: Sequence[Row]) -> Row:
    """One place, from its rows of all repetitions."""
    place = Place(**{name: met[0][name] for name in (*FACTORS, "is_assumed")})
    rewards = {name: np.array([row["rewards"][name] for row in met]) for name in met[0]["rewards"]}
    best = max((each.name for each in HEURISTICS), key=lambda name: rewards[name].mean())
    # Expected reward of FINISH at once: every dirty object is left.
    finish = place.num_objects * float(world.dirty_share * world.reward_dirty_left)
    learned, rule = rewards[LEARNED.name], rewards[best]
    share, gain = gain_share(learned - rule, rule - finish, NEXT_TO_NOTHING * abs(finish)), learned - rule
    row = asdict(place) | {"num_trajectories": design.num_trajectories, "cut_share": design.cut_share}
    row |= {"repetitions": len(learned), LEARNED.name: float(learned.mean()), "best_heuristic": best}
    row |= {"heuristic_reward": float(rule.mean()), "finish_reward": finish}
    row |= {"gain": over_repetitions(gain).value, "gain_se": over_repetitions(gain).standard_error}
    row |= {"gain_share": share.share, "gain_share_low": share.low, "gain_share_high": share.high}
    return row | {"verdict": verdict(share, design.worthwhile_share)}


def gain_share(gain: Float[np.ndarray, " R"], earned: Float[np.ndarray, " R"], negligible: float) -> GainShare:
    """Ratio of two paired means with its 95 % confidence interval.

    The interval holds the shares θ for which a t test of E[gain − θ·earned] = 0 does not reject [Fieller1954]_; so it
    lies above a share θ exactly if the learned policy gains significantly more than that share. `gain` is learned −
    heuristic, and `earned` heuristic − FINISH at once, by repetition. If the interval of the mean of `earned` extends
    to `negligible` or below, there is no share.
    """
    num = len(gain)
    t = float(stats.t.ppf(0.975, num - 1))
    mean_gain, mean_earned = float(np.mean(gain)), float(np.mean(earned))
    (var_gain, covariance), (_, var_earned) = t**2 / num * np.cov(gain, earned)
    if mean_earned - np.sqrt(var_earned) <= negligible:
        return GainShare(np.nan, np.nan, np.nan)
    a, b, c = mean_earned**2 - var_earned, mean_earned * mean_gain - covariance, mean_gain**2 - var_gain
    reach = np.sqrt(max(b**2 - a * c, 0.0))
    return GainShare(mean_gain / mean_earned, float((b - reach) / a), float((b + reach) / a))


def verdict(share: GainShare, worthwhile_share: float) -> str:
    """Position of the interval of the share relative to the worthwhile share."""
    if np.isnan(share.share):
        return NO_SCALE
    if share.low > worthwhile_share:
        return LEARN
    return ENOUGH if share.high < worthwhile_share else UNDECIDED
