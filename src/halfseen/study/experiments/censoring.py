"""The default treatment of cut trajectories in linear eq. 3 compared with other treatments: Figure 4.

All learn without laws: treatments concern eq. 3, and laws fitted under censoring would mask their effect.
"""

from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import pandas as pd
from matplotlib.figure import Figure

from halfseen import figures as pages
from halfseen.errors import ArgumentError
from halfseen.figures import BLUE, ORANGE, PINK, RED, SKY
from halfseen.study import figures
from halfseen.study.compare import estimate_in, estimated_in, learned_from, mean_columns, records, stacked, where
from halfseen.study.experiment import CUT_KIND_NAMES, Drawing, Listing, PieceOf, Pieces, Section, Tables, words
from halfseen.study.pipeline import TREATMENTS, Source
from halfseen.study.setting import Setting
from halfseen.wording import MISSING, NOT_SUPPORTED, SUPPORTED, Claim, amount, capitalised, interval, listed
from halfseen.world.cuts import CutKind

DEFAULT = TREATMENTS[0]
TREATMENT_NAMES = {
    "imputed": "imputed (default)",
    "weighted": "weighted by 1/Ĝ",
    "unweighted": "completed stages, no weights",
    "dropped": "cut trajectories dropped",
    "failures": "cuts counted as failures",
}
RIVALS = {
    "weighted": "weighting by 1/Ĝ",
    "unweighted": "using completed stages without weights",
    "dropped": "dropping cut trajectories",
    "failures": "counting cuts as failures",
}
TREATMENT_COLOURS = {"imputed": BLUE, "weighted": SKY, "unweighted": ORANGE, "dropped": RED, "failures": PINK}
LOOKS = figures.looks(TREATMENT_COLOURS, TREATMENT_NAMES)
CUT_KIND_NOTES = {
    "independent": "cuts that do not depend on the table",
    "occlusion": "cuts whose hazard grows with occlusion",
    "attempt": "cuts whose hazard grows with the length of an attempt",
}
BEHIND = ("behind_default", "se_behind", "behind_low", "behind_high")
GAIN = ["behind_default", "behind_low", "behind_high"]
DODGE, BAR_DODGE = 1.02, 1.10


@dataclass(frozen=True)
class Censoring:
    """Five treatments of the same cut trajectories: `cut_share` of each log are cut, by each kind of cut.

    The text compares treatments at `compared_num_trajectories`.
    """

    num_trajectories: tuple[int, ...] = (50, 200, 800)
    cut_share: float = 1 / 2
    cut_kinds: tuple[CutKind, ...] = ("independent", "attempt")
    compared_num_trajectories: int = 800
    episodes_per_scene: int = 5
    most_repetitions: int | None = None
    name: ClassVar[str] = "censoring"

    def __post_init__(self) -> None:
        if self.compared_num_trajectories not in self.num_trajectories:
            raise ArgumentError(
                f"compared_num_trajectories is {self.compared_num_trajectories}; give one of num_trajectories, "
                f"{self.num_trajectories}"
            )

    def prepare(self, setting: Setting) -> PieceOf:
        """Calibrate the cuts."""
        return {"rates": {kind: Source.of(setting).cut_rate(self.cut_share, kind) for kind in self.cut_kinds}}

    def repeat(self, setting: Setting, prepared: PieceOf, index: int) -> PieceOf:
        """Learn from a fresh log under every treatment, and play all on the same fresh episodes."""
        source = Source.of(setting, index)
        episodes = source.play(max(self.num_trajectories))
        cuts = {kind: source.cut(episodes, prepared["rates"][kind], kind) for kind in self.cut_kinds}
        arms = [(kind, treatment) for kind in self.cut_kinds for treatment in TREATMENTS]
        logs = [(cuts[kind], treatment) for kind, treatment in arms]
        learned = source.logged(episodes, laws=False).learn(logs, self.num_trajectories)
        policies = [one.policy for one in learned]
        played = source.evaluate_each(policies, self.episodes_per_scene * len(setting.scenes))
        rows = [
            {"treatment": treatment, "cut_kind": kind, "num_trajectories": size}
            for size in self.num_trajectories
            for kind, treatment in arms
        ]
        return {"index": index, "learned": [row | each.means() for row, each in zip(rows, played, strict=True)]}

    def tabulate(self, setting: Setting, pieces: Pieces) -> Tables:
        """Make figure4.

        Its columns are treatment, cut_kind, num_trajectories, cut_share, repetitions, mean_reward, se, low, high; and
        behind_default, se_behind, behind_low, behind_high: the paired mean difference (default − this treatment).
        """
        found = stacked(pieces.repetitions, "learned", "reward")
        default = {(row["cut_kind"], row["num_trajectories"]): row for row in found if row["treatment"] == DEFAULT}
        rows = []
        for row in found:
            at: dict[str, Any] = {name: row[name] for name in ("treatment", "cut_kind", "num_trajectories")}
            at |= {"cut_share": self.cut_share, "repetitions": len(pieces.repetitions)}
            gain = default[row["cut_kind"], row["num_trajectories"]]["reward"] - row["reward"]
            behind = mean_columns(gain, BEHIND)
            rows.append(at | mean_columns(row["reward"]) | behind)
        return {"figure4": pd.DataFrame(rows)}

    def section(self, setting: Setting, tables: Tables) -> Section:
        """Report the gain of the default."""
        figure4 = tables["figure4"]
        claims = claims_of(self, figure4)
        others = figure4[figure4["treatment"] != DEFAULT]
        caption = words(self.name, "caption", design=self, others=others)
        drawing = Drawing("figure4", "Figure 4", _title(self, claims), caption, partial(_draw, self, figure4))
        return Section("Treatments of cut trajectories", (_sentence(self, claims),), (drawing,), (_numbers(figure4),))


Claims = dict[CutKind, list[Claim]]


def claims_of(design: Censoring, figure4: pd.DataFrame) -> Claims:
    """Claims that the default earns more than each other treatment, at one size of log, by kind of cut."""
    claims: Claims = {kind: [] for kind in design.cut_kinds}
    for row in records(figure4, num_trajectories=design.compared_num_trajectories):
        if row["treatment"] in RIVALS:
            gain = estimate_in(row, "behind_default", "se_behind", int(row["repetitions"]))
            rival = RIVALS[row["treatment"]]
            claims[row["cut_kind"]].append(Claim("Imputing", "earns more than", "earns less than", rival, gain))
    return claims


def _title(design: Censoring, claims: Claims) -> str:
    kinds: dict[str, list[str]] = {}
    for kind, of_kind in claims.items():
        verbs = {SUPPORTED: "earns more than", NOT_SUPPORTED: "less than"}
        rivals = {verdict: [each.rival for each in of_kind if each.verdict == verdict] for verdict in verbs}
        said = [f"{verb} {listed(rivals[verdict])}" for verdict, verb in verbs.items() if rivals[verdict]]
        kinds.setdefault(" but ".join(said) or "makes no significant difference", []).append(CUT_KIND_NAMES[kind])
    parts = (f"{said} under {listed(names)}" for said, names in kinds.items())
    return f"From {design.compared_num_trajectories} trajectories, imputing cut stages {'; it '.join(parts)}"


def _sentence(design: Censoring, claims: Claims) -> str:
    parts = []
    for kind, of_kind in claims.items():
        gains = [f"{amount(each.gain.value)}, {interval(each.gain.low, each.gain.high)}" for each in of_kind]
        said = (f"than {each.rival}: {each.verdict} ({gain})" for each, gain in zip(of_kind, gains, strict=True))
        parts.append(f"under {CUT_KIND_NAMES[kind]}, {'; '.join(said)}")
    learned = learned_from(design.compared_num_trajectories, design.cut_share)
    start = f"By linear eq. 3 without laws, a policy {learned} earns more by imputing cut stages"
    return f"{start} – {'; and '.join(parts)} (paired differences with 95 % intervals, not adjusted)."


def _draw(design: Censoring, figure4: pd.DataFrame, title: str) -> Figure:
    """Reward of each treatment above, gains of the default below; a column for each kind of cut."""
    num, sizes = len(design.cut_kinds), design.num_trajectories
    place = {"left": 0.065, "right": 0.985, "bottom": 0.07, "hspace": 0.36, "wspace": 0.10}
    figure, top, panels = figures.panels(title, (0.9 + 4.0 * num, 7.2), (2, num), 0.2, (True, "row"), **place)
    above = {name: look | {"zorder": 3.0 if name == DEFAULT else 2.5} for name, look in LOOKS.items()}
    others: Any = {name: look for name, look in above.items() if name != DEFAULT}
    for (upper, lower), kind in zip(panels.T, design.cut_kinds, strict=True):
        rows, by = where(figure4, cut_kind=kind), ("treatment", "num_trajectories")
        figures.draw_series(upper, rows, by, above, figures.INTERVAL, DODGE, pages.draw_curve)
        pages.draw_zero(lower)
        figures.draw_series(lower, rows, by, others, GAIN, BAR_DODGE)
        pages.write_above(upper, capitalised(CUT_KIND_NAMES[kind]), 45.0)
        pages.write_above(upper, CUT_KIND_NOTES[kind], 31.0, "normal")
        figures.name_panel(upper, figures.REWARD_AXIS)
        figures.name_panel(lower, "gain of the default over each other treatment", figures.TRAJECTORIES_AXIS)
        upper.tick_params(labelbottom=True)
        for axes in (upper, lower):
            pages.mark_sizes(axes, sizes)
    pages.write_legend(figure, pages.named_curves(panels[0, 0]), top - 0.008, ncols=3)
    return figure


def _numbers(figure4: pd.DataFrame) -> Listing:
    cells = {
        "cuts": lambda row: CUT_KIND_NAMES[row["cut_kind"]],
        "treatment": lambda row: TREATMENT_NAMES[row["treatment"]],
        "logged trajectories": lambda row: str(row["num_trajectories"]),
        "reward": lambda row: estimated_in(row, figures.INTERVAL),
        "default − this": lambda row: MISSING if row["treatment"] == DEFAULT else estimated_in(row, GAIN),
    }
    return Listing.of("The numbers of Figure 4", "", records(figure4), cells)
