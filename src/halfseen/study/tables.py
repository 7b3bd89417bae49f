"""From the pieces of the study to its tables."""

from collections.abc import Mapping, Sequence
from typing import Any, cast

import numpy as np
import pandas as pd
from jaxtyping import Float

from halfseen.study.design import StudyDesign
from halfseen.study.findings import LEARNED
from halfseen.study.policies import HEURISTICS
from halfseen.study.results import MEASURES
from halfseen.study.statistics import holm, mean_and_error, paired_test


def learned_frame(pieces: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """One row for each learned policy of each repetition."""
    return pd.DataFrame([{"repetition": piece["repetition"]} | row for piece in pieces for row in piece["learned"]])


def baseline_frame(pieces: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """One row for each baseline and repetition."""
    return pd.DataFrame(
        [
            {"repetition": piece["repetition"], "policy": name} | means
            for piece in pieces
            for name, means in piece["baselines"].items()
        ]
    )


def figure1(
    learned: pd.DataFrame, baselines: pd.DataFrame, figure2: pd.DataFrame, strongest_planners: Mapping[str, str]
) -> pd.DataFrame:
    """Mean reward of every policy: policy, num_paths, cut_share, repetitions, mean_reward, se.

    Of the planners, the strongest, as Figure 2 has them.
    """
    rows = []
    shown = learned[learned["cut_kind"] == "independent"]
    for key, group in shown.groupby(["treatment", "cut_share", "num_paths"], sort=False):
        treatment, share, num_paths = cast(tuple[str, float, int], key)
        name = LEARNED if treatment == "weighted" else f"{LEARNED}-{treatment}"
        rows.append((name, num_paths, share, len(group), *mean_and_error(np.asarray(group["reward"]))))
    for name, group in baselines.groupby("policy", sort=False):
        rows.append((name, None, None, len(group), *mean_and_error(group["reward"].to_numpy())))
    of_planner = figure2.set_index("policy")[["repetitions", "mean_reward", "se"]]
    rows += [(name, None, None, *of_planner.loc[planner]) for name, planner in strongest_planners.items()]
    columns = ["policy", "num_paths", "cut_share", "repetitions", "mean_reward", "se"]
    table = pd.DataFrame(rows, columns=pd.Index(columns))
    return table.astype({"num_paths": "Int64", "cut_share": "Float64", "repetitions": int})


def figure4(learned: pd.DataFrame, design: StudyDesign) -> pd.DataFrame:
    """Mean reward of each treatment, and how far it stays behind weighting, repetition by repetition."""
    rows = []
    at_share = learned[learned["cut_share"] == design.treatment_cut_share]
    for key, group in at_share.groupby(["cut_kind", "num_paths"], sort=False):
        kind, num_paths = cast(tuple[str, int], key)
        reward = group.pivot(index="repetition", columns="treatment", values="reward")
        for treatment in dict.fromkeys(group["treatment"]):
            behind = mean_and_error((reward["weighted"] - reward[treatment]).to_numpy())
            mean = mean_and_error(reward[treatment].to_numpy())
            rows.append((treatment, kind, num_paths, design.treatment_cut_share, len(reward), *mean, *behind))
    columns = ["treatment", "cut_kind", "num_paths", "cut_share", "repetitions", "mean_reward", "se"]
    return pd.DataFrame(rows, columns=pd.Index([*columns, "behind_weighted", "se_behind"]))


def weights(learned: pd.DataFrame) -> pd.DataFrame:
    """Mean effective sample size and largest weight of the weighted fits under independent cuts."""
    shown = learned[(learned["cut_kind"] == "independent") & (learned["treatment"] == "weighted")]
    columns = ["effective_sample_size", "largest_weight"]
    return shown.groupby(["num_paths", "cut_share"], sort=False)[columns].mean().reset_index()


def strongest(baselines: pd.DataFrame, names: Sequence[str]) -> str:
    """The baseline with the largest mean reward; the first of equals."""
    means = baselines.groupby("policy")["reward"].mean()
    return max(names, key=lambda name: means[name])


def table1(
    learned: pd.DataFrame,
    baselines: pd.DataFrame,
    times_ms: Mapping[str, Float[np.ndarray, " S"]],
    against_planners: pd.DataFrame,
    design: StudyDesign,
) -> pd.DataFrame:
    """Test the learned policy against the strongest planners and each heuristic, on every measure.

    The rows against planners come from `halfseen.study.planning_table.planner_rows`.
    """
    ours = _replicates(_headline(learned, design)) | {"decision_ms": np.asarray(times_ms[LEARNED])}
    rows = []
    for baseline in HEURISTICS:
        other = _replicates(baselines.loc[baselines["policy"] == baseline])
        other["decision_ms"] = np.asarray(times_ms[baseline])
        for measure in MEASURES:
            test = paired_test(ours[measure], other[measure], is_more_better=measure == "reward")
            means = float(np.mean(ours[measure])), float(np.mean(other[measure]))
            rows.append((baseline, measure, *means, test.p_value, test.effect, test.effect_low, test.effect_high))
    columns = ["baseline", "measure", "cql", "other", "p_value", "effect", "effect_low", "effect_high"]
    table = pd.concat([against_planners, pd.DataFrame(rows, columns=pd.Index(columns))], ignore_index=True)
    table["p_holm"] = holm(table["p_value"].to_numpy())
    table["supported"] = table["p_holm"] < design.alpha
    return table.loc[:, [*columns[:5], "p_holm", "effect", "supported", "effect_low", "effect_high"]]


def _headline(learned: pd.DataFrame, design: StudyDesign) -> pd.DataFrame:
    return learned.loc[
        (learned["treatment"] == "weighted")
        & (learned["cut_kind"] == "independent")
        & (learned["num_paths"] == design.table_num_paths)
        & (learned["cut_share"] == design.table_cut_share)
    ]


def _replicates(rows: pd.DataFrame) -> dict[str, Float[np.ndarray, " R"]]:
    ordered = rows.sort_values("repetition")
    return {measure: ordered[measure].to_numpy() for measure in ("reward", "robot_s")}
