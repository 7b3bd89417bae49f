"""The map of the gain of learning over the best heuristic, by clutter and world: Figure 6, with its text."""

from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar, NamedTuple

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import BoundaryNorm
from matplotlib.figure import Figure

from halfseen.figures import GAINS, INK, WIDTH_INCHES, write_above, write_title
from halfseen.study.compare import learned_from, records, three, where
from halfseen.study.experiment import Drawing, Listing, Section, Tables, words
from halfseen.study.experiments import clutter_places as places
from halfseen.study.experiments.clutter_places import FACTORS, ClutterDesign, Place, label_number, label_share
from halfseen.study.policies import HEURISTICS, LEARNED, by_name
from halfseen.study.setting import Setting
from halfseen.wording import MISSING, amount, estimated
from halfseen.world.config import WorldConfig

ROW_INCHES, HEAD_INCHES, FOOT_INCHES = 1.42, 0.75, 1.25
GAP = 0.28  # between the two blocks, in widths of a panel
STEPS = np.array([-0.25, -0.15, -0.10, -0.05, 0.0, 0.05, 0.10, 0.15, 0.25])
"""Bounds of the colours, as distances from the worthwhile share."""
DARK = 0.15  # distance from which a field is so dark that its number is written in white
MARKS = {places.LEARN: "▲", places.UNDECIDED: "?", places.ENOUGH: "", places.NO_SCALE: ""}
LABEL_NAMES = {"gain": "labels", "facing": "shown"}
LABEL_HEADS = {"gain": "share of right labels", "facing": "surface that a look shows"}
SMALL = 8.0
NORM = BoundaryNorm(STEPS, GAINS.N, extend="both")
FEWEST = 3  # with fewer places with a verdict, no factor is reported
LABEL_WORDS = {"gain": "how often a label is right in full view", "facing": "the surface that one look shows"}


@dataclass(frozen=True)
class Clutter(ClutterDesign):
    """The experiment; its parameters are those of `ClutterDesign`."""

    name: ClassVar[str] = "clutter"

    def section(self, setting: Setting, tables: Tables) -> Section:
        """Say where learning is worthwhile, and where the best heuristic is good enough."""
        table, draw = tables["map"], partial(draw_map, self, setting, tables["map"])
        labels, repetitions = LABEL_WORDS[label_number(setting.world)], table["repetitions"].iloc[0]
        caption = words(self.name, "caption", design=self, setting=setting, labels=labels, repetitions=repetitions)
        drawing = Drawing("map", "Figure 6", map_title(table, setting.world), caption, draw)
        sentence = map_sentence(table, self, setting.world)
        return Section("Where is learning worth it?", (sentence,), (drawing,), (_numbers(table),))


def _numbers(table: pd.DataFrame) -> Listing:
    rules = by_name(*HEURISTICS)
    cells = {
        "objects": lambda row: str(row["num_objects"]),
        "hidden": lambda row: amount(row["occlusion"], 1),
        "laws": lambda row: "assumed" if row["is_assumed"] else "the study’s",
        "labels": lambda row: amount(row["labels"]),
        "washing a clean one": lambda row: amount(row["reward_wash_clean"], 0),
        "grip spread": lambda row: amount(row["grip_offset_std"], 1),
        "learned": lambda row: amount(row[LEARNED.name]),
        "best heuristic": lambda row: f"{amount(row['heuristic_reward'])} ({rules[row['best_heuristic']].label})",
        "gain [%]": lambda row: estimated(*(100 * row[name] for name in three("gain_share")), decimals=0),
        "verdict": lambda row: row["verdict"],
    }
    return Listing.of("The numbers of Figure 6", "", records(table), cells)


class Level(NamedTuple):
    """Frequency of a verdict at one value of a factor."""

    factor: str
    value: float
    num_places: int
    num_verdicts: int

    @property
    def share(self) -> float:
        """Share of the places."""
        return self.num_verdicts / self.num_places


def map_title(table: pd.DataFrame, world: WorldConfig) -> str:
    """State the finding of the map in one sentence; places under the assumed laws, if any, are reported separately."""
    own, assumed = (where(table, is_assumed=is_assumed) for is_assumed in (False, True))
    pays, enough = (_where(own, verdict, world) for verdict in (places.LEARN, places.ENOUGH))
    claim = f"Learning pays {pays}; the best heuristic is good enough {enough}"
    if assumed.empty:
        return claim
    pays, enough = (_count(assumed, verdict) for verdict in (places.LEARN, places.ENOUGH))
    return f"{claim}; under the assumed laws, these are {pays} and {enough} of {len(assumed)}"


def _count(table: pd.DataFrame, verdict: str) -> int:
    return int((table["verdict"] == verdict).sum())


def map_sentence(table: pd.DataFrame, design: ClutterDesign, world: WorldConfig) -> str:
    """Say where learning is worthwhile and where the best heuristic is good enough, with the evidence."""
    bound = f"{_in_percent(design.worthwhile_share)} of what the best heuristic earns above finishing at once"
    lost = int((table["gain_share_high"] < 0).sum())
    undecided, unscaled = (_count(table, verdict) for verdict in (places.UNDECIDED, places.NO_SCALE))
    facts = {"title": map_title(table, world), "lost": lost, "undecided": undecided, "unscaled": unscaled}
    learned = learned_from(design.num_trajectories, design.cut_share)
    return words("clutter", "sentence", bound=bound, learned_from=learned, **facts)


def _where(table: pd.DataFrame, verdict: str, world: WorldConfig) -> str:
    """Say in how many places a verdict occurs, and at which values it is most frequent."""
    num = _count(table, verdict)
    if num in (0, len(table)):
        return "everywhere" if num else "nowhere"
    how_many = f"in {num} of {len(table)} places"
    level = most_telling(levels(table, verdict))
    if level is None or level.num_verdicts < FEWEST:
        return how_many
    at = factor_words(level.factor, level.value, world)
    return f"{how_many}, most often where {at} ({level.num_verdicts} of {level.num_places})"


def levels(table: pd.DataFrame, verdict: str) -> list[Level]:
    """Frequency of a verdict at each value of each factor, among places with the same other factors.

    A value is compared only where all values of its factor were tried with the other factors fixed, which avoids
    confounding between factors.
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
    """The level with the largest share, if its factor makes a difference; otherwise None."""
    least = {factor: min(level.share for level in found if level.factor == factor) for factor, *_ in found}
    return max(
        (level for level in found if level.share > least[level.factor]), key=lambda level: level.share, default=None
    )


def factor_words(factor: str, value: float, world: WorldConfig) -> str:
    """Say that a factor has a value."""
    if factor == "num_objects":
        return f"{value:g} objects stand on the table"
    if factor == "occlusion":
        return f"{_in_percent(value)} of an object is hidden on average"
    if factor == "labels":
        shown = _in_percent(label_share(value, world))
        if label_number(world) == "facing":
            return f"a look shows {shown} of the surface of an object"
        return f"a label in full view is right {shown} of the time"
    if factor == "reward_wash_clean":
        ratio = -value / float(world.reward_wash_dirty)
        return (
            f"washing a clean cup costs {'as much as' if ratio == 1 else f'{ratio:.3g} times what'} a dirty one earns"
        )
    return f"grip offsets spread by {value:.3g}"


def _in_percent(share: float) -> str:
    return f"{_percent(share)} %"


def _percent(share: float) -> str:
    return f"{100 * share:.3g}"


def draw_map(design: ClutterDesign, setting: Setting, table: pd.DataFrame, title: str) -> Figure:
    """Draw a panel for each world, with a field for each clutter."""
    columns = _columns(design, setting)
    by_labels = f"{LABEL_HEADS[label_number(setting.world)]} (down) and cost of washing a clean cup (across)"
    heads = by_labels, "spread of grip offsets" if setting.law is None else "spread of grips, and laws"
    num_rows = max(len(panels) for panels in columns)
    height = HEAD_INCHES + FOOT_INCHES + num_rows * ROW_INCHES
    figure = Figure(figsize=(WIDTH_INCHES, height))
    top, bottom = write_title(figure, title) - 0.52 / height, FOOT_INCHES / height
    widths = [1.0] * (len(columns) - 1) + [GAP, 1.0]
    grid = figure.add_gridspec(num_rows, len(widths), width_ratios=widths, hspace=0.32, wspace=0.08)
    grid.update(left=0.06, right=0.99, bottom=bottom, top=top)
    for column, panels in enumerate(columns):
        is_last = panels is columns[-1]
        is_left = column == 0 or is_last
        for row, (name, here) in enumerate(panels.items()):
            axes = figure.add_subplot(grid[row, column + is_last])
            _draw_panel(axes, table, design, here, is_left=is_left, is_lowest=row == len(panels) - 1)
            default = " (default)" if here == Place.of(setting.world) else ""
            axes.set_title(f"{name}{default}", loc="left", fontsize=SMALL, pad=3.0)
            if row == 0 and is_left:
                write_above(axes, heads[is_last], 19.0)
    _draw_scale(figure, design.worthwhile_share, height)
    return figure


def _columns(design: ClutterDesign, setting: Setting) -> list[dict[str, Place]]:
    """Worlds by title: quality of labels by cost of washing a clean cup; last, the spread of grip offsets."""
    *by_cost, last = design.panels(setting)
    name = LABEL_NAMES[label_number(setting.world)]

    def labelled(place: Place) -> str:
        shown = _percent(label_share(place.labels, setting.world))
        return f"{name} {shown} %, cost {amount(-place.reward_wash_clean, 0)}"

    spreads = {"assumed laws" if each.is_assumed else f"spread {each.grip_offset_std:.3g}": each for each in last}
    return [*({labelled(each): each for each in panels} for panels in by_cost), spreads]


def _draw_panel(
    axes: Axes, table: pd.DataFrame, design: ClutterDesign, here: Place, *, is_left: bool, is_lowest: bool
) -> None:
    """Draw one world: N upwards, occlusion to the right, and in each field the share and the verdict's mark."""
    sizes, occlusions = sorted(design.num_objects), sorted(design.occlusions)
    same = [np.isclose(table[name], getattr(here, name)) for name in FACTORS[2:]]
    is_here = np.logical_and.reduce([*same, table["is_assumed"] == here.is_assumed])
    rows = table[is_here].set_index(["num_objects", "occlusion"])
    shares = rows["gain_share"].unstack().loc[sizes, occlusions].to_numpy(dtype=float)
    verdicts = rows["verdict"].unstack().loc[sizes, occlusions].to_numpy()
    beyond = np.clip(shares - design.worthwhile_share, 1.01 * STEPS[0], 1.01 * STEPS[-1])
    axes.pcolormesh(np.ma.masked_invalid(beyond), cmap=GAINS, norm=NORM, edgecolors="white", linewidth=1.0)
    for y, x in np.ndindex(shares.shape):
        share, verdict = float(shares[y, x]), verdicts[y, x]
        number = MISSING if np.isnan(share) else amount(100 * share, 0)
        colour = "white" if abs(float(beyond[y, x])) >= DARK else INK
        look: Any = {"ha": "center", "va": "center", "fontsize": SMALL, "color": colour}
        weight = "bold" if verdict == places.LEARN else "normal"
        axes.text(x + 0.5, y + 0.5, f"{MARKS[verdict]} {number}".strip(), fontweight=weight, **look)
    axes.set_xticks(np.arange(len(occlusions)) + 0.5, [_percent(each) for each in occlusions] if is_lowest else [])
    axes.set_yticks(np.arange(len(sizes)) + 0.5, [str(n) for n in sizes] if is_left else [])
    axes.tick_params(length=0, labelsize=SMALL)
    axes.spines[:].set_visible(False)
    axes.set_xlabel("mean hidden share [%]" if is_lowest else "", fontsize=SMALL)
    axes.set_ylabel("objects N" if is_left else "", fontsize=SMALL)


def _draw_scale(figure: Figure, worthwhile_share: float, height: float) -> None:
    axes = figure.add_axes((0.06, 0.52 / height, 0.93, 0.11 / height))
    bar: Any = figure.colorbar(
        ScalarMappable(NORM, GAINS), cax=axes, orientation="horizontal", spacing="uniform", extendfrac=0.06
    )
    bar.set_ticks(STEPS, labels=[amount(100 * (step + worthwhile_share), 0) for step in STEPS])
    bar.ax.tick_params(length=2, labelsize=SMALL)
    title = "gain of the learned policy [% of what the best heuristic earns above FINISH at once]"
    bar.ax.set_title(title, loc="left", fontsize=SMALL, pad=3.0)
    bound = f"{_percent(worthwhile_share)} %"
    marks = (
        f"{MARKS[places.LEARN]} learn: the 95 % interval lies above {bound}      "
        f"{MARKS[places.UNDECIDED]} inconclusive: it covers {bound}      "
        f"no mark: the heuristic is good enough, it lies below {bound}"
    )
    figure.text(0.06, 0.12 / height, marks, fontsize=SMALL, va="bottom")
