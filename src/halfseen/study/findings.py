"""What the tables of the study say, as numbers that sentences and titles are made of."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from halfseen.errors import ArgumentError
from halfseen.study.design import StudyDesign

LEARNED = "cql"
Z_95 = 1.96
WEIGHTED = "weighted"


class Estimate(NamedTuple):
    """A mean and its standard error."""

    mean: float
    se: float

    @property
    def low(self) -> float:
        """Lower end of the 95 % interval."""
        return self.mean - Z_95 * self.se

    @property
    def high(self) -> float:
        """Upper end of the 95 % interval."""
        return self.mean + Z_95 * self.se

    @property
    def sign(self) -> int:
        """1 or −1 where the 95 % interval lies above or below 0, else 0."""
        return int(self.low > 0) - int(self.high < 0)


@dataclass(frozen=True)
class Purchase:
    """What weighting by 1/Ĝ buys against another treatment of cut paths, at one place of the design.

    Parameters
    ----------
    treatment
        The other treatment.
    cut_kind
        Of the cuts.
    gain
        Paired difference of mean reward, weighted − other.
    """

    treatment: str
    cut_kind: str
    gain: Estimate


def learned_curve(figure1: pd.DataFrame, cut_share: float) -> pd.DataFrame:
    """Rows of the learned policy at one share of cut paths, smallest log first."""
    rows = figure1[figure1["policy"] == LEARNED]
    is_asked = np.isclose(np.asarray(rows["cut_share"], dtype=float), cut_share)
    return pd.DataFrame(rows[is_asked]).sort_values(by="num_paths")


def learned(figure1: pd.DataFrame, num_paths: int, cut_share: float) -> Estimate:
    """Mean reward of the learned policy at one place of the design.

    Raises
    ------
    ArgumentError
        The study did not go there.
    """
    curve = learned_curve(figure1, cut_share)
    rows = curve[curve["num_paths"] == num_paths]
    if rows.empty:
        raise ArgumentError(
            f"no learned policy from {num_paths} paths at a cut share of {cut_share:.3g}; "
            f"add it to num_paths and cut_shares of the design, or compare another"
        )
    return _estimate(rows.iloc[0])


def baseline(figure1: pd.DataFrame, name: str) -> Estimate:
    """Mean reward of a baseline.

    Raises
    ------
    ArgumentError
        There is no such baseline.
    """
    rows = figure1[figure1["policy"] == name]
    if rows.empty:
        raise ArgumentError(f"no baseline {name!r}; there are {', '.join(sorted(set(figure1['policy'])))}")
    return _estimate(rows.iloc[0])


def sufficient_paths(figure1: pd.DataFrame, cut_share: float, rival: str) -> int | None:
    """Smallest log from which on the learned policy beats a baseline; None if even the largest does not do.

    To beat means that the two 95 % bands do not touch, at this size and at every larger one.
    """
    bound = baseline(figure1, rival).high
    sufficient = None
    for _, row in learned_curve(figure1, cut_share)[::-1].iterrows():
        if not _estimate(row).low > bound:
            break
        sufficient = int(row["num_paths"])
    return sufficient


def comparison(table1: pd.DataFrame, rival: str, measure: str) -> dict[str, Any] | None:
    """Row of Table 1 as a dictionary; None if this was not tested."""
    rows = table1[(table1["baseline"] == rival) & (table1["measure"] == measure)]
    return None if rows.empty else {str(name): value for name, value in rows.iloc[0].items()}


def compared_num_paths(figure4: pd.DataFrame, design: StudyDesign) -> int:
    """Size of log at which the treatments are compared in words: that of Table 1, or else the largest."""
    sizes = [int(size) for size in figure4["num_paths"]]
    return design.table_num_paths if design.table_num_paths in sizes else max(sizes)


def purchases(figure4: pd.DataFrame, num_paths: int) -> list[Purchase]:
    """What weights buy at one size of log against every other treatment, one kind of cut after the other."""
    rows = figure4[(figure4["num_paths"] == num_paths) & (figure4["treatment"] != WEIGHTED)]
    found = [
        Purchase(
            str(row["treatment"]),
            str(row["cut_kind"]),
            Estimate(float(row["behind_weighted"]), float(row["se_behind"])),
        )
        for _, row in rows.iterrows()
    ]
    kinds = list(dict.fromkeys(bought.cut_kind for bought in found))
    return sorted(found, key=lambda bought: kinds.index(bought.cut_kind))


def _estimate(row: pd.Series) -> Estimate:
    return Estimate(float(row["mean_reward"]), float(row["se"]))
