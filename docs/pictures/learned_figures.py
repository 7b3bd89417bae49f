"""What is learned, drawn from numbers that take half a minute or more: kept tables, of which a test makes a part again."""

import sys
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from halfseen.logs import Logs, read_logs
from halfseen.pages.palette import ALARM, BLUE, GREEN, INK, ORANGE, SOFT
from pictures.guide_pages import names_after
from pictures.picture import ROOT, Numbers, Picture, Row, Table, plot
from pictures.style import LEGEND, figure, panel

sys.path += [str(ROOT / "examples" / "pick_cell"), str(ROOT / "examples")]


# One decision for a part, as the guide asks for it.


def _decided() -> Table:
    """What `halfseen act` says of the part of the guide, by the policy that `halfseen learn` makes."""
    from click.testing import CliRunner

    from halfseen.cli import halfseen
    from halfseen.policies import NamedObservation, decider_of, read_policy

    with TemporaryDirectory() as folder:
        command = ["learn", str(ROOT / "examples/pick_cell/logs"), "--out", f"{folder}/policy", "--no-verdict"]
        done = CliRunner().invoke(halfseen, command, catch_exceptions=False)
        assert done.exit_code == 0, done.output
        stored = read_policy(Path(folder) / "policy")
    part = pd.DataFrame({"weight_kg": [0.8], "shine": [0.3], "clutter": [0.6]})
    decision = decider_of(stored).decide(NamedObservation(part, stage=1))
    return [
        {
            "action": name,
            "q": q,
            "low": decision.intervals[name][0],
            "high": decision.intervals[name][1],
            "chance_best": decision.chance_best[name],
            "reason": decision.reason if name == decision.action else "",
        }
        for name, q in decision.q_values.items()
        if q is not None
    ]


def _draw_decision() -> bytes:
    from halfseen.pages.decision_picture import draw_decision
    from halfseen.policies import Decision

    rows = DECISION_NUMBERS.read()
    (chosen,) = (row for row in rows if row["reason"])
    decision = Decision(
        action=chosen["action"],
        q_values={row["action"]: row["q"] for row in rows},
        reason=chosen["reason"],
        warnings=(),
        intervals={row["action"]: (row["low"], row["high"]) for row in rows},
        chance_best={row["action"]: row["chance_best"] for row in rows},
    )
    with TemporaryDirectory() as folder:
        file = Path(folder) / "decision.svg"
        draw_decision(decision, file, stage=1, horizon=4)
        return file.read_bytes()


DECISION_NUMBERS = Numbers("decision.csv", _decided, lambda: dict(enumerate(_decided())))


# Q of the treatments of the small trial.


def _treatments() -> Table:
    names = names_after("any-multistage-problem", 0, 1)
    grid = pd.DataFrame({"tumour": np.linspace(0.0, 1.0, 41)})
    q = names["learner"].q_values(grid, stage=2)
    columns = list(names["learner"].policy_.actions)
    return [
        {"tumour": row, **dict(zip(columns, values.tolist(), strict=True))} for row, values in zip(grid["tumour"], q)
    ]


def draw_treatments(rows: Table) -> Figure:
    """Draw what is learned of three treatments beside how the page makes them."""
    made, axes = panel(3.0, "size of the tumour", "Q of the second stage [years]")
    tumour = np.array([row["tumour"] for row in rows])
    truth = {"A": 0.2 + tumour, "B": 1.2 - tumour, "C": np.full(tumour.shape, 1.0)}
    for (name, mean), colour in zip(truth.items(), (BLUE, ORANGE, GREEN), strict=True):
        axes.plot(tumour, [row[name] for row in rows], color=colour, label=f"{name}, learned")
        axes.plot(tumour, mean, "--", color=colour, lw=1.2, label="in truth")
    made.legend(loc="outside lower center", ncols=3, **LEGEND)
    return made


# Medians of times that were cut.


def _medians() -> Table:
    import contextlib
    import io

    with contextlib.redirect_stdout(io.StringIO()):
        names = names_after("times-that-were-cut", 0)
    grid = np.linspace(0.0, 1.0, 21)[:, None]
    found: dict[str, list[float]] = {"clutter": grid[:, 0].tolist()}
    for censoring in ("none", "kaplan-meier", "cox"):
        median = names["CensoredSVR"](loss="absolute", target="log", censoring=censoring)
        median.fit(names["clutter"], names["survival_array"](names["end_s"], names["is_finished"]))
        found[censoring] = np.exp(median.predict(grid)).tolist()
    return [dict(zip(found, row, strict=True)) for row in zip(*found.values(), strict=True)]


def draw_medians(rows: Table) -> Figure:
    """Draw attempts, cut ones hollow, and the medians that are estimated from them beside the truth."""
    rng = np.random.default_rng(0)
    clutter = rng.uniform(size=(400, 1))
    time_s = np.exp(1.0 + clutter[:, 0] + 0.5 * rng.normal(size=400))
    cut_s = rng.exponential(20.0 * np.exp(-1.5 * clutter[:, 0]))
    end_s, is_finished = np.minimum(time_s, cut_s), time_s <= cut_s
    made, axes = panel(3.4, "clutter", "time until the grasp holds [s]")
    few = slice(0, 200)
    for is_it, look in (
        (is_finished[few], {"mfc": SOFT, "label": "held"}),
        (~is_finished[few], {"mfc": "w", "label": "cut"}),
    ):
        axes.plot(clutter[few, 0][is_it], end_s[few][is_it], "o", ms=3.2, mec=SOFT, mew=0.8, **look)
    across = [row["clutter"] for row in rows]
    for name, colour, told in (
        ("none", ALARM, "dropping what was cut"),
        ("kaplan-meier", ORANGE, "Kaplan–Meier weights"),
        ("cox", BLUE, "Cox weights"),
    ):
        axes.plot(across, [row[name] for row in rows], color=colour, lw=2.2, label=told)
    axes.plot(across, np.exp(1.0 + np.array(across)), "--", color=INK, lw=1.4, label="the true median")
    axes.set_ylim(0.0, 14.0)
    made.legend(loc="outside lower center", ncols=2, **LEGEND)
    return made


# Intervals of the value of a policy whose value is known.

NUM_INTERVALS, NUM_PATHS, FIRST_SEED = 40, 400, 5000


def _interval(index: int) -> Row:
    """The interval for the cell's rule of thumb, from one log of parts, and what that rule is worth in truth."""
    from cell_optimum import policy_value
    from cell_parts import ACTIONS_ALL, HORIZON
    from cell_paths import rule_of_thumb, simulate

    from halfseen.evaluation import evaluate
    from halfseen.policies import Rule

    names = np.array(ACTIONS_ALL, dtype=object)
    rule = Rule(lambda parts, stage: names[rule_of_thumb(parts, stage)], tuple(ACTIONS_ALL), HORIZON)
    found = evaluate(rule, simulate(NUM_PATHS, FIRST_SEED + index), against="logging").doubly_robust
    return {"value": found.value, "low": found.low, "high": found.high, "truth": policy_value(rule_of_thumb)}


def _intervals() -> Table:
    return [_interval(index) for index in range(NUM_INTERVALS)]


def draw_intervals(rows: Table) -> Figure:
    """Draw intervals, one for each log, across the true value."""
    made, axes = panel(3.8, "mean reward of a part under the rule of thumb", has_grid=False)
    num_held = 0
    for place, row in enumerate(rows):
        is_held = row["low"] <= row["truth"] <= row["high"]
        num_held += is_held
        colour = BLUE if is_held else ALARM
        axes.plot([row["low"], row["high"]], [place, place], color=colour, lw=2.0, solid_capstyle="butt")
        axes.plot(row["value"], place, "o", color=colour, ms=3.5)
    axes.axvline(rows[0]["truth"], color=INK, ls="--", lw=1.3)
    axes.set_yticks([])
    axes.spines["left"].set_visible(False)
    axes.set_ylabel(f"{len(rows)} logs of {NUM_PATHS} parts")
    axes.set_title(f"{num_held} of {len(rows)} intervals hold the truth, dashed", loc="left", fontsize=9.5)
    return made


# What another planner earns.


def _planners() -> Table:
    from halfseen.evaluation.simulation import evaluate_in_world

    names = names_after("another-planner", 0, 1, 2)
    config, scene, rows = names["config"], names["scene"], []
    for name, policy in names["contenders"].items():
        value = evaluate_in_world(policy, [scene], config, episodes=2000, seed=0).value
        rows.append({"policy": name, "value": float(value.value), "standard_error": float(value.standard_error)})
    return rows


def draw_planners(rows: Table) -> Figure:
    """Draw what the page's two policies earn."""
    made, axes = panel(1.5, "mean reward of 2,000 episodes", has_grid=False)
    for place, (row, colour) in enumerate(zip(rows, (BLUE, SOFT), strict=True)):
        axes.barh(place, row["value"], 0.55, color=colour)
        axes.errorbar(row["value"], place, xerr=1.96 * row["standard_error"], color=INK, capsize=3.0)
        axes.text(row["value"] + 2.2 * row["standard_error"], place, f"  {row['value']:.1f}", va="center")
    names = [row["policy"].replace(", counting", ",\ncounting") for row in rows]
    axes.set_yticks(range(len(rows)), names)
    axes.set_xlim(0.0, 1.4 * max(row["value"] for row in rows))
    axes.invert_yaxis()
    axes.tick_params(axis="y", length=0)
    return made


# The figure that the page on figures makes.


def _memory() -> Table:
    from halfseen.study import Setting, run_study
    from halfseen.world import Scene

    hides = np.zeros((4, 4))
    hides[1:, 0] = 0.7
    setting = Setting((Scene(hides, name="three behind one"),), repetitions=4)
    memory = names_after("another-figure", 0)["Memory"]()
    with TemporaryDirectory() as folder:
        results = run_study(setting, Path(folder), (memory,), num_jobs=1)
    return [{name: float(value) for name, value in results.tables[0]["memory"].iloc[0].items()}]


def draw_memory(rows: Table) -> Figure:
    """Draw it by the page's own class, under the title that the page's claim gives itself."""
    names = names_after("another-figure", 0)
    memory = names["Memory"]()
    table = pd.DataFrame(rows)
    drawing = memory.section(None, {"memory": table}).drawings[0]
    made = drawing.draw("")
    made.set_size_inches(4.8, 2.4)
    (axes,) = made.axes
    axes.set_position((0.2, 0.1, 0.76, 0.74))
    axes.axhline(0.0, color=INK, lw=1.0)
    axes.set(xticks=[], ylabel="gain from memory")
    axes.set_title("Memory − forgetting, with its 95 % interval", loc="left", fontsize=9.5)
    return made


# Learners of the pick cell.


def _methods(num_logs: int = 5) -> Table:
    from cell_comparison import compare
    from cell_optimum import optimum

    found = compare(1000, num_logs, 0).assign(share=lambda frame: frame["value"] / optimum()[0])
    return [{"log": row.log, "method": row.method, "share": float(row.share)} for row in found.itertuples()]


def draw_methods(rows: Table) -> Figure:
    """Draw the share of the optimum that each method reaches, a dot for each log."""
    from cell_optimum import optimum, policy_value
    from cell_paths import rule_of_thumb

    methods = list(dict.fromkeys(row["method"] for row in rows))
    made, axes = panel(2.7, "share of the optimum, learned from 1,000 parts", has_grid=False)
    for place, name in enumerate(methods):
        shares = [row["share"] for row in rows if row["method"] == name]
        axes.plot(shares, np.full(len(shares), place), "o", color=BLUE if name == "default" else SOFT, alpha=0.75)
        axes.plot(np.mean(shares), place, "|", color=INK, ms=16, mew=2.0)
    axes.axvline(policy_value(rule_of_thumb) / optimum()[0], color=ALARM, ls="--", lw=1.2, label="the rule of thumb")
    axes.set_yticks(range(len(methods)), methods)
    axes.tick_params(axis="y", length=0)
    axes.invert_yaxis()
    axes.legend(loc="upper left", **LEGEND)
    return made


# The tiger behind one of two doors.


def draw_tiger() -> Figure:
    """Draw what four actions are worth by what is believed, and where each is the first to take."""
    from tiger import NAMES, solved

    found, belief = solved(4), np.linspace(0.0, 1.0, 201)
    made, axes = panel(1.5, "probability that the tiger is on the left", has_grid=False)
    for row, steps in enumerate((1, 2, 3, 4)):
        actions = np.array([found.action_of([left, 1.0 - left], steps) for left in belief])
        for action, colour in enumerate((SOFT, ORANGE, BLUE)):
            axes.plot(
                belief[actions == action], np.full((actions == action).sum(), row), "s", ms=5.0, mew=0, color=colour
            )
    for name, colour in zip(NAMES, (SOFT, ORANGE, BLUE), strict=True):
        axes.plot([], [], "s", color=colour, label=name)
    axes.set_yticks(range(4), [f"{steps} left" for steps in (1, 2, 3, 4)])
    axes.set_ylim(3.6, -0.6)
    made.legend(loc="outside upper left", ncols=3, **LEGEND)
    return made


def _checked(compute, *indices: int) -> Mapping[int, Row]:
    return {index: compute(index) for index in indices}


def _some_methods() -> Mapping[int, Row]:
    """The first log of the comparison."""
    return dict(enumerate(_methods(1)))


def _whole(file: str, compute) -> Numbers:
    """Numbers that are made again as a whole within a minute."""
    return Numbers(file, compute, lambda: dict(enumerate(compute())))


PICTURES = (
    Picture("decision", "docs/static/guide/decision.svg", _draw_decision, DECISION_NUMBERS),
    plot("treatments", draw_treatments, _whole("treatments.csv", _treatments)),
    plot("medians", draw_medians, _whole("medians.csv", _medians)),
    plot("intervals", draw_intervals, Numbers("intervals.csv", _intervals, partial(_checked, _interval, 0, 1))),
    plot("two-planners", draw_planners, _whole("two-planners.csv", _planners)),
    plot("memory", draw_memory, _whole("memory.csv", _memory)),
    plot("pick-cell-learners", draw_methods, Numbers("pick-cell-learners.csv", _methods, _some_methods)),
    plot("tiger", draw_tiger),
)
