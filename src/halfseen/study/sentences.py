"""The answer in words, computed from the numbers: three sentences, and a title for each figure."""

from itertools import groupby

import pandas as pd

from halfseen.study.design import StudyDesign
from halfseen.study.findings import (
    Z_95,
    Estimate,
    Purchase,
    baseline,
    compared_num_paths,
    comparison,
    learned,
    purchases,
    sufficient_paths,
)
from halfseen.study.results import BASELINE_NAMES
from halfseen.study.wording import CUT_KIND_NAMES, amount, interval, listed, share_in_words

OTHER_TREATMENTS = {
    "unweighted": "using completed stages without weights",
    "dropped": "dropping cut paths",
    "failures": "counting cuts as failures",
}
SHORT_TREATMENTS = {"unweighted": "no weights", "dropped": "dropping", "failures": "counting failures"}
_DIGIT = 0.005


def plain_sentences(
    figure1: pd.DataFrame,
    table1: pd.DataFrame,
    figure4: pd.DataFrame,
    design: StudyDesign,
    best_planner: str,
    best_heuristic: str,
) -> tuple[str, str, str]:
    """Answer the study's question in three sentences.

    Parameters
    ----------
    figure1, table1, figure4
        Tables of `halfseen.study.results.StudyResults`.
    design
        What was done.
    best_planner, best_heuristic
        The baselines that the learned policy is held against.

    Returns
    -------
    tuple of str
        Whether the learned policy earns more; how few logged paths suffice; what the weights buy.
    """
    return (
        _who_earns_more(figure1, table1, design, best_planner, best_heuristic),
        _how_few_paths(figure1, design, best_heuristic),
        _what_weights_buy(figure4, design),
    )


def figure1_title(figure1: pd.DataFrame, table1: pd.DataFrame, design: StudyDesign, rivals: tuple[str, str]) -> str:
    """Say in one sentence what Figure 1 shows; `rivals` are the best planner and the best heuristic."""
    planner, heuristic = rivals
    gap, _ = _gap(figure1, table1, design, planner)
    standing = {1: "earns more than", 0: "is not told apart from", -1: "earns less than"}[gap.sign]
    cut = f"{share_in_words(design.table_cut_share)} of them cut"
    return f"{_beats(figure1, design, heuristic)}; from {design.table_num_paths}, {cut}, it {standing} the best planner"


def figure4_title(figure4: pd.DataFrame, design: StudyDesign) -> str:
    """Say in one sentence what Figure 4 shows."""
    num_paths = compared_num_paths(figure4, design)
    found = purchases(figure4, num_paths)
    if all(bought.gain.sign == 0 for bought in found):
        kinds = [f"under {CUT_KIND_NAMES[kind]}" for kind in dict.fromkeys(bought.cut_kind for bought in found)]
        return f"From {num_paths} paths, weights buy nothing beyond noise, {listed(kinds, 'or')}"
    parts = []
    for kind, group in groupby(found, key=lambda bought: bought.cut_kind):
        bought = list(group)
        won = [SHORT_TREATMENTS[each.treatment] for each in bought if each.gain.sign > 0]
        lost = [SHORT_TREATMENTS[each.treatment] for each in bought if each.gain.sign < 0]
        said = [f"beat {listed(won)}"] if won else []
        said += [f"lose to {listed(lost)}"] if lost else []
        parts.append(f"{' but '.join(said) or 'buy nothing beyond noise'} under {CUT_KIND_NAMES[kind]}")
    return f"From {num_paths} paths, weights {', and '.join(parts)}"


def _who_earns_more(
    figure1: pd.DataFrame, table1: pd.DataFrame, design: StudyDesign, planner: str, heuristic: str
) -> str:
    own = learned(figure1, design.table_num_paths, design.table_cut_share)
    return (
        f"Learned from {design.table_num_paths} logged paths{_of_which_cut(design.table_cut_share)}, the policy earns "
        f"{amount(own.mean)} a path (95 % interval {interval(own.low, own.high)}): "
        f"{_against(figure1, table1, design, heuristic, 'best heuristic')}, and "
        f"{_against(figure1, table1, design, planner, 'best planner, which knows the true model')} "
        f"(one-sided paired tests at level {design.alpha:g} after Holm's adjustment)."
    )


def _against(figure1: pd.DataFrame, table1: pd.DataFrame, design: StudyDesign, rival: str, role: str) -> str:
    gap, is_supported = _gap(figure1, table1, design, rival)
    if is_supported is None:
        verdict = "which was not tested"
    elif is_supported:
        verdict = "a lead that the test supports"
    elif gap.sign == 0:
        noise = "" if abs(gap.mean) < _DIGIT else "a difference within noise, "
        verdict = f"{noise}so that a lead is not supported"
    else:
        verdict = "a lead that the test does not support" if gap.mean > 0 else "so that a lead is not supported"
    name, reward = BASELINE_NAMES.get(rival, rival), amount(baseline(figure1, rival).mean)
    return f"{_difference(gap.mean)} the {role} ({name}, {reward}), {verdict}"


def _difference(gap: float) -> str:
    if abs(gap) < _DIGIT:
        return "as much as"
    return f"{amount(abs(gap))} {'more' if gap > 0 else 'less'} than"


def _gap(figure1: pd.DataFrame, table1: pd.DataFrame, design: StudyDesign, rival: str) -> tuple[Estimate, bool | None]:
    """Learned − rival: the paired difference of Table 1 and its verdict, or else the unpaired one without a verdict."""
    row = comparison(table1, rival, "reward")
    if row is None:
        own, other = learned(figure1, design.table_num_paths, design.table_cut_share), baseline(figure1, rival)
        return Estimate(own.mean - other.mean, (own.se**2 + other.se**2) ** 0.5), None
    effect, low, high = (float(row[name]) for name in ("effect", "effect_low", "effect_high"))
    return Estimate(effect, (high - low) / (2 * Z_95)), bool(row["supported"])


def _how_few_paths(figure1: pd.DataFrame, design: StudyDesign, heuristic: str) -> str:
    found = {cut_share: sufficient_paths(figure1, cut_share, heuristic) for cut_share in design.cut_shares}
    beat = "the best heuristic with both 95 % bands apart"
    sizes = set(found.values())
    smallest, largest = min(design.num_paths), max(design.num_paths)
    if sizes == {None}:
        return (
            f"No log that was tried ({smallest} to {largest} paths) suffices to beat {beat}, at any share of cut paths."
        )
    if len(sizes) == 1:
        (size,) = sizes
        note = ", the smallest log that was tried," if size == smallest else ""
        most = share_in_words(max(design.cut_shares))
        return f"To beat {beat}, {size} logged paths{note} suffice at every share of cut paths, up to {most}."
    parts = []
    for size, cut_shares in groupby(found, key=lambda cut_share: found[cut_share]):
        enough = f"even {largest} logged paths do not suffice" if size is None else f"{size} logged paths suffice"
        parts.append(f"{enough} if {listed([share_in_words(each) for each in cut_shares], 'or')} of them are cut")
    return f"To beat {beat}, {listed(parts)}."


def _beats(figure1: pd.DataFrame, design: StudyDesign, heuristic: str) -> str:
    found = {cut_share: sufficient_paths(figure1, cut_share, heuristic) for cut_share in design.cut_shares}
    sizes = [size for size in found.values() if size is not None]
    if not sizes:
        return "The learned policy does not clearly beat the best heuristic"
    if len(sizes) == len(found) and len(set(sizes)) == 1:
        return f"The learned policy beats the best heuristic from {sizes[0]} logged paths on, whatever share was cut"
    if len(sizes) == len(found):
        return (
            f"The learned policy beats the best heuristic from {min(sizes)} to {max(sizes)} logged paths on, "
            f"depending on the share cut"
        )
    failed = [share_in_words(cut_share) for cut_share, size in found.items() if size is None]
    return (
        f"The learned policy beats the best heuristic from {min(sizes)} logged paths on, "
        f"but not clearly where {listed(failed, 'or')} were cut"
    )


def _of_which_cut(cut_share: float) -> str:
    return ", none of them cut" if cut_share == 0 else f" of which about {share_in_words(cut_share)} were cut"


def _what_weights_buy(figure4: pd.DataFrame, design: StudyDesign) -> str:
    num_paths = compared_num_paths(figure4, design)
    grouped = groupby(purchases(figure4, num_paths), key=lambda bought: bought.cut_kind)
    parts = [f"under {CUT_KIND_NAMES[kind]} {_bought(list(group))}" for kind, group in grouped]
    at = f"Learned from {num_paths} logged paths{_of_which_cut(design.treatment_cut_share)}"
    return f"{at}, weighting by 1/Ĝ buys {'; '.join(parts)} (paired differences of reward with 95 % intervals)."


def _bought(group: list[Purchase]) -> str:
    noise = [OTHER_TREATMENTS[bought.treatment] for bought in group if bought.gain.sign == 0]
    if len(noise) == len(group) > 1:
        return "nothing beyond noise over any other treatment of the cut paths"
    said = [f"{_priced(bought.gain)} {OTHER_TREATMENTS[bought.treatment]}" for bought in group if bought.gain.sign]
    if noise:
        said.append(f"nothing beyond noise over {listed(noise, 'or')}")
    return listed(said)


def _priced(gain: Estimate) -> str:
    if gain.sign > 0:
        return f"{amount(gain.mean)} ({interval(gain.low, gain.high)}) over"
    return f"a loss of {amount(-gain.mean)} ({interval(-gain.high, -gain.low)}) against"
