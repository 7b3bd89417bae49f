"""What the experiment says: Figure 1, Tables 1 and 2, and who earns more."""

from functools import partial
from itertools import groupby
from typing import Any

import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from halfseen.pages.axes import EndLabel, draw_curve
from halfseen.pages.numbers import MISSING, amount, share, share_in_words, significant, with_interval
from halfseen.pages.palette import BAND_OPACITY
from halfseen.pages.sentences import Claim, capitalised, counted, listed
from halfseen.study.experiment import Drawing, Listing, Row, Section, Setting, Tables
from halfseen.study.experiments.reward.design import RewardDesign
from halfseen.study.experiments.reward.opening import opening_of
from halfseen.study.experiments.reward.peer_words import peer_listing, peer_sentence
from halfseen.study.experiments.reward.tables import BEST, MEASURES
from halfseen.study.figures import MEAN, draw_by_cut_share, draw_by_size, draw_level
from halfseen.study.frames import records, row_of, where
from halfseen.study.policies import LEARNED, STRONGEST_RULE
from halfseen.study.wording import EFFECT, REWARD_AXIS, TEST_CELLS, estimated_in, gain_in, is_reward, learned_from

STRONGEST = "the strongest heuristic", "the strongest planner"
ROLE_WORDS: dict[str, str] = dict(zip(BEST, (STRONGEST[0], f"{STRONGEST[1]}, which knows the true model"), strict=True))
CLAIM_WORDS = {"reward": "the learned policy earns more", "robot_s": "the learned policy ends sooner"}
DODGE = 1.02
"""Factor between neighbouring curves, which stand side by side rather than on one another."""


def section_of(design: RewardDesign, setting: Setting, tables: Tables) -> Section:
    """Say whether learning earns more, and how few logged paths suffice."""
    figure1, table1 = tables["figure1"], tables["table1"]
    rule, planner = (claim(design, setting, figure1, table1, role) for role in BEST)
    # One sentence for both, which names the learned policy once.
    both = f"{rule.sentence[:-1]}; it {planner.asserted} {planner.rival}: {planner.verdict} ({planner.numbers})."
    on_planner = f"it {planner.found} {STRONGEST[1]}"
    title = f"{_beats(design, figure1)}; learned from {design.table_num_paths} paths, {on_planner}"
    return Section(
        "Reward against the size of the log",
        (both, _how_few_paths(design, figure1), peer_sentence(design, tables["peer"])),
        (Drawing("figure1", "Figure 1", title, _caption(design, setting), partial(_draw, design, figure1)),),
        (
            _numbers(design, figure1),
            peer_listing(design, setting, tables["peer"]),
            _tests(design, setting, table1),
            _weights(design, tables["weights"]),
        ),
        num_leading=3,
        opening=opening_of(design, setting, figure1, rule),
    )


def claim(design: RewardDesign, setting: Setting, figure1: pd.DataFrame, table1: pd.DataFrame, role: str) -> Claim:
    """That the learned policy of Table 1 earns more than the baseline of a role, on the same episodes."""
    name = str(row_of(figure1, role=role)["policy"])
    row = row_of(table1, baseline=name, measure="reward")
    earned = f"{amount(float(row[LEARNED.name]))} against {amount(float(row['other']))} a path"
    return Claim(
        f"The policy {learned_from(design.table_num_paths, design.table_cut_share)}",
        "earns more than",
        "earns less than",
        f"{ROLE_WORDS[role]} ({design.contenders[name].label})",
        gain_in(row),
        float(row["p_holm"]),
        setting.alpha,
        f"{earned} on the same {counted(int(row['num_episodes']), 'episode')}",
    )


def _sufficient(design: RewardDesign, figure1: pd.DataFrame) -> dict[float, int | None]:
    """Proportion of cuts → the smallest log from which on the learned policy earns more than the strongest heuristic.

    At this size and at every larger one the 95 % interval of the paired difference lies above 0; None if even the
    largest log does not do.
    """
    found: dict[float, int | None] = dict.fromkeys(design.cut_shares)
    for cut_share in found:
        rows = records(figure1, policy=LEARNED.name, cut_share=cut_share)
        for row in sorted(rows, key=lambda row: -row["num_paths"]):
            if not float(row["gain_low"]) > 0:
                break
            found[cut_share] = int(row["num_paths"])
    return found


def _how_few_paths(design: RewardDesign, figure1: pd.DataFrame) -> str:
    parts = []
    found = _sufficient(design, figure1)
    for size, shares in groupby(found, key=lambda cut_share: found[cut_share]):
        enough = f"even {max(design.num_paths)} logged paths do not suffice"
        if size is not None:
            smallest = ", the smallest log that was tried," if size == min(design.num_paths) else ""
            enough = f"{size} logged paths{smallest} suffice"
        parts.append(f"{enough} where {listed([share_in_words(each) for each in shares], 'or')} of them are cut")
    return f"To earn more than the strongest heuristic, {listed(parts)} (paired differences, 95 % intervals above 0)."


def _beats(design: RewardDesign, figure1: pd.DataFrame) -> str:
    found = _sufficient(design, figure1)
    sizes = [size for size in found.values() if size is not None]
    if not sizes:
        return "The learned policy does not clearly beat the strongest heuristic"
    between = dict.fromkeys(str(size) for size in (min(sizes), max(sizes)))
    start = f"The learned policy beats the strongest heuristic from {' to '.join(between)} logged paths on"
    failed = [share_in_words(cut_share) for cut_share, size in found.items() if size is None]
    if failed:
        return f"{start}, but not clearly where {listed(failed, 'or')} were cut"
    return f"{start}, {'whatever proportion was cut' if len(set(sizes)) == 1 else 'by the proportion cut'}"


def _caption(design: RewardDesign, setting: Setting) -> str:
    few = min(design.planned_repetitions, setting.repetitions)
    planned = f"in {few} of the repetitions, " if few < setting.repetitions else ""
    return (
        f"Markers: mean reward of the policy learned by censored Q-learning, weighted by 1/Ĝ, over "
        f"{setting.repetitions} repetitions, each with a fresh log and fresh evaluation episodes that all policies "
        "share; markers of one size stand side by side for legibility. Horizontal lines: baselines, which learn "
        "nothing from logs; bold: the heuristic and the planner that were the strongest on other episodes. A planner "
        f"has so many simulations for each decision, whatever time they take, and {planned}plays some of the episodes: "
        "its line is the learned policy’s mean less their paired difference. Crosses: the planner with laws fitted to "
        "the logs that the policy is learned from, mean over the proportions of cut paths; it plays few of the "
        "episodes, and how hard these are is reckoned from what all learned policies earn on them. Shaded: 95 % "
        "intervals (Student’s t); of the lines across, for the two in bold. Cuts are independent of what happens on "
        f"the table. Logs: half of the actions are those of a heuristic ({STRONGEST_RULE.label}), half are uniformly "
        "random."
    )


def _draw(design: RewardDesign, figure1: pd.DataFrame, title: str) -> Figure:
    """Reward of the learned policy against the size of the log, with the baselines as lines."""
    return draw_by_size(title, REWARD_AXIS, design.num_paths, (1.08, 1.05), partial(_draw_lines, design, figure1))


def _draw_lines(design: RewardDesign, figure1: pd.DataFrame, axes: Axes) -> list[EndLabel]:
    """Draw the baselines, with bands for the strongest two, what was planned with fitted laws, and what was learned."""
    labels = [_draw_peer(design, figure1, axes)]
    for name in design.level_names:
        row, who = row_of(figure1, policy=name), design.contenders[name]
        is_best = row["role"] in BEST
        labels.append(draw_level(axes, who, float(row["mean_reward"]), is_best))
        if is_best:
            axes.axhspan(row["low"], row["high"], color=who.colour, alpha=BAND_OPACITY, linewidth=0, zorder=1)
    return labels + draw_by_cut_share(axes, figure1, design.cut_shares, MEAN, draw_curve, DODGE)


def _draw_peer(design: RewardDesign, figure1: pd.DataFrame, axes: Axes) -> EndLabel:
    """Draw the planner with fitted laws, the mean over the proportions of cut paths."""
    peer, rows = design.peer, where(figure1, policy=design.peer.name)
    means = pd.DataFrame(rows[rows["cut_share"].isna()])
    dashes: Any = (0, peer.dashes)
    draw_curve(axes, means["num_paths"], means[MEAN], color=peer.colour, marker="X", linestyle=dashes)
    end = float(means["mean_reward"].iloc[-1])
    return EndLabel(end, f"{peer.label}  {amount(end)}", peer.colour)


def _by_size(design: RewardDesign, table: pd.DataFrame, written: Any) -> tuple[tuple[str, ...], dict[str, Any]]:
    """Header and rows of a table of sizes by proportions of cut paths."""
    header = ("logged paths", *(f"cut: {share(cut_share)}" for cut_share in design.cut_shares))
    rows = [(str(size), *map(written, records(table, num_paths=size))) for size in design.num_paths]
    return header, {"": rows}


def _numbers(design: RewardDesign, figure1: pd.DataFrame) -> Listing:
    cells = _by_size(design, where(figure1, policy=LEARNED.name), lambda row: estimated_in(row, MEAN))
    return Listing("The numbers of the learned policy in Figure 1", "", *cells)


def _tests(design: RewardDesign, setting: Setting, table1: pd.DataFrame) -> Listing:
    num_tested = int(table1["p_holm"].notna().sum())
    caption = (
        f"The policy learned from {design.table_num_paths} paths, of which {share_in_words(design.table_cut_share)} "
        "are cut in expectation, against each baseline: one-sided Wilcoxon signed-rank tests over the repetitions, on "
        "the episodes that both played. Difference: learned − baseline, with its 95 % interval (not adjusted); of "
        f"times, below 0 is better. Holm’s procedure adjusted the {num_tested} p-values together; α = "
        f"{setting.alpha:g}. Not supported: the interval lies on the other side of 0. Decision times are medians on "
        "one core of this machine, told beside; nothing else depends on them."
    )
    headings = {
        measure: f"{capitalised(name)}{f': “{CLAIM_WORDS[measure]}”' if measure in CLAIM_WORDS else ''}"
        for measure, name in MEASURES.items()
    }
    cells = {
        "against": lambda row: design.contenders[row["baseline"]].label,
        "learned": lambda row: _written(row, LEARNED.name),
        "baseline": lambda row: _written(row, "other"),
        "difference": _difference,
        **TEST_CELLS,
    }
    rows = [row for measure in MEASURES for row in records(table1, measure=measure)]
    return Listing.of("Table 1", caption, rows, cells, lambda row: headings[row["measure"]], is_folded=False)


def _written(row: Row, column: str) -> str:
    return amount(row[column]) if is_reward(row["measure"]) else significant(row[column])


def _difference(row: Row) -> str:
    mean, ends = with_interval(*(row[name] for name in EFFECT))
    return mean if ends == MISSING else f"{mean} ({ends})"


def _weights(design: RewardDesign, weights: pd.DataFrame) -> Listing:
    caption = (
        "Effective sample size of the weights of all stages, (Σw)²/Σw², and in brackets the largest weight; means over "
        "repetitions, independent cuts."
    )

    def cell(row: Row) -> str:
        return f"{amount(row['effective_sample_size'], 0)} ({amount(row['largest_weight'], 1)})"

    return Listing("Table 2", caption, *_by_size(design, weights, cell), is_folded=False)
