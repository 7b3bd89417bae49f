"""Where learning is worth it: at every place of the map a fresh log, a learned policy, and the heuristics beside it."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pandas as pd
from scipy import stats

from halfseen.shapes import Float
from halfseen.study.compare import over_repetitions
from halfseen.study.experiment import PieceOf, Pieces, Row, Section, Tables
from halfseen.study.experiments.clutter_map import ENOUGH, LEARN, NO_SCALE, UNDECIDED, section_of
from halfseen.study.experiments.clutter_places import FACTORS, ClutterDesign, Place, random_tables
from halfseen.study.pipeline import CUT_KIND, EVALUATION, LOGS, PILOT, Source
from halfseen.study.policies import HEURISTICS, LEARNED
from halfseen.study.setting import Setting
from halfseen.world.config import WorldConfig
from halfseen.world.cuts import cut_rate
from halfseen.world.state import pad_scenes

MAP_SEED, TABLES = 16, 2
NEXT_TO_NOTHING = 0.05
"""Share of what FINISH at once loses, above which a heuristic's earnings are a scale."""


@dataclass(frozen=True)
class Clutter(ClutterDesign):
    """The experiment; its parameters are those of `ClutterDesign`."""

    name: ClassVar[str] = "clutter"

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

        It depends on no other place but through the largest N, to which all tables are padded so that one compiled
        call serves all places.
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
        """At one N the same tables everywhere, denser or looser."""
        rng = np.random.default_rng([setting.seed, index, TABLES, place.num_objects])
        grips = () if place.is_assumed else setting.grips
        scenes = random_tables(place.num_objects, place.occlusion, self.num_tables, rng, grips)
        return Source(place.world(setting.world), pad_scenes(scenes, max(self.num_objects)), setting.seed, index)

    def tabulate(self, setting: Setting, pieces: Pieces) -> Tables:
        """Make map."""
        return {"map": table_of(self, setting.world, pieces.repetitions)}

    def section(self, setting: Setting, tables: Tables) -> Section:
        """Say where to learn, and where the best heuristic is good enough."""
        return section_of(self, setting, tables["map"])


class GainShare(NamedTuple):
    """Gain as a share of what the heuristic earns above FINISH at once, with its 95 % interval; NaN without a scale."""

    share: float
    low: float
    high: float


def table_of(design: ClutterDesign, world: WorldConfig, pieces: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """One row for each place of the map.

    The best heuristic of a place is that of the four with the largest mean reward on the very episodes of the
    comparison: it is chosen with hindsight, which favours it.
    Columns are num_objects, occlusion, labels, reward_wash_clean, grip_offset_std, is_assumed, num_trajectories,
    cut_share, repetitions, censored_q, best_heuristic, heuristic_reward, finish_reward, gain, gain_se, gain_share,
    gain_share_low, gain_share_high and verdict.
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
    """Ratio of two paired means with its 95 % interval.

    The interval holds the shares θ for which a t test of E[gain − θ·earned] = 0 does not reject [Fieller1954]_; so it
    lies above a share θ just where the learned policy gains significantly more than that share.
    `gain` is learned − heuristic, and `earned` heuristic − FINISH at once, repetition by repetition; where the interval
    of the mean of `earned` reaches down to `negligible`, there is no share.
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
    """Where the interval of the share lies beside the share that is worth the trouble."""
    if np.isnan(share.share):
        return NO_SCALE
    if share.low > worthwhile_share:
        return LEARN
    return ENOUGH if share.high < worthwhile_share else UNDECIDED
