"""What the map says, computed from its table: where learning pays, and where the best heuristic is good enough."""

from typing import NamedTuple

import pandas as pd

from halfseen.study.experiments.clutter.places import FACTORS, ClutterDesign, label_number, label_share
from halfseen.study.experiments.clutter.table import ENOUGH, LEARN, NO_SCALE, UNDECIDED
from halfseen.study.wording import learned_from
from halfseen.world.config import WorldConfig

FEWEST = 3
"""Places with a verdict below which nothing is said to stand out."""


class Level(NamedTuple):
    """How often a verdict falls where one factor has one value."""

    factor: str
    value: float
    num_places: int
    num_verdicts: int

    @property
    def share(self) -> float:
        """Of the places."""
        return self.num_verdicts / self.num_places


def map_title(table: pd.DataFrame, world: WorldConfig) -> str:
    """Say in one sentence what the figure of the map shows; where the assumed laws are beside it, they are apart."""
    is_assumed = table["is_assumed"]
    own, assumed = pd.DataFrame(table[~is_assumed]), pd.DataFrame(table[is_assumed])
    pays, enough = (_where(own, verdict, world) for verdict in (LEARN, ENOUGH))
    told = f"Learning pays {pays}; the best heuristic is good enough {enough}"
    if assumed.empty:
        return told
    pays, enough = (_count(assumed, verdict) for verdict in (LEARN, ENOUGH))
    return f"{told}; under the assumed laws, these are {pays} and {enough} of {len(assumed)}"


def _count(table: pd.DataFrame, verdict: str) -> int:
    return int((table["verdict"] == verdict).sum())


def map_sentence(table: pd.DataFrame, design: ClutterDesign, world: WorldConfig) -> str:
    """Say where to learn and where the best heuristic is good enough, and what that is taken from."""
    bound = f"{_percent(design.worthwhile_share)} of what the best heuristic earns above finishing at once"
    lost = int((table["gain_share_high"] < 0).sum())
    undecided, unscaled = (_count(table, verdict) for verdict in (UNDECIDED, NO_SCALE))
    return (
        f"{map_title(table, world)}. It pays where the policy "
        f"{learned_from(design.num_trajectories, design.cut_share)} gains more than {bound}, and the heuristic is good "
        f"enough where it gains less (a loss in {lost} places); {undecided} places are inconclusive, and in {unscaled} "
        "the heuristic earns next to nothing above finishing at once."
    )


def _where(table: pd.DataFrame, verdict: str, world: WorldConfig) -> str:
    """Say in how many places a verdict falls, and where it stands out."""
    num = _count(table, verdict)
    if num in (0, len(table)):
        return "everywhere" if num else "nowhere"
    places = f"in {num} of {len(table)} places"
    level = most_telling(levels(table, verdict))
    if level is None or level.num_verdicts < FEWEST:
        return places
    words = factor_words(level.factor, level.value, world)
    return f"{places}, most often where {words} ({level.num_verdicts} of {level.num_places})"


def levels(table: pd.DataFrame, verdict: str) -> list[Level]:
    """How often a verdict falls at each value of each factor, among places that are alike in all other factors.

    A value is compared only where all values of its factor were tried with the other factors fixed: what belongs to
    another factor is never laid at its door.
    """
    found = []
    for factor in FACTORS:
        tried = table.groupby([name for name in FACTORS if name != factor])[factor].transform("nunique")
        compared = table[tried == tried.max()]
        values = sorted(set(compared[factor]))
        for value in values if len(values) > 1 else []:
            verdicts = compared.loc[compared[factor] == value, "verdict"]
            found.append(Level(factor, float(value), len(verdicts), int((verdicts == verdict).sum())))
    return found


def most_telling(found: list[Level]) -> Level | None:
    """The level of the largest share, where its factor makes a difference; None if none does."""
    least = {factor: min(level.share for level in found if level.factor == factor) for factor, *_ in found}
    return max(
        (level for level in found if level.share > least[level.factor]), key=lambda level: level.share, default=None
    )


def factor_words(factor: str, value: float, world: WorldConfig) -> str:
    """Say that a factor has a value."""
    if factor == "num_objects":
        return f"{value:g} objects stand on the table"
    if factor == "occlusion":
        return f"{_percent(value)} of an object is hidden on average"
    if factor == "labels":
        return label_words(value, world)
    if factor == "reward_wash_clean":
        ratio = -value / float(world.reward_wash_dirty)
        return (
            f"washing a clean cup costs {'as much as' if ratio == 1 else f'{ratio:.3g} times what'} a dirty one earns"
        )
    return f"grip offsets spread by {value:.3g}"


def label_words(number: float, world: WorldConfig) -> str:
    """Say how good labels are."""
    shown = _percent(label_share(number, world))
    if label_number(world) == "facing":
        return f"a look shows {shown} of the surface of an object"
    return f"a label in full view is right {shown} of the time"


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %"
