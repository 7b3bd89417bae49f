"""Reward of the learned policy, by size of the log and proportion of cut trajectories: Figure 1, Tables 1 and 2."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from itertools import groupby
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from halfseen import wording
from halfseen.figures import BAND_OPACITY, WIDTH_INCHES, EndLabel, draw_curve, draw_zero, write_title
from halfseen.study import compare, figures, policies
from halfseen.study.compare import EFFECT, estimated_in, learned_from, records, row_of, three, where
from halfseen.study.experiment import Drawing, Listing, Row, Section, Tables, words
from halfseen.study.experiments.reward_repetition import MEASURES, RewardRepetition
from halfseen.study.figures import INTERVAL
from halfseen.study.policies import BEST, FITTED_ONE_STEP, FITTED_RULE, HEURISTICS, LEARNED, LINEAR, ONE_STEP
from halfseen.study.setting import Setting
from halfseen.wording import MISSING, SUPPORTED, Claim, amount, listed, share, share_in_words

CLAIM_WORDS = {"reward": "the learned policy earns more", "robot_s": "the learned policy ends sooner"}
ROLES = {BEST[0]: "the strongest heuristic", BEST[1]: "the strongest planner, which knows the true model"}
MARK = " *"  # marks a significant difference
GAIN = three("gain")
GAIN_AXIS = "gain over the strongest heuristic, which knows the true laws, on the same episodes"
DODGE = 1.02  # factor between neighbouring curves, which are drawn side by side to avoid overlap
PLAIN = ("greedy", "history")  # rules of thumb that ignore the cost of a wrong WASH


@dataclass(frozen=True)
class Reward(RewardRepetition):
    """The experiment; its parameters are those of `RewardRepetition`."""

    name: ClassVar[str] = "reward"

    def section(self, setting: Setting, tables: Tables) -> Section:
        """Say whether learning earns more, and how few logged trajectories suffice."""
        figure1, table1, peer = tables["figure1"], tables["table1"], tables["peer"]
        rule, planner = (claim(self, setting, figure1, table1, role) for role in BEST)
        # One sentence for both, which names the learned policy once.
        both = f"{rule.sentence[:-1]}; it {planner.asserted} {planner.rival}: {planner.verdict} ({planner.numbers})."
        found = _sufficient(self, figure1)
        size, on_planner = self.table_num_trajectories, f"it {planner.found} the strongest planner"
        caption = words(self.name, "caption", design=self, setting=setting, logging_rule=policies.STRONGEST_RULE.label)
        times = {row["baseline"]: float(row["other"]) for row in records(table1, measure="decision_ms")}
        times[LEARNED.name] = float(row_of(table1, measure="decision_ms")[LEARNED.name])
        title = f"{_beats(found)}; learned from {size} trajectories, {on_planner}"
        drawing = Drawing("figure1", "Figure 1", title, caption, Figure1(self, figure1, times).draw)
        sentences = (
            both,
            _how_few_trajectories(self, found),
            _against_peer(self, peer),
            _what_of_laws(self, figure1),
            _verdicts(self, table1),
        )
        tests, weights = _tests(self, setting, table1), _weights(self, tables["weights"])
        listings = (*_numbers(self, setting, figure1, peer), tests, weights)
        heading, opening = "Reward against the size of the log", opening_of(self, setting, figure1, rule)
        return Section(heading, sentences, (drawing,), listings, num_leading=3, opening=opening)


def claim(design: Reward, setting: Setting, figure1: pd.DataFrame, table1: pd.DataFrame, role: str) -> Claim:
    """Claim that the learned policy of Table 1 earns more than the baseline of a role, on the same episodes."""
    name = str(row_of(figure1, role=role)["policy"])
    row = row_of(table1, baseline=name, measure="reward")
    earned = f"{amount(float(row[LEARNED.name]))} against {amount(float(row['other']))} a trajectory"
    return Claim(
        f"The policy {learned_from(design.table_num_trajectories, design.table_cut_share)}",
        "earns more than",
        "earns less than",
        f"{ROLES[role]} ({design.contenders[name].label})",
        compare.gain_in(row),
        float(row["p_holm"]),
        setting.alpha,
        f"{earned} on the same {wording.counted(int(row['num_episodes']), 'episode')}",
    )


def _sufficient(design: Reward, figure1: pd.DataFrame) -> dict[float, int | None]:
    """Proportion of cuts → the smallest log from which on the learned policy earns more than the strongest heuristic.

    At this size and at every larger one the 95 % interval of the paired difference lies above 0; None if even the
    largest log does not suffice.
    """
    found: dict[float, int | None] = dict.fromkeys(design.cut_shares)
    for cut_share in found:
        rows = where(figure1, policy=LEARNED.name, cut_share=cut_share).sort_values("num_trajectories")
        too_few = np.flatnonzero(~(rows["gain_low"] > 0))
        enough = rows["num_trajectories"].iloc[too_few[-1] + 1 if len(too_few) else 0 :]
        found[cut_share] = None if enough.empty else int(enough.iloc[0])
    return found


def _how_few_trajectories(design: Reward, found: Mapping[float, int | None]) -> str:
    parts = []
    for size, shares in groupby(found, key=lambda cut_share: found[cut_share]):
        enough = f"even {max(design.num_trajectories)} logged trajectories do not suffice"
        if size is not None:
            smallest = ", the smallest log that was tried," if size == min(design.num_trajectories) else ""
            enough = f"{size} logged trajectories{smallest} suffice"
        parts.append(f"{enough} where {listed([share_in_words(each) for each in shares], 'or')} of them are cut")
    return f"To earn more than the strongest heuristic, {listed(parts)} (paired differences, 95 % intervals above 0)."


def _beats(found: Mapping[float, int | None]) -> str:
    sizes = [size for size in found.values() if size is not None]
    if not sizes:
        return "The learned policy does not clearly beat the strongest heuristic"
    between = dict.fromkeys(str(size) for size in (min(sizes), max(sizes)))
    start = f"The learned policy beats the strongest heuristic from {' to '.join(between)} logged trajectories on"
    failed = [share_in_words(cut_share) for cut_share, size in found.items() if size is None]
    if failed:
        return f"{start}, but not clearly where {listed(failed, 'or')} were cut"
    return f"{start}, {'whatever proportion was cut' if len(set(sizes)) == 1 else 'by the proportion cut'}"


def _against_peer(design: Reward, peer: pd.DataFrame) -> str:
    """Say which of the two earns more from how many trajectories, over all proportions of cuts and at single ones."""
    means, single = records(peer, cut_share=None), records(peer[peer["cut_share"].notna()])
    ends = " and ".join(f"{estimated_in(row, EFFECT)} from {row['num_trajectories']}" for row in (means[0], means[-1]))
    by_means = _by_verdict(means, lambda rows: f"{listed([str(row['num_trajectories']) for row in rows])} trajectories")
    verdicts = {"by_means": by_means, "by_proportions": _by_verdict(single, _places)}
    return words(design.name, "peer_sentence", design=design, ends=ends, num_tests=len(peer), **verdicts)


def _by_verdict(rows: list[Row], written: Callable[[list[Row]], str]) -> str:
    found = [row for row in rows if row["supported"]]
    more, less = ([row for row in found if (row["effect"] > 0) is is_more] for is_more in (True, False))
    verbs = {"earns more": more, "earns less": less}
    parts = [f"{verb} from {written(there)}" for verb, there in verbs.items() if there]
    rest = "elsewhere shows no significant difference" if parts else "shows no significant difference anywhere"
    return listed([*parts, rest] if len(found) < len(rows) else parts)


def _places(rows: list[Row]) -> str:
    """Sizes with the proportions of cut trajectories, grouped by equal proportions."""
    sizes: dict[str, list[str]] = {}
    for size, of in groupby(rows, key=lambda row: row["num_trajectories"]):
        sizes.setdefault(listed([share(row["cut_share"]) for row in of], "or"), []).append(str(size))
    return listed([f"{listed(those)} trajectories (cut: {cut})" for cut, those in sizes.items()])


def _what_of_laws(design: Reward, figure1: pd.DataFrame) -> str:
    """Gains over the strongest heuristic, with and without laws fitted to the same logs."""
    sizes = dict.fromkeys((min(design.num_trajectories), max(design.num_trajectories)))

    def gains(name: str) -> str:
        rows = (row_of(figure1, policy=name, num_trajectories=size, cut_share=design.table_cut_share) for size in sizes)
        return " and ".join(estimated_in(row, GAIN) for row in rows)

    others = {FITTED_ONE_STEP.name: "Q₁ with laws fitted to the same log", LINEAR.name: "linear eq. 3 without laws"}
    others[FITTED_RULE.name] = "the strongest heuristic with fitted laws"
    said = [f"{words} {gains(name)}" for name, words in others.items() if name in design.contenders]
    return words(
        design.name, "laws_sentence", design=design, gains=gains, learned=LEARNED.name, sizes=sizes, others=said
    )


def _verdicts(design: Reward, table1: pd.DataFrame) -> str:
    """Say how many hypotheses of Table 1 are supported, and name those that are not."""
    parts = []
    for measure, claimed in CLAIM_WORDS.items():
        found: dict[str, list[str]] = {SUPPORTED: [], wording.NOT_SUPPORTED: [], wording.INCONCLUSIVE: []}
        for row in records(table1, measure=measure):
            found[compare.verdict_of(row)].append(design.contenders[row["baseline"]].label)
        said = [f"{SUPPORTED} against {len(found.pop(SUPPORTED))} of {len(design.baseline_names)}"]
        said += [f"{verdict} against {len(names)} ({'; '.join(names)})" for verdict, names in found.items() if names]
        parts.append(f"that {claimed} is {listed(said)}")
    return f"Of the hypotheses of Table 1, {'; '.join(parts)}."


def _by_size(
    design: Reward,
    label: str,
    caption: str,
    tables: Mapping[str, pd.DataFrame],
    cell: Callable[[Row], str],
    more: tuple[str, ...] = (),
    is_folded: bool = True,
) -> Listing:
    """Tables of sizes by proportions of cut trajectories, by the heading over each."""
    header = ("logged trajectories", *(f"cut: {share(cut_share)}" for cut_share in design.cut_shares), *more)
    sizes = design.num_trajectories
    groups = {
        heading: [(str(size), *map(cell, records(table, num_trajectories=size))) for size in sizes]
        for heading, table in tables.items()
    }
    return Listing(label, caption, header, groups, is_folded)


def _numbers(design: Reward, setting: Setting, figure1: pd.DataFrame, peer: pd.DataFrame) -> list[Listing]:
    """By size and proportion: learned policies, gains of all that use logs over the best heuristic, and the peer."""
    of_logs = figure1[figure1["cut_share"].notna()]
    made = (LEARNED.name, design.peer.name, *design.beside_names)
    above = {design.contenders[name].label: where(of_logs, policy=name) for name in made}
    of_peer = words(design.name, "peer", design=design, setting=setting, mark=MARK.strip(), num_tests=len(peer))
    own, gain = partial(estimated_in, names=INTERVAL), partial(estimated_in, names=GAIN)
    in_figure1, of_made = "The numbers of the learned policy in Figure 1", words(design.name, "above")
    peer_label, more = "Learned, or planned with fitted laws", ("mean over these",)

    def marked(row: Row) -> str:
        return f"{estimated_in(row, EFFECT)}{MARK if row['supported'] else ''}"

    return [
        _by_size(design, in_figure1, "", {"": where(figure1, policy=LEARNED.name)}, own),
        _by_size(design, "Learned from logs, above the strongest heuristic", of_made, above, gain),
        _by_size(design, peer_label, of_peer, {"": peer}, marked, more),
    ]


def _tests(design: Reward, setting: Setting, table1: pd.DataFrame) -> Listing:
    num_tests = table1["p_holm"].notna().sum()
    caption = words(design.name, "tests", design=design, setting=setting, num_tests=num_tests)
    headings = {
        measure: f"{wording.capitalised(name)}{f': “{CLAIM_WORDS[measure]}”' if measure in CLAIM_WORDS else ''}"
        for measure, name in MEASURES.items()
    }

    def written(row: Row, column: str) -> str:
        return amount(row[column]) if compare.is_reward(row["measure"]) else wording.significant(row[column])

    def difference(row: Row) -> str:
        mean, ends = wording.with_interval(*(row[name] for name in EFFECT))
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


def _weights(design: Reward, weights: pd.DataFrame) -> Listing:
    contradicted = 1.0 - weights["by_laws"].astype(float)
    caption = words(design.name, "weights", design=design, contradicted=contradicted)
    return _by_size(
        design,
        "Table 2",
        caption,
        {"": weights},
        lambda row: f"{amount(row['effective_sample_size'], 0)} ({amount(row['largest_weight'], 1)})",
        is_folded=False,
    )


class Figure1:
    """Rewards above; below, gains over the strongest heuristic of policies with similar rewards."""

    def __init__(self, design: RewardRepetition, table: pd.DataFrame, times_ms: Mapping[str, float]) -> None:
        self.design, self.table = design, table
        self.best = [design.contenders[str(row_of(table, role=role)["policy"])] for role in BEST]
        self.ms = {name: f"  ({wording.significant(value, 2)} ms)" for name, value in times_ms.items()}

    def draw(self, title: str) -> Figure:
        """Draw it with a title."""
        figure, sizes = Figure(figsize=(WIDTH_INCHES, 8.6)), self.design.num_trajectories
        top = write_title(figure, title) - 0.045
        upper, lower = figures.two_panels(figure, top, 0.065, 0.50, 0.06, 0.085, lower_share=0.62)
        for axes, name, draw in ((upper, figures.REWARD_AXIS, self._rewards), (lower, GAIN_AXIS, self._gains)):
            figures.finish_by_size(axes, name, sizes, (1.08, 1.05), draw(axes))
        lower.set_xlabel(figures.TRAJECTORIES_AXIS)
        return figure

    def _rewards(self, axes: Axes) -> list[EndLabel]:
        """Policies learned with and without laws, the heuristics, and the strongest planner."""
        labels = self._levels(axes, [*(each.name for each in HEURISTICS), self.best[1].name], INTERVAL)
        if LINEAR.name in self.design.beside_names:
            labels.append(self._curve(axes, LINEAR, INTERVAL, "o"))
        rows = where(self.table, policy=LEARNED.name, cut_share=self.design.table_cut_share)
        draw_curve(axes, rows["num_trajectories"], rows[INTERVAL], color=LEARNED.colour, marker="s")
        return [*labels, self._label(LEARNED, float(rows["mean_reward"].iloc[-1]), is_bold=True)]

    def _gains(self, axes: Axes) -> list[EndLabel]:
        """Learned policies by share of cuts; with fitted and with true laws, one step ahead and to the end."""
        draw_zero(axes, self.best[0].colour, 1.5)
        labels = [self._label(self.best[0], 0.0, is_bold=True)]
        labels += self._levels(axes, [*self.design.planner_names, ONE_STEP.name], GAIN)
        for who, marker in ((self.design.peer, "X"), (FITTED_ONE_STEP, "P"), (FITTED_RULE, "v")):
            labels.append(self._curve(axes, who, GAIN, marker))
        shares, ms = self.design.cut_shares, self.ms[LEARNED.name]
        return labels + figures.draw_by_cut_share(axes, self.table, shares, GAIN, draw_curve, DODGE, ms)

    def _levels(self, axes: Axes, names: Sequence[str], columns: list[str]) -> list[EndLabel]:
        """Draw policies that do not learn as level lines, with bands for the strongest."""
        labels = []
        for name in names:
            who, is_best = self.design.contenders[name], name in [each.name for each in self.best]
            value, low, high = (float(row_of(self.table, policy=name)[column]) for column in columns)
            labels.append(figures.draw_level(axes, who, value, is_best, self.ms[name]))
            if is_best:
                axes.axhspan(low, high, color=who.colour, alpha=BAND_OPACITY, linewidth=0, zorder=1)
        return labels

    def _curve(self, axes: Axes, who: policies.Entrant, columns: list[str], marker: str) -> EndLabel:
        """Draw a policy that uses logs, as the mean over the proportions of cut trajectories."""
        means = where(self.table, policy=who.name, cut_share=None)
        look: dict[str, Any] = {"color": who.colour, "marker": marker, "linestyle": (0, who.dashes)}
        draw_curve(axes, means["num_trajectories"], means[columns], **look)
        return self._label(who, float(means[columns[0]].iloc[-1]))

    def _label(self, who: policies.Entrant, end: float, is_bold: bool = False) -> EndLabel:
        return EndLabel(end, f"{who.label}  {amount(end)}{self.ms[who.name]}", who.colour, is_bold)


def opening_of(design: RewardRepetition, setting: Setting, figure1: pd.DataFrame, rule: Claim) -> Drawing:
    """Draw the reward of each way of clearing a table, and say whether learning is the better one.

    Rewards are relative to leaving a table as it is: the expected cost of FINISH at once for the dirty objects left.
    `rule` is the claim that the learned policy earns more than the strongest heuristic.
    """
    world, size, cut_share = setting.world, design.table_num_trajectories, design.table_cut_share
    num_objects = float(np.mean([scene.num_objects for scene in setting.scenes]))
    nothing = float(world.reward_dirty_left) * float(world.dirty_share) * num_objects
    plain = max((row_of(figure1, policy=name) for name in PLAIN), key=lambda row: float(row["mean_reward"]))
    peer = row_of(figure1, policy=design.peer.name, num_trajectories=size, cut_share=None)
    bars = {
        "a plain rule of thumb": plain,
        "the best rule of thumb": row_of(figure1, role=BEST[0]),
        "learned from the runs": row_of(figure1, policy=LEARNED.name, num_trajectories=size, cut_share=cut_share),
        "plans ahead, with laws from the runs": peer,
        "plans ahead, and knows the true laws": row_of(figure1, role=BEST[1]),
    }
    table = pd.DataFrame(bars.values(), index=pd.Index(bars))
    points = table[INTERVAL].astype(float) - nothing
    colours = [design.contenders[name].colour for name in table["policy"]]
    theirs, ours = (amount(mean, 1) for mean in points["mean_reward"].iloc[1:3])
    across = "points won on a table, above leaving it as it is; thin lines: 95 % intervals"
    how = {SUPPORTED: "better than", wording.INCONCLUSIVE: "about as well as"}.get(rule.verdict, "worse than")
    sentence = (
        f"In simulation, a robot that learned from {size} old runs, {share_in_words(cut_share)} of them cut short, "
        f"clears a table {how} the best rule of thumb: {ours} points a table, against {theirs}."
    )
    return Drawing(
        "opening",
        "",
        sentence,
        words("reward", "opening", world=world),
        partial(figures.draw_named_bars, points, colours, across),
    )
