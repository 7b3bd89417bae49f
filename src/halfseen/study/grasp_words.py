"""What the grasp ablation says, in one sentence and a title, computed from its tests."""

from typing import Any

import pandas as pd

from halfseen.study.design import StudyDesign
from halfseen.study.wording import amount, listed, p_value, share_in_words

SCORE = "log_loss"
"""The measure that decides on the paper's claim: it is proper, and needs no policy."""


def figure5_title(grasp_tests: pd.DataFrame) -> str:
    """Say in one sentence what Figure 5 shows."""
    supported, tested = _supported(grasp_tests), len(_of(grasp_tests, SCORE))
    if len(supported) == tested:
        return "The SVM tells the chance of a grasp better than the Beta mean"
    if supported:
        return f"The SVM tells the chance of a grasp better than the Beta mean from {_sizes(supported)} paths alone"
    return "The SVM does not tell the chance of a grasp better than the Beta mean"


def grasp_sentence(grasp_tests: pd.DataFrame, design: StudyDesign) -> str:
    """Say whether the paper's claim, that an SVM is better than the mean of a Beta, holds here."""
    supported, tested = _supported(grasp_tests), len(_of(grasp_tests, SCORE))
    if len(supported) == tested:
        verdict = "holds here"
    elif supported:
        verdict = f"holds here from {_sizes(supported)} logged paths alone"
    else:
        verdict = "does not hold here"
    largest = max(design.grasp_num_paths)
    score, reward = (_row(grasp_tests, measure, largest) for measure in (SCORE, "learned_reward"))
    return (
        f"The paper's claim that an SVM tells the chance of a grasp better than the mean of a Beta {verdict}: learned "
        f"from {largest} logged paths of which about {share_in_words(design.table_cut_share)} were cut, the SVM's "
        f"log-loss on held-out attempts is {_compared(score, 'below', 'above', 4)} the Beta's, and with it the learned "
        f"policy earns {_compared(reward, 'less than', 'more than', 2)} with the Beta "
        f"(one-sided paired tests at level {design.alpha:g} after Holm's adjustment)."
    )


def _compared(row: dict[str, Any], below: str, above: str, decimals: int) -> str:
    effect, low, high = (float(row[name]) for name in ("effect", "effect_low", "effect_high"))
    if effect > 0:
        size, interval, word = effect, (low, high), above
    else:
        size, interval, word = -effect, (-high, -low), below
    shown = f"{amount(interval[0], decimals)} to {amount(interval[1], decimals)}"
    adjusted = p_value(float(row["p_holm"]))
    p = f"p {adjusted}" if adjusted[0] in "<>" else f"p = {adjusted}"
    return f"{amount(size, decimals)} (95 % interval {shown}; {p}) {word}"


def _of(grasp_tests: pd.DataFrame, measure: str) -> pd.DataFrame:
    return pd.DataFrame(grasp_tests[grasp_tests["measure"] == measure])


def _supported(grasp_tests: pd.DataFrame) -> list[int]:
    """Sizes of log at which the claim is supported by the score."""
    rows = _of(grasp_tests, SCORE)
    return [int(size) for size in rows.loc[rows["supported"].astype(bool), "num_paths"]]


def _sizes(sizes: list[int]) -> str:
    return listed([str(size) for size in sizes])


def _row(grasp_tests: pd.DataFrame, measure: str, num_paths: int) -> dict[str, Any]:
    rows = _of(grasp_tests, measure)
    return {str(name): value for name, value in rows[rows["num_paths"] == num_paths].iloc[0].items()}
