"""What the experiment says: who earns more, how few trajectories suffice, Tables 1 and 2, and the captions."""

from collections.abc import Callable
from itertools import groupby
from typing import Any

import pandas as pd

from halfseen.study import compare
from halfseen.study.compare import EFFECT, estimated_in, learned_from, records, row_of, where
from halfseen.study.experiment import Drawing, Listing, Row, Section, Tables
from halfseen.study.experiments.reward_figures import GAIN, Figure1, opening_of
from halfseen.study.experiments.reward_repetition import RewardRepetition
from halfseen.study.figures import INTERVAL
from halfseen.study.policies import BEST, FITTED_ONE_STEP, FITTED_RULE, LEARNED, LINEAR, STRONGEST_RULE
from halfseen.study.setting import Setting
from halfseen.wording import (
    INCONCLUSIVE,
    MISSING,
    NOT_SUPPORTED,
    SUPPORTED,
    Claim,
    amount,
    capitalised,
    counted,
    listed,
    percent,
    share,
    share_in_words,
    significant,
    with_interval,
)

MEASURES = {
    "reward": "reward of a trajectory",
    "robot_s": "robot time until a trajectory ends [s]",
    "decision_ms": "time of one decision [ms], measured on this machine",
}
"""Measure → name for people; times of decisions are told and not tested, as they depend on the machine."""
CLAIM_WORDS = {"reward": "the learned policy earns more", "robot_s": "the learned policy ends sooner"}
ROLES = ("the strongest heuristic", "the strongest planner, which knows the true model")
MARK = " *"
"""Marks a difference that the test finds."""


def section_of(design: RewardRepetition, setting: Setting, tables: Tables) -> Section:
    """Say whether learning earns more, and how few logged trajectories suffice."""
    figure1, table1, peer = tables["figure1"], tables["table1"], tables["peer"]
    rule, planner = (claim(design, setting, figure1, table1, role) for role in BEST)
    # One sentence for both, which names the learned policy once.
    both = f"{rule.sentence[:-1]}; it {planner.asserted} {planner.rival}: {planner.verdict} ({planner.numbers})."
    on_planner = f"it {planner.found} the strongest planner"
    title = f"{_beats(design, figure1)}; learned from {design.table_num_trajectories} trajectories, {on_planner}"
    times = {row["baseline"]: float(row["other"]) for row in records(table1, measure="decision_ms")}
    times[LEARNED.name] = float(row_of(table1, measure="decision_ms")[LEARNED.name])
    draw = Figure1(design, figure1, times).draw
    return Section(
        "Reward against the size of the log",
        (
            both,
            _how_few_trajectories(design, figure1),
            peer_sentence(design, peer),
            _what_of_laws(design, figure1),
            _verdicts(design, table1),
        ),
        (Drawing("figure1", "Figure 1", title, _caption(design, setting), draw),),
        (*_numbers(design, setting, figure1, peer), _tests(design, setting, table1), _weights(design, tables)),
        num_leading=3,
        opening=opening_of(design, setting, figure1, rule),
    )


def claim(design: RewardRepetition, setting: Setting, figure1: pd.DataFrame, table1: pd.DataFrame, role: str) -> Claim:
    """That the learned policy of Table 1 earns more than the baseline of a role, on the same episodes."""
    name = str(row_of(figure1, role=role)["policy"])
    row = row_of(table1, baseline=name, measure="reward")
    earned = f"{amount(float(row[LEARNED.name]))} against {amount(float(row['other']))} a trajectory"
    return Claim(
        f"The policy {learned_from(design.table_num_trajectories, design.table_cut_share)}",
        "earns more than",
        "earns less than",
        f"{ROLES[BEST.index(role)]} ({design.contenders[name].label})",
        compare.gain_in(row),
        float(row["p_holm"]),
        setting.alpha,
        f"{earned} on the same {counted(int(row['num_episodes']), 'episode')}",
    )


def _sufficient(design: RewardRepetition, figure1: pd.DataFrame) -> dict[float, int | None]:
    """Proportion of cuts → the smallest log from which on the learned policy earns more than the strongest heuristic.

    At this size and at every larger one the 95 % interval of the paired difference lies above 0; None if even the
    largest log does not do.
    """
    found: dict[float, int | None] = dict.fromkeys(design.cut_shares)
    for cut_share in found:
        rows = records(figure1, policy=LEARNED.name, cut_share=cut_share)
        for row in sorted(rows, key=lambda row: -row["num_trajectories"]):
            if not float(row["gain_low"]) > 0:
                break
            found[cut_share] = int(row["num_trajectories"])
    return found


def _how_few_trajectories(design: RewardRepetition, figure1: pd.DataFrame) -> str:
    parts, found = [], _sufficient(design, figure1)
    for size, shares in groupby(found, key=lambda cut_share: found[cut_share]):
        enough = f"even {max(design.num_trajectories)} logged trajectories do not suffice"
        if size is not None:
            smallest = ", the smallest log that was tried," if size == min(design.num_trajectories) else ""
            enough = f"{size} logged trajectories{smallest} suffice"
        parts.append(f"{enough} where {listed([share_in_words(each) for each in shares], 'or')} of them are cut")
    return f"To earn more than the strongest heuristic, {listed(parts)} (paired differences, 95 % intervals above 0)."


def _beats(design: RewardRepetition, figure1: pd.DataFrame) -> str:
    found = _sufficient(design, figure1)
    sizes = [size for size in found.values() if size is not None]
    if not sizes:
        return "The learned policy does not clearly beat the strongest heuristic"
    between = dict.fromkeys(str(size) for size in (min(sizes), max(sizes)))
    start = f"The learned policy beats the strongest heuristic from {' to '.join(between)} logged trajectories on"
    failed = [share_in_words(cut_share) for cut_share, size in found.items() if size is None]
    if failed:
        return f"{start}, but not clearly where {listed(failed, 'or')} were cut"
    return f"{start}, {'whatever proportion was cut' if len(set(sizes)) == 1 else 'by the proportion cut'}"


def peer_sentence(design: RewardRepetition, peer: pd.DataFrame) -> str:
    """Say who earns more from how many trajectories, over all proportions of cut trajectories and at single ones."""
    means, single = records(peer, cut_share=None), records(peer[peer["cut_share"].notna()])
    ends = " and ".join(f"{estimated_in(row, EFFECT)} from {row['num_trajectories']}" for row in (means[0], means[-1]))
    return (
        f"Against the planner with laws fitted to the same logs ({design.planners[0][0]:,} simulations), over all "
        f"proportions of cut trajectories the learned policy {_by_verdict(means, _sizes)} (learned − planner: {ends} "
        f"trajectories); by single proportions, it {_by_verdict(single, _places)} (two-sided signed-rank tests, "
        f"adjusted by Holm’s procedure for all {len(peer)})."
    )


def _by_verdict(rows: list[Row], written: Callable[[list[Row]], str]) -> str:
    found = [row for row in rows if row["supported"]]
    more, less = ([row for row in found if (row["effect"] > 0) is is_more] for is_more in (True, False))
    verbs = {"earns more": more, "earns less": less}
    parts = [f"{verb} from {written(there)}" for verb, there in verbs.items() if there]
    rest = "elsewhere shows no significant difference" if parts else "shows no significant difference anywhere"
    return listed([*parts, rest] if len(found) < len(rows) else parts)


def _sizes(rows: list[Row]) -> str:
    return f"{listed([str(row['num_trajectories']) for row in rows])} trajectories"


def _places(rows: list[Row]) -> str:
    """Sizes with the proportions of cut trajectories, those of the same proportions together."""
    sizes: dict[str, list[str]] = {}
    for size, of in groupby(rows, key=lambda row: row["num_trajectories"]):
        sizes.setdefault(listed([share(row["cut_share"]) for row in of], "or"), []).append(str(size))
    return listed([f"{listed(those)} trajectories (cut: {cut})" for cut, those in sizes.items()])


def _what_of_laws(design: RewardRepetition, figure1: pd.DataFrame) -> str:
    """Say what is earned above the strongest heuristic by whom, with and without laws fitted to the same logs."""
    sizes = dict.fromkeys((min(design.num_trajectories), max(design.num_trajectories)))

    def gains(name: str) -> str:
        rows = (row_of(figure1, policy=name, num_trajectories=size, cut_share=design.table_cut_share) for size in sizes)
        return " and ".join(estimated_in(row, GAIN) for row in rows)

    others = {FITTED_ONE_STEP.name: "Q₁ with laws fitted to the same log", LINEAR.name: "linear eq. 3 without laws"}
    others[FITTED_RULE.name] = "the strongest heuristic with fitted laws"
    said = [f"{words} {gains(name)}" for name, words in others.items() if name in design.contenders]
    return (
        f"Above the strongest heuristic, which knows the true laws, the learned policy earns {gains(LEARNED.name)} "
        f"from {' and '.join(map(str, sizes))} trajectories, {share_in_words(design.table_cut_share)} of them cut; "
        f"{listed(said)}."
    )


def _verdicts(design: RewardRepetition, table1: pd.DataFrame) -> str:
    """Say how many hypotheses of Table 1 the data speak for, and name those that they do not."""
    parts = []
    for measure, claimed in CLAIM_WORDS.items():
        found: dict[str, list[str]] = {SUPPORTED: [], NOT_SUPPORTED: [], INCONCLUSIVE: []}
        for row in records(table1, measure=measure):
            found[compare.verdict_of(row)].append(design.contenders[row["baseline"]].label)
        said = [f"{SUPPORTED} against {len(found.pop(SUPPORTED))} of {len(design.baseline_names)}"]
        said += [f"{verdict} against {len(names)} ({'; '.join(names)})" for verdict, names in found.items() if names]
        parts.append(f"that {claimed} is {listed(said)}")
    return f"Of the hypotheses of Table 1, {'; '.join(parts)}."


def _caption(design: RewardRepetition, setting: Setting) -> str:
    few = min(design.planned_repetitions, setting.repetitions)
    planned = f"in {few} of the repetitions, " if few < setting.repetitions else ""
    how = "with the help of laws fitted to the same log" if design.laws else "by linear eq. 3, without laws"
    return (
        f"Above: mean reward; below: paired difference from the strongest heuristic. The learned policy: censored "
        f"Q-learning, weighted by 1/Ĝ, {how}; {setting.repetitions} repetitions, each with a fresh log and fresh "
        "evaluation episodes that all policies share; markers of one size stand side by side for legibility. Lines "
        "across learn nothing from logs and know the true laws; bold: the heuristic and the planner that were the "
        "strongest on other episodes. Broken curves: made of the logs that the policy is learned from, mean over the "
        "proportions of cut trajectories; “laws fitted”: with the laws that it goes by. Q₁ looks one step ahead. A "
        f"planner has so many simulations for each decision, whatever time they take, and {planned}plays some of the "
        "episodes: it is reckoned from the paired difference on those. All rewards are by a control variate, which "
        "leaves their means as they are: how far decisions fall short of a look one step ahead, plus what this is "
        f"worth in the mean of {design.num_starts:,} tables. In brackets: the time of a decision on one core of this "
        "machine. Shaded: 95 % intervals (Student’s t); of the lines across, for the two in bold. Cuts are independent "
        f"of what happens on the table. Logs: half of the actions are those of a heuristic ({STRONGEST_RULE.label}), "
        "half are uniformly random."
    )


def _by_size(design: RewardRepetition, table: pd.DataFrame, written: Callable[[Row], str]) -> list[tuple[str, ...]]:
    """Rows of a table of sizes by proportions of cut trajectories."""
    return [(str(size), *map(written, records(table, num_trajectories=size))) for size in design.num_trajectories]


def _header(design: RewardRepetition) -> tuple[str, ...]:
    return ("logged trajectories", *(f"cut: {share(cut_share)}" for cut_share in design.cut_shares))


def _numbers(design: RewardRepetition, setting: Setting, figure1: pd.DataFrame, peer: pd.DataFrame) -> list[Listing]:
    """By size and proportion: what was learned, what is made of logs above the strongest heuristic, and the peer."""
    header, of_logs = _header(design), figure1[figure1["cut_share"].notna()]
    own = _by_size(design, where(figure1, policy=LEARNED.name), lambda row: estimated_in(row, INTERVAL))
    above = {
        design.contenders[name].label: _by_size(
            design, where(of_logs, policy=name), lambda row: estimated_in(row, GAIN)
        )
        for name in (LEARNED.name, design.peer.name, *design.beside_names)
    }
    against = _by_size(design, peer, lambda row: f"{estimated_in(row, EFFECT)}{MARK if row['supported'] else ''}")
    of_above = "Reward above that of the strongest heuristic, which knows the true laws; 95 % intervals, not adjusted."
    of_peer = (
        "Reward of the learned policy less that of the planner with laws fitted to the same log, which plays "
        f"{counted(design.fitted_episodes, 'episode')} of a repetition for each log, with 95 % intervals (not "
        f"adjusted). {MARK.strip()}: p of a two-sided Wilcoxon signed-rank test, adjusted by Holm’s procedure for all "
        f"{len(peer)}, below α = {setting.alpha:g}."
    )
    return [
        Listing("The numbers of the learned policy in Figure 1", "", header, {"": own}),
        Listing("What is made of logs, above the strongest heuristic", of_above, header, above),
        Listing("Learned, or planned with fitted laws", of_peer, (*header, "mean over these"), {"": against}),
    ]


def _tests(design: RewardRepetition, setting: Setting, table1: pd.DataFrame) -> Listing:
    num_tested = int(table1["p_holm"].notna().sum())
    caption = (
        f"The policy learned from {design.table_num_trajectories} trajectories, of which "
        f"{share_in_words(design.table_cut_share)} are cut in expectation, against each baseline: one-sided Wilcoxon "
        "signed-rank tests over the repetitions, on the episodes that both played. Difference: learned − baseline, "
        "with its 95 % interval (not adjusted); of times, below 0 is better. Holm’s procedure adjusted the "
        f"{num_tested} p-values together; α = {setting.alpha:g}. Not supported: the interval lies on the other side of "
        "0. Decision times are medians on one core of this machine, told beside; nothing else depends on them."
    )
    headings = {
        measure: f"{capitalised(name)}{f': “{CLAIM_WORDS[measure]}”' if measure in CLAIM_WORDS else ''}"
        for measure, name in MEASURES.items()
    }

    def written(row: Row, column: str) -> str:
        return amount(row[column]) if compare.is_reward(row["measure"]) else significant(row[column])

    def difference(row: Row) -> str:
        mean, ends = with_interval(*(row[name] for name in EFFECT))
        return mean if ends == MISSING else f"{mean} ({ends})"

    cells: dict[str, Callable[[Row], str]] = {
        "against": lambda row: design.contenders[row["baseline"]].label,
        "learned": lambda row: written(row, LEARNED.name),
        "baseline": lambda row: written(row, "other"),
        "difference": difference,
        **compare.TEST_CELLS,
    }
    rows = [row for measure in MEASURES for row in records(table1, measure=measure)]
    return Listing.of("Table 1", caption, rows, cells, lambda row: headings[row["measure"]], is_folded=False)


def _weights(design: RewardRepetition, tables: Tables) -> Listing:
    caption = (
        "Effective sample size of the weights of all stages, (Σw)²/Σw², and in brackets the largest weight; means over "
        "repetitions, independent cuts."
    )
    if design.laws:
        contradicted: Any = 1.0 - tables["weights"]["by_laws"]
        caption += (
            " The log contradicted the laws fitted to it, so that the policy is a heuristic or linear eq. 3, in "
            f"{percent(float(contradicted.mean()))} of all cases, at a single size and proportion in at most "
            f"{percent(float(contradicted.max()))}."
        )

    def cell(row: Row) -> str:
        return f"{amount(row['effective_sample_size'], 0)} ({amount(row['largest_weight'], 1)})"

    return Listing(
        "Table 2", caption, _header(design), {"": _by_size(design, tables["weights"], cell)}, is_folded=False
    )
