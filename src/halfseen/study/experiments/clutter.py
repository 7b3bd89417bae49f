"""Where learning gains over the best heuristic, by clutter and world: Figure 6.

At each place of clutter and costs there are a fresh log, a learned policy, and the heuristics.
"""

from dataclasses import asdict, dataclass, replace
from itertools import product, zip_longest
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pandas as pd
from scipy import stats

from halfseen.errors import ArgumentError
from halfseen.figures import MARKERS, learned_shades
from halfseen.shapes import Float
from halfseen.study.compare import Frame, Row, ends_of, over_repetitions, where
from halfseen.study.experiment import Experiment, Piece, Pieces, Tables
from halfseen.study.experiments.clutter_places import (
    FACTORS,
    Place,
    assumed,
    check_clutter,
    label_number,
    label_share,
    random_tables,
)
from halfseen.study.pipeline import CUT_KIND, EVALUATION, LOGS, PILOT, Source
from halfseen.study.policies import HEURISTICS, LEARNED, Entrant, by_name
from halfseen.study.setting import Setting
from halfseen.world.config import WorldConfig
from halfseen.world.cuts import cut_rate
from halfseen.world.state import pad_scenes

LEARN = "learn"
ENOUGH = "heuristic is enough"
UNDECIDED = "inconclusive"
NO_SCALE = "heuristic earns nothing"
"""The heuristic earns next to nothing above FINISH at once, so a share of its earnings is meaningless."""
MAP_SEED, TABLES = 16, 2
NEXT_TO_NOTHING = 0.05  # share of the loss of FINISH at once that a heuristic must earn to be a scale
FEWEST = 3  # with fewer places with a verdict, no factor is reported


@dataclass(frozen=True)
class Clutter(Experiment):
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
    name: ClassVar[str] = "clutter"

    def __post_init__(self) -> None:
        for clutter in product(self.num_objects, self.occlusions):
            check_clutter(*clutter)
        if not 0.0 < self.cut_share < 1.0:
            raise ArgumentError(f"cut_share of the map is {self.cut_share}; give a share between 0 and 1")

    @property
    def contenders(self) -> dict[str, Entrant]:
        """All contenders, by name."""
        return by_name(LEARNED, *HEURISTICS)

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

    def prepare(self, setting: Setting) -> Piece:
        """Calibrate the cuts at each place, from a pilot of its own."""
        pilots = (
            self._source(setting, place, 0).play(self.num_trajectories, MAP_SEED + PILOT)
            for place in self.places(setting)
        )
        return {"rates": [cut_rate(pilot, self.cut_share, CUT_KIND) for pilot in pilots]}

    def repeat(self, setting: Setting, prepared: Piece, index: int) -> Piece:
        """Learn and play at every place: a row for each, with the mean reward of each policy."""
        places = zip(self.places(setting), prepared["rates"], strict=True)
        return {"rows": [self.at(setting, place, rate, index) for place, rate in places]}

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
        return asdict(place) | rewards

    def _source(self, setting: Setting, place: Place, index: int) -> Source:
        """A source of trajectories; at one N all places have the same tables, denser or looser."""
        rng = np.random.default_rng([setting.seed, index, TABLES, place.num_objects])
        grips = () if place.is_assumed else setting.grips
        scenes = random_tables(place.num_objects, place.occlusion, self.num_tables, rng, grips)
        return Source(place.world(setting.world), pad_scenes(scenes, max(self.num_objects)), setting.seed, index)

    def tabulate(self, setting: Setting, pieces: Pieces) -> Tables:
        """Make the table ``map``, with a row for each place.

        The best heuristic of a place is the one of four with the largest mean reward on the episodes of the comparison:
        choosing it with hindsight favours it. Columns are num_objects, occlusion, labels, reward_wash_clean,
        grip_offset_std, is_assumed, num_trajectories, cut_share, repetitions, censored_q, best_heuristic,
        heuristic_reward, finish_reward, gain, gain_se, gain_share, gain_share_low, gain_share_high and verdict.
        """
        places = pieces.rows.groupby([*FACTORS, "is_assumed"], sort=False)
        rows = [self._row(setting.world, _place_of(key), rewards) for key, rewards in places]
        return {"map": pd.DataFrame(rows)}

    def _row(self, world: WorldConfig, place: Place, met: Frame) -> Row:
        """One place, from the rewards of all repetitions."""
        best = met[[each.name for each in HEURISTICS]].mean().idxmax()
        # Expected reward of FINISH at once: every dirty object is left.
        finish = place.num_objects * float(world.dirty_share * world.reward_dirty_left)
        learned, rule = met[LEARNED.name].to_numpy(), met[best].to_numpy()
        share = gain_share(learned - rule, rule - finish, NEXT_TO_NOTHING * abs(finish))
        gain = over_repetitions(learned - rule)
        about = {"num_trajectories": self.num_trajectories, "cut_share": self.cut_share, "repetitions": len(met)}
        best_rule = {"best_heuristic": best, "heuristic_reward": float(rule.mean()), "finish_reward": finish}
        earned = {LEARNED.name: float(learned.mean())} | best_rule
        earned |= {"gain": gain.value, "gain_se": gain.standard_error}
        earned |= dict(zip(ends_of("gain_share"), share, strict=True))
        return asdict(place) | about | earned | {"verdict": verdict(share, self.worthwhile_share)}

    def facts(self, setting: Setting, tables: Tables) -> dict[str, Any]:
        """Maps under the study's and the assumed laws, and at which level of a factor a verdict is most frequent."""
        own, assumed = (where(tables["map"], is_assumed=is_assumed) for is_assumed in (False, True))
        telling = {verdict: most_telling(levels(own, verdict)) for verdict in (LEARN, ENOUGH)}
        columns = self.panels(setting)
        worlds = [world and {"here": world} for row in zip_longest(*columns) for world in row]
        sizes = sorted(self.num_objects)
        looks = zip(sizes, learned_shades(len(sizes)), MARKERS, strict=False)
        return {
            "own": own,
            "assumed": assumed,
            "telling": telling,
            "fewest": FEWEST,
            "label_number": label_number(setting.world),
            "label_share": label_share,
            "columns": columns,
            "worlds": worlds,
            "height": 1.0 + 2.1 * len(worlds) / len(columns),
            "default": Place.of(setting.world),
            "sizes": {num: {"color": colour, "marker": mark, "label": f"{num} objects"} for num, colour, mark in looks},
        }


def _scaled_number(number: float, scale: float) -> float:
    # Rounds the product, as binary arithmetic would show extra digits; the world's own number stays unchanged.
    return number if scale == 1.0 else float(f"{number * scale:.6g}")


class GainShare(NamedTuple):
    """Gain as a share of the heuristic's earnings above FINISH at once, with its 95 % interval; NaN without a scale."""

    share: float
    low: float
    high: float


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


def levels(table: Frame, verdict: str) -> Frame:
    """Frequency of a verdict at each value of each factor, among places with the same other factors.

    A value is compared only where all values of its factor were tried with the other factors fixed, which avoids
    confounding between factors. Columns are factor, value, num_places, num_verdicts and share.
    """
    found = []
    for factor in FACTORS:
        tried = table.groupby([name for name in FACTORS if name != factor])[factor].transform("nunique")
        compared = table[tried == tried.max()]
        is_met = (compared["verdict"] == verdict).groupby(compared[factor])
        if is_met.ngroups > 1:
            counts = is_met.agg(num_places="size", num_verdicts="sum", share="mean")
            found.append(counts.rename_axis("value").reset_index().assign(factor=factor))
    return pd.concat(found, ignore_index=True) if found else pd.DataFrame()


def most_telling(found: Frame) -> Row | None:
    """The level with the largest share, if its factor makes a difference; otherwise None."""
    if not found.empty:
        found = found[found["share"] > found.groupby("factor")["share"].transform("min")]
    return None if found.empty else found.loc[found["share"].idxmax()].to_dict()


def _place_of(key: Any) -> Place:
    """The place of a group of rows, whose key has NumPy's types."""
    num_objects, *numbers, is_assumed = key
    fields: list[Any] = [int(num_objects), *map(float, numbers), bool(is_assumed)]
    return Place(*fields)
