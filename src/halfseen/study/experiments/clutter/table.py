"""From the pieces of the map to its table: where learning beats the best heuristic, and by how much."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy import stats

from halfseen.shapes import Float
from halfseen.study.experiments.clutter.places import FACTORS, ClutterDesign, Place
from halfseen.study.policies import HEURISTICS, LEARNED
from halfseen.study.statistics import over_repetitions
from halfseen.world.config import WorldConfig

LEARN = "learn"
ENOUGH = "heuristic is enough"
UNDECIDED = "inconclusive"
NO_SCALE = "heuristic earns nothing"
"""The heuristic earns next to nothing above FINISH at once, so that a share of that means nothing."""
VERDICTS = (LEARN, ENOUGH, UNDECIDED, NO_SCALE)

NEXT_TO_NOTHING = 0.05
"""Share of what FINISH at once loses, above which a heuristic's earnings are a scale."""


class GainShare(NamedTuple):
    """Gain as a share of what the heuristic earns above FINISH at once, with its 95 % interval; NaN without a scale."""

    share: float
    low: float
    high: float


def finish_reward(num_objects: int, world: WorldConfig) -> float:
    """Expected reward of FINISH at once: every dirty object is left."""
    return num_objects * float(world.dirty_share * world.reward_dirty_left)


def table_of(design: ClutterDesign, world: WorldConfig, pieces: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """One row for each place of the map.

    The best heuristic of a place is that of the four with the largest mean reward on the very episodes of the
    comparison: it is chosen with hindsight, which favours it.
    Columns are num_objects, occlusion, labels, reward_wash_clean, grip_offset_std, is_assumed, num_trajectories,
    cut_share, repetitions, censored_q, best_heuristic, heuristic_reward, finish_reward, gain, gain_se, gain_share,
    gain_share_low, gain_share_high and verdict.
    """
    rows = []
    for k, row in enumerate(pieces[0]["map"]):
        place = Place(**{name: row[name] for name in (*FACTORS, "is_assumed")})
        rewards = {name: np.array([piece["map"][k]["rewards"][name] for piece in pieces]) for name in row["rewards"]}
        rows.append(_row(design, place, world, rewards))
    return pd.DataFrame(rows)


def _row(
    design: ClutterDesign, place: Place, world: WorldConfig, rewards: Mapping[str, Float[np.ndarray, " R"]]
) -> dict[str, Any]:
    best = max((each.name for each in HEURISTICS), key=lambda name: rewards[name].mean())
    finish = finish_reward(place.num_objects, world)
    learned, rule = rewards[LEARNED.name], rewards[best]
    share = gain_share(learned - rule, rule - finish, NEXT_TO_NOTHING * abs(finish))
    gain = over_repetitions(learned - rule)
    return asdict(place) | {
        "num_trajectories": design.num_trajectories,
        "cut_share": design.cut_share,
        "repetitions": len(learned),
        LEARNED.name: float(learned.mean()),
        "best_heuristic": best,
        "heuristic_reward": float(rule.mean()),
        "finish_reward": finish,
        "gain": gain.value,
        "gain_se": gain.standard_error,
        "gain_share": share.share,
        "gain_share_low": share.low,
        "gain_share_high": share.high,
        "verdict": verdict(share, design.worthwhile_share),
    }


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
    """One of `VERDICTS`."""
    if np.isnan(share.share):
        return NO_SCALE
    if share.low > worthwhile_share:
        return LEARN
    return ENOUGH if share.high < worthwhile_share else UNDECIDED
