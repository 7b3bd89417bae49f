"""The default treatment of cut trajectories in linear eq. 3 compared with other treatments: Figure 4.

All learn without laws: treatments concern eq. 3, and laws fitted under censoring would mask their effect.
"""

from dataclasses import dataclass
from typing import Any, ClassVar

import pandas as pd

from halfseen.errors import ArgumentError
from halfseen.study.compare import grouped, means, records, verdict_of, wide
from halfseen.study.experiment import Experiment, Piece, Pieces, Tables
from halfseen.study.pipeline import TREATMENTS, Source
from halfseen.study.setting import Setting
from halfseen.world.cuts import CutKind

DEFAULT = TREATMENTS[0]
BEHIND = ("behind_default", "se_behind", "behind_low", "behind_high")


@dataclass(frozen=True)
class Censoring(Experiment):
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

    def prepare(self, setting: Setting) -> Piece:
        """Calibrate the cuts."""
        return {"rates": {kind: Source.of(setting).cut_rate(self.cut_share, kind) for kind in self.cut_kinds}}

    def repeat(self, setting: Setting, prepared: Piece, index: int) -> Piece:
        """Learn from a fresh log under every treatment, and play all on the same fresh episodes."""
        source = Source.of(setting, index)
        episodes = source.play(max(self.num_trajectories))
        cuts = {kind: source.cut(episodes, prepared["rates"][kind], kind) for kind in self.cut_kinds}
        arms = [(kind, treatment) for kind in self.cut_kinds for treatment in TREATMENTS]
        logs = [(cuts[kind], treatment) for kind, treatment in arms]
        learned = source.logged(episodes, laws=False).learn(logs, self.num_trajectories)
        played = source.evaluate_each([one.policy for one in learned], self.episodes_per_scene * len(setting.scenes))
        cells = [
            {"treatment": treatment, "cut_kind": kind, "num_trajectories": size}
            for size in self.num_trajectories
            for kind, treatment in arms
        ]
        return {"rows": [cell | each.means() for cell, each in zip(cells, played, strict=True)]}

    def tabulate(self, setting: Setting, pieces: Pieces) -> Tables:
        """Make figure4.

        Its columns are treatment, cut_kind, num_trajectories, cut_share, repetitions, mean_reward, se, low, high; and
        behind_default, se_behind, behind_low, behind_high: the paired mean difference (default − this treatment).
        """
        reward = wide(pieces.rows, ["treatment", "cut_kind", "num_trajectories"], "reward")
        default = reward.loc[DEFAULT].reindex(reward.index.droplevel("treatment")).to_numpy()
        said = reward[[]].assign(cut_share=self.cut_share, repetitions=len(pieces.repetitions))
        return {"figure4": pd.concat([said, means(reward), means(default - reward, BEHIND)], axis=1).reset_index()}

    def facts(self, setting: Setting, tables: Tables) -> dict[str, Any]:
        """Comparisons at one size of log, by kind of cut, and the kinds in which all verdicts are alike."""
        rows = records(tables["figure4"], num_trajectories=self.compared_num_trajectories)
        found = [
            row | {"verdict": verdict_of(row, (BEHIND[0], *BEHIND[2:]))} for row in rows if row["treatment"] != DEFAULT
        ]
        compared = grouped(found, lambda row: row["cut_kind"])
        alike = grouped(compared, lambda kind: str([row["verdict"] for row in compared[kind]]))
        return {"compared": compared, "alike": list(alike.values()), "kinds": [{"cut_kind": kind} for kind in compared]}
