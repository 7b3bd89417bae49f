"""What the map says: one rule for a practitioner and a title, computed from its table."""

from typing import NamedTuple

import numpy as np
import pandas as pd

from halfseen.pages.numbers import share_in_words
from halfseen.pages.sentences import listed
from halfseen.study.experiments.clutter.design import ClutterDesign
from halfseen.study.experiments.clutter.places import FACTORS, assumed_laws
from halfseen.study.experiments.clutter.table import ENOUGH, LEARN, NO_SCALE, UNDECIDED
from halfseen.world.config import WorldConfig

MOST_NAMED = 3


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
    """Say in one sentence what the figure of the map shows."""
    if not set(table["verdict"]) & {LEARN, ENOUGH}:
        return "Whether learning pays is inconclusive everywhere on the map"
    return _rule(table, world, 1, "Learning pays", is_counted=False)


def map_sentence(table: pd.DataFrame, design: ClutterDesign, world: WorldConfig) -> str:
    """Say where to learn and where the best heuristic is good enough, and what that is taken from."""
    return f"{_rule(table, world, MOST_NAMED, 'Learn', is_counted=True)}. {_counts(table, design)}"


def _rule(table: pd.DataFrame, world: WorldConfig, most_named: int, learn: str, *, is_counted: bool) -> str:
    """Say where to learn; and of the places that this does not name, where the heuristic is good enough."""
    named = _mostly(table, LEARN, most_named)
    is_named = np.zeros(len(table), dtype=bool)
    for level in named:
        is_named |= table[level.factor].to_numpy() == level.value
    rest = table if not named or is_named.all() else pd.DataFrame(table[~is_named])
    pays = _where(table, LEARN, world, most_named, is_counted)
    enough = _where(rest, ENOUGH, world, most_named, is_counted)
    start = f"{learn} {pays}" if pays else "Nowhere on the map does learning clearly pay"
    subject = f"{'elsewhere ' if rest is not table else ''}the best heuristic is"
    return f"{start}; {subject} {f'good enough {enough}' if enough else 'nowhere clearly good enough'}"


def _counts(table: pd.DataFrame, design: ClutterDesign) -> str:
    num = {verdict: int((table["verdict"] == verdict).sum()) for verdict in (LEARN, ENOUGH, UNDECIDED, NO_SCALE)}
    lost = int((table["gain_share_high"] < 0).sum())
    losses = f" (a loss in {lost})" if lost else ""
    bound = f"{_percent(design.worthwhile_share)} of what the best heuristic earns above finishing at once"
    said = [
        f"in {num[LEARN]} of {len(table)} places the policy learned from {design.num_paths} logged paths, of which "
        f"about {share_in_words(design.cut_share)} were cut, gains more than {bound}",
        f"in {num[ENOUGH]} it gains less{losses}",
    ]
    if num[UNDECIDED]:
        said.append(f"in {num[UNDECIDED]} it is inconclusive")
    if num[NO_SCALE]:
        said.append(f"in {num[NO_SCALE]} the heuristic earns next to nothing above finishing at once")
    text = listed(said)
    return f"{text[0].upper()}{text[1:]}."


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


def _where(table: pd.DataFrame, verdict: str, world: WorldConfig, most_named: int, is_counted: bool) -> str:
    """Say where a verdict falls in most places, or else where it falls most often; nothing if it falls nowhere."""
    hits = int((table["verdict"] == verdict).sum())
    if hits in (0, len(table)):
        return "everywhere" if hits else ""
    most = [_said(level, world, is_counted) for level in _mostly(table, verdict, most_named)]
    if most:
        return f"mostly where {listed(most, 'or')}"
    telling = _telling(table, verdict)
    often = f", most often where {_said(telling[0], world, is_counted)}" if telling else ""
    return f"in most places{often}" if hits > len(table) / 2 else f"here and there{often}"


def _mostly(table: pd.DataFrame, verdict: str, most_named: int) -> list[Level]:
    """Telling levels at most of whose places the verdict falls."""
    return [level for level in _telling(table, verdict) if level.share > 0.5][:most_named]


def _telling(table: pd.DataFrame, verdict: str) -> list[Level]:
    """Levels where the verdict falls oftener than at some other level of the factor, the most frequent first."""
    found = levels(table, verdict)
    least = {factor: min(level.share for level in found if level.factor == factor) for factor, *_ in found}
    return sorted((level for level in found if level.share > least[level.factor]), key=lambda level: -level.share)


def _said(level: Level, world: WorldConfig, is_counted: bool) -> str:
    words = factor_words(level.factor, level.value, world)
    return f"{words} ({level.num_verdicts} of {level.num_places} places)" if is_counted else words


def factor_words(factor: str, value: float, world: WorldConfig) -> str:
    """Say that a factor has a value."""
    if factor == "num_objects":
        return f"{value:g} objects stand on the table"
    if factor == "occlusion":
        return f"{_percent(value)} of an object is hidden on average"
    if factor == "label_gain":
        return f"a label in full view is right {_percent(float(assumed_laws(world)[1].floor) + value)} of the time"
    if factor == "reward_wash_clean":
        return f"washing a clean cup costs {_times(-value / float(world.reward_wash_dirty))}what a dirty one earns"
    return f"grip offsets spread by {value:g}"


def _times(ratio: float) -> str:
    return "" if ratio == 1 else {2.0: "twice ", 0.5: "half "}.get(ratio, f"{ratio:.3g} times ")


def _percent(share: float) -> str:
    return f"{100 * share:.3g} %"
