"""The value of simulations and of a longer planning horizon to a planner that knows the true model: Figures 2 and 3.

All policies meet the same evaluation episodes. A planner with many simulations plays few of them, in turn over the
repetitions, so that every table is met; it is compared on those that it played. Rewards are by the control variate of
`pipeline`, and reproducible from the seed: a planner has a number of simulations, not a time limit. Decision times are
measured and reported separately.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from timeit import repeat
from typing import ClassVar

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from halfseen import figures as pages
from halfseen.errors import ArgumentError
from halfseen.figures import PLANNER, WIDTH_INCHES, EndLabel, draw_bars, draw_zero
from halfseen.shapes import Float
from halfseen.study import figures
from halfseen.study.compare import estimate_in, estimated_in, learned_from, mean_columns, records, row_of, three
from halfseen.study.experiment import Drawing, Listing, PieceOf, Pieces, Row, Section, Tables, words
from halfseen.study.figures import INTERVAL
from halfseen.study.pipeline import CUT_KIND, Played, Source, episodes_in_turn
from halfseen.study.policies import HEURISTICS, LEARNED, Entrant, StudyKind, by_name, horizon_planner, planner
from halfseen.study.setting import Setting
from halfseen.wording import MISSING, Claim, amount, counted, listed, significant
from halfseen.world.policy import Policy

NUM_TIMED_STATES, NUM_FITS = 30, 5
OVER = [f"over_{LEARNED.name}", "over_low", "over_high"]
VERBS = "earns more than", "earns less than"


@dataclass(frozen=True)
class Planning:
    """Planners by simulations and by horizon.

    `simulations` maps the simulations per decision of planners that look to the end of a trajectory to the number of
    episodes that each plays in a repetition. Other planners look `horizons` steps ahead. The learned policy is learned
    from `num_trajectories`, of which `cut_share` are cut; with `laws`, laws fitted to the same log assist. The mean of
    V° over initial tables is estimated from `num_starts`.
    """

    simulations: tuple[tuple[int, int], ...] = ((8, 25), (128, 25), (1024, 3))
    horizons: tuple[int, ...] = (1, 2, 3, 4, 5, 6)
    horizon_simulations: int = 128
    horizon_episodes: int = 15
    num_trajectories: int = 800
    cut_share: float = 1 / 2
    episodes_per_scene: int = 5
    num_starts: int = 100_000
    laws: bool = True
    most_repetitions: int | None = 6
    name: ClassVar[str] = "planning"

    def __post_init__(self) -> None:
        if len(self.horizons) < 2 or list(self.horizons) != sorted(set(self.horizons)):
            raise ArgumentError(f"horizons is {self.horizons}; give at least two, each longer than the one before")

    @property
    def by_simulations(self) -> dict[str, int]:
        """Simulations of each planner that looks to the end."""
        return {planner(size).name: size for size, _ in self.simulations}

    @property
    def by_horizon(self) -> dict[str, int]:
        """Horizon of each planner that looks a limited number of steps ahead."""
        return {self._ahead(horizon).name: horizon for horizon in self.horizons}

    @property
    def contenders(self) -> dict[str, Entrant]:
        """All contenders, by name."""
        planners = [planner(size) for size, _ in self.simulations] + [self._ahead(horizon) for horizon in self.horizons]
        return by_name(LEARNED, *HEURISTICS, *planners)

    def _ahead(self, horizon: int) -> Entrant:
        return horizon_planner(horizon, self.horizon_simulations)

    def prepare(self, setting: Setting) -> PieceOf:
        """Calibrate the cuts, and value the initial tables."""
        source = Source.of(setting)
        return {"rate": source.cut_rate(self.cut_share, CUT_KIND), "start": source.start_value(self.num_starts)}

    def measure(self, setting: Setting) -> PieceOf:
        """Decision times [ms], and the median learning time of a few runs on this machine [s]."""
        source = Source.of(setting)
        times = source.decision_times_ms(self.contenders.values(), NUM_TIMED_STATES, self.laws)
        learn = partial(self._learned, source, source.cut_rate(self.cut_share, CUT_KIND))
        learn()
        return {"decision_ms": times, "learning_s": float(np.median(repeat(learn, number=1, repeat=NUM_FITS)))}

    def repeat(self, setting: Setting, prepared: PieceOf, index: int) -> PieceOf:
        """Play all policies: for each, the episodes it played and their rewards."""
        source = Source.of(setting, index)
        num_all = self.episodes_per_scene * len(setting.scenes)
        policies = {LEARNED.name: self._learned(source, prepared["rate"])}
        policies |= {each.name: each.policy(setting.world) for each in HEURISTICS}
        start = float(prepared["start"])
        each = source.control_each(list(policies.values()), range(num_all), start)
        rows = [_row(name, range(num_all), played) for name, played in zip(policies, each, strict=True)]
        some = {planner(size).name: count for size, count in self.simulations}
        for name, count in (some | dict.fromkeys(self.by_horizon, self.horizon_episodes)).items():
            episodes = episodes_in_turn(index, count, num_all)
            (played,) = source.control_each([self.contenders[name].policy(setting.world)], episodes, start)
            rows.append(_row(name, episodes, played))
        return {"index": index, "played": rows}

    def _learned(self, source: Source, rate: float) -> Policy:
        episodes = source.play(self.num_trajectories)
        return source.logged(episodes, laws=self.laws).learn_one(
            source.cut(episodes, rate, CUT_KIND), self.num_trajectories
        )

    def tabulate(self, setting: Setting, pieces: Pieces) -> Tables:
        """Make figure2 and figure3.

        ``figure2`` has policy, kind, simulations, decision_ms (measured on this machine), mean_reward, se, low, high;
        over_censored_q, se_over, over_low, over_high (the mean difference from the learned policy on the same
        episodes), repetitions and episodes (of one repetition). If a policy played only some episodes, its mean is the
        learned policy's on all of them plus that difference.
        ``figure3`` has planning_horizon, simulations, decision_ms, mean_reward, se, low, high, over_previous and
        over_first (paired differences from the next shorter and the shortest horizon, with se_…, …_low, …_high; null
        for the shortest), repetitions and episodes. ``learning`` has learning_s, measured.
        """
        rewards, times = _rewards(pieces), pieces.measured["decision_ms"]
        learning = pd.DataFrame(
            {"num_trajectories": [self.num_trajectories], "learning_s": [pieces.measured["learning_s"]]}
        )
        figure2, figure3 = _figure2(self, rewards, times), _figure3(self, rewards, times)
        return {"figure2": figure2, "figure3": figure3, "learning": learning}

    def section(self, setting: Setting, tables: Tables) -> Section:
        """Say whether a planner earns more, and whether looking further ahead does."""
        figure2, figure3 = tables["figure2"], tables["figure3"]
        best, longer = most_simulations(self, figure2), longest_horizon(self, figure3)
        steps, drawn = f"{longer.title}; {_steps(figure3)}", partial(_draw_horizons, self, figure2, figure3)
        simulations = words(self.name, "simulations", repetitions=figure2["repetitions"].iloc[0])
        horizons = words(self.name, "horizons", design=self)
        drawings = (
            Drawing("figure2", "Figure 2", best.title, simulations, partial(_draw_simulations, figure2)),
            Drawing("figure3", "Figure 3", steps, horizons, drawn),
        )
        return Section("What is planning worth?", (best.sentence, longer.sentence), drawings, (_numbers(self, tables),))


def _row(name: str, episodes: Iterable[int], played: Played) -> Row:
    return {"policy": name, "episodes": list(episodes), "reward": played.reward.tolist()}


def _rewards(pieces: Pieces) -> dict[str, pd.Series]:
    """Rewards of each policy by repetition and episode; NaN for episodes that it did not play."""
    frames = [
        pd.DataFrame({"repetition": k, "policy": row["policy"], "episode": row["episodes"], "reward": row["reward"]})
        for k, piece in enumerate(pieces.repetitions)
        for row in piece["played"]
    ]
    table = pd.concat(frames).pivot(index=["repetition", "episode"], columns="policy", values="reward")
    return {str(name): rewards for name, rewards in table.items()}


def _means(rewards: pd.Series) -> Float[np.ndarray, " R"]:
    """Mean of each repetition, over the episodes that were played."""
    return rewards.groupby("repetition").mean().to_numpy()


def _counts(rewards: pd.Series) -> dict[str, int]:
    """Columns repetitions and episodes."""
    played = rewards.groupby("repetition").count()
    return {"repetitions": len(played), "episodes": int(played.iloc[0])}


def _figure2(design: Planning, rewards: dict[str, pd.Series], times_ms: dict[str, float]) -> pd.DataFrame:
    rows, learned = [], rewards[LEARNED.name]
    for name, who in design.contenders.items():
        over = _means(rewards[name] - learned)
        row: Row = {"policy": name, "kind": str(who.kind), "simulations": design.by_simulations.get(name)}
        row |= {"decision_ms": times_ms[name]} | mean_columns(_means(learned) + over)
        rows.append(row | mean_columns(over, (OVER[0], "se_over", *OVER[1:])) | _counts(rewards[name]))
    return pd.DataFrame(rows).astype({"simulations": "Int64"})


def _figure3(design: Planning, rewards: dict[str, pd.Series], times_ms: dict[str, float]) -> pd.DataFrame:
    rows = []
    first = previous = next(iter(design.by_horizon))
    for name, horizon in design.by_horizon.items():
        row: Row = {"planning_horizon": horizon, "decision_ms": times_ms[name]}
        row["simulations"] = design.horizon_simulations if horizon > 1 else None
        row |= mean_columns(_means(rewards[name]))
        for over, shorter in (("over_previous", previous), ("over_first", first)):
            names = over, f"se_{over}", f"{over}_low", f"{over}_high"
            difference = mean_columns(_means(rewards[name] - rewards[shorter]), names)
            row |= difference if name != first else dict.fromkeys(names, np.nan)
        rows.append(row | _counts(rewards[name]))
        previous = name
    return pd.DataFrame(rows).astype({"simulations": "Int64"})


def most_simulations(design: Planning, figure2: pd.DataFrame) -> Claim:
    """Claim that the planner with the most simulations, fixed beforehand, earns more than the learned policy."""
    size = max(design.by_simulations.values())
    row = row_of(figure2, simulations=size)
    subject = f"Planning with the true model, {counted(size, 'simulation')} a decision,"
    rival = f"the policy {learned_from(design.num_trajectories, design.cut_share)[:-1]}"
    note = f"on the same {counted(int(row['repetitions'] * row['episodes']), 'episode')}"
    return Claim(subject, *VERBS, rival, estimate_in(row, OVER[0], "se_over", int(row["repetitions"])), note=note)


def longest_horizon(design: Planning, figure3: pd.DataFrame) -> Claim:
    """Claim that looking ahead the farthest earns more than the shortest horizon."""
    first, *_, row = records(figure3)
    simulations = counted(design.horizon_simulations, "simulation")
    subject = f"Looking {int(row['planning_horizon'])} steps ahead, with {simulations} a decision,"
    rival = f"looking {counted(int(first['planning_horizon']), 'step')} ahead"
    return Claim(subject, *VERBS, rival, estimate_in(row, "over_first", "se_over_first", int(row["repetitions"])))


def _steps(figure3: pd.DataFrame) -> str:
    """Say at which horizons one more step changes the reward significantly."""
    parts = []
    rows = records(figure3)
    for verb, sign, end in (("gains", 1, "low"), ("loses", -1, "high")):
        steps = [str(row["planning_horizon"]) for row in rows if sign * row[f"over_previous_{end}"] > 0]
        if steps:
            parts.append(f"one more step {verb} reward at {listed(steps)}")
    return listed(parts) or "no single step makes a significant difference"


def _draw_simulations(figure2: pd.DataFrame, title: str) -> Figure:
    """Reward of planners by simulations above, the difference from the learned policy below."""
    figure = Figure(figsize=(WIDTH_INCHES, 7.2))
    top = pages.write_title(figure, title) - 0.06
    upper, lower = figures.two_panels(figure, top, 0.07, 0.61, 0.075, 0.085, lower_share=0.40)
    rows = pd.DataFrame(figure2[figure2["simulations"].notna()])
    rewards = {who: float(row_of(figure2, policy=who.name)["mean_reward"]) for who in (LEARNED, *HEURISTICS)}
    labels = [figures.draw_level(upper, who, reward, who is LEARNED) for who, reward in rewards.items()]
    end = float(rows["mean_reward"].iloc[-1])
    labels.append(EndLabel(end, f"POMDP planner  {amount(end)}", PLANNER, is_bold=True))
    sizes = rows["simulations"].tolist()
    draw_zero(lower, LEARNED.colour, 1.5)
    for axes, columns in ((upper, INTERVAL), (lower, OVER)):
        draw_bars(axes, rows["simulations"], rows[columns], color=PLANNER, marker="o")
        pages.mark_sizes(axes, sizes)
    across = "simulations a decision, to the end of the trajectory (log scale)"
    figures.name_panel(lower, "reward over the learned policy’s, on the same episodes", across)
    figures.finish_by_size(upper, figures.REWARD_AXIS, sizes, (1.4, 1.4), labels)
    return figure


def _draw_horizons(design: Planning, figure2: pd.DataFrame, figure3: pd.DataFrame, title: str) -> Figure:
    """Reward by planning horizon at the left, the gain of one more step at the right."""
    place = {"left": 0.07, "right": 0.985, "bottom": 0.12, "wspace": 0.16}
    figure, top, panels = figures.panels(title, (WIDTH_INCHES, 4.4), (1, 2), 0.18, (False, False), **place)
    left, right = panels[0]
    horizons, steps = figure3["planning_horizon"].to_numpy(), figure3.iloc[1:]
    draw_bars(left, horizons, figure3[INTERVAL], color=PLANNER, marker="o", label="POMDP planner")
    best = max(records(figure2, kind=str(StudyKind.HEURISTIC)), key=lambda row: row["mean_reward"])["policy"]
    for who in (LEARNED, design.contenders[best]):
        mean = float(row_of(figure2, policy=who.name)["mean_reward"])
        left.axhline(mean, color=who.colour, linestyle=(0, who.dashes), linewidth=1.5, zorder=1.2, label=who.label)
    draw_zero(right)
    more = steps[three("over_previous")]
    draw_bars(right, steps["planning_horizon"], more, color=PLANNER, marker="o", linestyle="none")
    for axes, name in ((left, figures.REWARD_AXIS), (right, "reward that one more step gains")):
        figures.name_panel(axes, name, "planning horizon [steps]")
        axes.set_xticks(horizons)
        axes.set_xlim(horizons.min() - 0.4, horizons.max() + 0.4)
        pages.draw_grid(axes)
    pages.write_legend(figure, pages.named_curves(left), top - 0.005)
    return figure


def _numbers(design: Planning, tables: Tables) -> Listing:
    cells = {
        "policy": lambda row: design.contenders[row["policy"]].label,
        "decision [ms], measured": lambda row: significant(row["decision_ms"], 2),
        "reward": lambda row: estimated_in(row, INTERVAL),
        "policy − learned": lambda row: MISSING if row["policy"] == LEARNED.name else estimated_in(row, OVER),
        "episodes": lambda row: str(row["repetitions"] * row["episodes"]),
    }
    learning_s = tables["learning"]["learning_s"].iloc[0]
    caption = words(design.name, "numbers", design=design, learning_s=learning_s)
    return Listing.of("The numbers of Figures 2 and 3", caption, records(tables["figure2"]), cells)
