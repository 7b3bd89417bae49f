"""What weighting by 1/Ĝ gains over other treatments of cut paths: Figure 4."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from halfseen.errors import ArgumentError
from halfseen.pages.axes import PANEL_TITLE, draw_bars, draw_curve, mark_sizes, write_title
from halfseen.pages.numbers import amount, interval, share_in_words
from halfseen.pages.palette import BLUE, INK, MARKERS, PINK, RED, SOFT
from halfseen.pages.sentences import NOT_SUPPORTED, SUPPORTED, Claim, listed
from halfseen.study.experiment import Drawing, Listing, PieceOf, Pieces, Section, Setting, Tables
from halfseen.study.frames import records, where
from halfseen.study.pipeline import TREATMENTS, Source, members
from halfseen.study.statistics import columns, estimate_in, mean_columns, over_repetitions
from halfseen.study.wording import CUT_KIND_NAMES, CUT_KIND_NOTES, PATHS_AXIS, REWARD_AXIS, learned_from
from halfseen.tables.table_policy import LinearTablePolicy
from halfseen.world.cuts import CutKind

WEIGHTED = TREATMENTS[0]
TREATMENT_NAMES = {
    "weighted": "weighted by 1/Ĝ",
    "unweighted": "completed stages, no weights",
    "dropped": "cut paths dropped",
    "failures": "cuts counted as failures",
}
RIVALS = {
    "unweighted": "using completed stages without weights",
    "dropped": "dropping cut paths",
    "failures": "counting cuts as failures",
}
TREATMENT_COLOURS = {"weighted": BLUE, "unweighted": RED, "dropped": SOFT, "failures": PINK}
GAIN_AXIS = "gain of weighting over each other treatment"
DODGE, BAR_DODGE = 1.02, 1.10


@dataclass(frozen=True)
class Censoring:
    """Four treatments of the same cut paths.

    Parameters
    ----------
    num_paths
        Sizes of the logs; within a repetition a smaller log is the beginning of a larger one.
    cut_share
        Expected proportion of cut paths.
    cut_kinds
        What cuts them.
    compared_num_paths
        Size of the log at which treatments are compared in words.
    episodes_per_scene
        Evaluation episodes of each scene in a block.
    most_repetitions
        Repetitions at most; None: as many as are asked for.
    """

    num_paths: tuple[int, ...] = (50, 200, 800)
    cut_share: float = 1 / 2
    cut_kinds: tuple[CutKind, ...] = ("independent", "attempt")
    compared_num_paths: int = 800
    episodes_per_scene: int = 5
    most_repetitions: int | None = None
    name: ClassVar[str] = "censoring"

    def __post_init__(self) -> None:
        if self.compared_num_paths not in self.num_paths:
            raise ArgumentError(
                f"compared_num_paths is {self.compared_num_paths}; it is one of num_paths, {self.num_paths}"
            )

    def prepare(self, setting: Setting) -> PieceOf:
        """Calibrate the cuts."""
        source = Source(setting.world, setting.layouts, setting.seed)
        return {"rates": {kind: source.cut_rate(self.cut_share, kind) for kind in self.cut_kinds}}

    def repeat(self, setting: Setting, prepared: PieceOf, index: int) -> PieceOf:
        """Learn from a fresh log under every treatment, and play all on the same fresh episodes."""
        source = Source(setting.world, setting.layouts, setting.seed, index)
        episodes = source.play(max(self.num_paths))
        encoded = source.encode(episodes)
        logs = {kind: source.cut(episodes, prepared["rates"][kind], kind) for kind in self.cut_kinds}
        arms = [(kind, treatment) for kind in self.cut_kinds for treatment in TREATMENTS]
        rows, policies = [], []
        for size in self.num_paths:
            policies += members(encoded.learn([(logs[kind], treatment) for kind, treatment in arms], size)[0])
            rows += [{"treatment": treatment, "cut_kind": kind, "num_paths": size} for kind, treatment in arms]
        together = LinearTablePolicy(jnp.stack([each.coefficients for each in policies]))
        played = source.evaluate_batch(together, self.episodes_per_scene * len(setting.scenes))
        return {"index": index, "learned": [row | each.means() for row, each in zip(rows, played, strict=True)]}

    def tabulate(self, setting: Setting, pieces: Pieces) -> Tables:
        """Make figure4.

        Its columns are treatment, cut_kind, num_paths, cut_share, repetitions, mean_reward, se, low, high; and
        behind_weighted, se_behind, behind_low, behind_high: the paired mean difference (weighted − this treatment).
        """
        rewards: dict[tuple[str, int, str], np.ndarray] = {}
        for place, row in enumerate(pieces.repetitions[0]["learned"]):
            of_row = [piece["learned"][place]["reward"] for piece in pieces.repetitions]
            rewards[row["cut_kind"], row["num_paths"], row["treatment"]] = np.array(of_row)
        rows = []
        for (kind, size, treatment), reward in rewards.items():
            at: dict[str, Any] = {"treatment": treatment, "cut_kind": kind, "num_paths": size}
            at |= {"cut_share": self.cut_share, "repetitions": len(reward)}
            behind = over_repetitions(rewards[kind, size, WEIGHTED] - reward)
            gap = columns(behind, "behind_weighted", "se_behind", "behind_low", "behind_high")
            rows.append(at | mean_columns(reward) | gap)
        return {"figure4": pd.DataFrame(rows)}

    def section(self, setting: Setting, tables: Tables) -> Section:
        """Say what weights gain."""
        figure4 = tables["figure4"]
        claims = claims_of(self, figure4)
        drawing = Drawing(
            "figure4", "Figure 4", _title(self, claims), _caption(self, figure4), partial(_draw, self, figure4)
        )
        return Section("What the weights gain", (_sentence(self, claims),), (drawing,), (_numbers(figure4),))


def claims_of(design: Censoring, figure4: pd.DataFrame) -> list[tuple[str, Claim]]:
    """Kind of cut and claim: that weighting earns more than each other treatment, at one size of log."""
    found = []
    for kind in design.cut_kinds:
        rows = records(figure4, num_paths=design.compared_num_paths, cut_kind=kind)
        for row in (row for row in rows if row["treatment"] != WEIGHTED):
            gain = estimate_in(row, "behind_weighted", "se_behind", int(row["repetitions"]))
            found.append(
                (kind, Claim("Weighting", "earns more than", "earns less than", RIVALS[row["treatment"]], gain))
            )
    return found


def _title(design: Censoring, claims: Sequence[tuple[str, Claim]]) -> str:
    parts = []
    for kind, group in groupby(claims, key=lambda pair: pair[0]):
        of_kind = [claim for _, claim in group]
        won = [claim.rival for claim in of_kind if claim.verdict == SUPPORTED]
        lost = [claim.rival for claim in of_kind if claim.verdict == NOT_SUPPORTED]
        said = [
            f"{verb} {listed(rivals)}" for verb, rivals in (("earns more than", won), ("less than", lost)) if rivals
        ]
        parts.append(f"under {CUT_KIND_NAMES[kind]} {' but '.join(said) or 'makes no significant difference'}")
    return f"From {design.compared_num_paths} paths, weighting by 1/Ĝ {'; '.join(parts)}"


def _sentence(design: Censoring, claims: Sequence[tuple[str, Claim]]) -> str:
    parts = []
    for kind, group in groupby(claims, key=lambda pair: pair[0]):
        of_kind = [claim for _, claim in group]
        said = [
            f"than {claim.rival}: {claim.verdict} ({amount(claim.gain.value)}, "
            f"{interval(claim.gain.low, claim.gain.high)})"
            for claim in of_kind
        ]
        parts.append(f"under {CUT_KIND_NAMES[kind]}, {'; '.join(said)}")
    start = f"A policy {learned_from(design.compared_num_paths, design.cut_share)} earns more with weights 1/Ĝ"
    return f"{start} – {'; and '.join(parts)} (paired differences with 95 % intervals, not adjusted)."


def _caption(design: Censoring, figure4: pd.DataFrame) -> str:
    others = figure4[figure4["treatment"] != WEIGHTED]
    above, below = int((others["behind_low"] > 0).sum()), int((others["behind_high"] < 0).sum())
    return (
        f"Four treatments of right-censored paths, learned from the same logs, of which "
        f"{share_in_words(design.cut_share)} of the paths are cut in expectation, and played on the same episodes; "
        f"{int(figure4['repetitions'].iloc[0])} repetitions. Above: mean reward, shaded: 95 % intervals (Student’s t). "
        "Below: paired difference, weighted − other; an interval that covers 0 shows no significant difference. Of "
        f"the {len(others)} intervals, {above} above 0 and {below} below; without any effect, about "
        f"{amount(0.05 * len(others), 1)} would miss 0. They are not adjusted for their number. The weights "
        "assume that cuts are independent of the task; under cuts that depend on it, 1/Ĝ is misspecified. A cut that "
        "counts as a failure is a failed attempt that ended its path, with the price of the dirty objects left."
    )


def _draw(design: Censoring, figure4: pd.DataFrame, title: str) -> Figure:
    """Reward of each treatment above, gains of weighting below; a column for each kind of cut."""
    figure = Figure(figsize=(0.9 + 4.0 * len(design.cut_kinds), 7.2))
    top = write_title(figure, title)
    grid = figure.add_gridspec(
        2, len(design.cut_kinds), left=0.065, right=0.985, bottom=0.07, top=top - 0.18, hspace=0.36, wspace=0.10
    )
    panels: Any = grid.subplots(sharex=True, sharey="row", squeeze=False)
    for column, kind in enumerate(design.cut_kinds):
        rows = where(figure4, cut_kind=kind)
        upper, lower = panels[0, column], panels[1, column]
        _draw_treatments(upper, rows)
        _draw_gains(lower, rows)
        _head_panel(upper, CUT_KIND_NAMES[kind], CUT_KIND_NOTES[kind])
        upper.set_title(REWARD_AXIS, **PANEL_TITLE)
        lower.set_title(GAIN_AXIS, **PANEL_TITLE)
        lower.set_xlabel(PATHS_AXIS)
        upper.tick_params(labelbottom=True)
        mark_sizes(upper, design.num_paths)
        mark_sizes(lower, design.num_paths)
    handles, names = panels[0, 0].get_legend_handles_labels()
    figure.legend(handles, names, loc="upper left", bbox_to_anchor=(0.05, top - 0.012), ncols=len(names), frameon=False)
    return figure


def _draw_treatments(axes: Axes, rows: pd.DataFrame) -> None:
    for k, treatment in enumerate(TREATMENTS):
        curve = where(rows, treatment=treatment)
        across = curve["num_paths"].to_numpy(dtype=float) * DODGE ** (k - (len(TREATMENTS) - 1) / 2)
        ends, colour = (curve["low"], curve["high"]), TREATMENT_COLOURS[treatment]
        above = 3.0 if treatment == WEIGHTED else 2.5
        name = TREATMENT_NAMES[treatment]
        draw_curve(axes, across, curve["mean_reward"], ends, color=colour, marker=MARKERS[k], label=name, zorder=above)


def _draw_gains(axes: Axes, rows: pd.DataFrame) -> None:
    axes.axhline(0.0, color=INK, linewidth=1.0, zorder=1.5)
    for k, treatment in enumerate(TREATMENTS[1:], start=1):
        curve = where(rows, treatment=treatment)
        across = curve["num_paths"].to_numpy(dtype=float) * BAR_DODGE ** (k - len(TREATMENTS) / 2)
        ends = curve["behind_low"], curve["behind_high"]
        draw_bars(axes, across, curve["behind_weighted"], ends, color=TREATMENT_COLOURS[treatment], marker=MARKERS[k])


def _head_panel(axes: Axes, name: str, note: str) -> None:
    for text, weight, height in ((f"{name[0].upper()}{name[1:]}", "bold", 45), (note, "normal", 31)):
        place: Any = {"xycoords": "axes fraction", "textcoords": "offset points", "xytext": (0.0, height)}
        axes.annotate(text, (0.0, 1.0), fontweight=weight, **place)


def _numbers(figure4: pd.DataFrame) -> Listing:
    rows = []
    for row in records(figure4):
        gain = f"{amount(row['behind_weighted'])} ({interval(row['behind_low'], row['behind_high'])})"
        rows.append(
            (
                CUT_KIND_NAMES[row["cut_kind"]],
                TREATMENT_NAMES[row["treatment"]],
                str(row["num_paths"]),
                f"{amount(row['mean_reward'])} ({interval(row['low'], row['high'])})",
                "–" if row["treatment"] == WEIGHTED else gain,
            )
        )
    header = ("cuts", "treatment", "logged paths", "reward", "weighted − this")
    return Listing("The numbers of Figure 4", "", header, {"": rows})
