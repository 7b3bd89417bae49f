"""The report: one page that opens with the answer and stands alone, without scripts or anything to load."""

import base64
import re
from collections.abc import Callable, Mapping
from dataclasses import asdict, fields
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
import pandas as pd
from markupsafe import Markup, escape
from matplotlib.figure import Figure

from halfseen.errors import ArgumentError
from halfseen.study import figures, wording
from halfseen.study.design import LOG_RANDOM_SHARE, StudyDesign
from halfseen.study.findings import WEIGHTED, Estimate, learned
from halfseen.study.grasp_figure import figure5_of
from halfseen.study.grasp_words import figure5_title, grasp_sentence
from halfseen.study.map_figure import map_figure_of
from halfseen.study.map_words import map_sentence, map_title
from halfseen.study.planning_figure import figure2_for, figure3_for
from halfseen.study.planning_words import figure2_title, figure3_title, horizon_sentence, planning_sentence, policy_name
from halfseen.study.regret_figure import regret_figure_for
from halfseen.study.regret_words import regret_sentence, regret_title
from halfseen.study.results import BASELINE_NAMES, GRASP_MEASURES, GRASP_NAMES, MEASURES, TREATMENT_NAMES, StudyResults
from halfseen.study.sentences import figure1_title, figure4_title
from halfseen.world.scene import Scene

CLAIMS = {"reward": "learned earns more", "decision_ms": "learned decides faster", "robot_s": "learned ends sooner"}

WORLD_WORDS = {
    "dirty_share": "share of dirty objects",
    "grasping.offset_std": "spread of the hidden grip offset",
    "grasping.log_time": "log time to grasp, unhidden [log s]",
    "grasping.log_time_per_occlusion": "log time to grasp, added when wholly hidden [log s]",
    "grasping.limit_s": "an attempt is given up after [s]",
    "transport_s": "transport after each attempt [s]",
    "reward_wash_dirty": "reward of washing a dirty object",
    "reward_wash_clean": "reward of washing a clean object",
    "reward_wash_failed": "reward of a failed attempt to wash",
    "reward_lift_per_s": "reward of lifting, a second [1/s]",
    "reward_dirty_left": "reward for each dirty object left",
    "seeing.floor": "a label is right with probability at least",
    "seeing.gain": "added to that for an object in full view",
    "seeing.power": "how steeply this falls with occlusion (power)",
    "horizon": "steps of a path at most",
}
DESIGN_WORDS = {
    "repetitions": "repetitions",
    "num_paths": "logged paths",
    "cut_shares": "shares of cut paths",
    "episodes_per_scene": "evaluation episodes of each table and repetition",
    "planning_horizons": "steps that the planner looks ahead",
    "treatment_cut_share": "share of cut paths in Figure 4",
    "treatment_cut_kinds": "kinds of cuts in Figure 4",
    "table_num_paths": "logged paths in Table 1",
    "table_cut_share": "share of cut paths in Table 1",
    "grasp_num_paths": "logged paths in Figure 5",
    "grasp_repetitions": "repetitions in Figure 5 at most",
    "map_repetitions": "repetitions of the map at most",
    "planning_simulations": "simulations a decision, at each planning horizon",
    "search_simulations": "decision budgets: aim, simulations, episodes of a repetition",
    "planning_repetitions": "repetitions of the planners at most",
    "regret_tables": "small tables",
    "regret_horizon": "steps of a path on small tables",
    "regret_num_paths": "logged paths on small tables",
    "regret_repetitions": "repetitions on small tables at most",
    "alpha": "level of the tests",
    "seed": "seed",
}
MAP_WORDS = {
    "num_objects": "map: objects",
    "occlusions": "map: mean hidden share of an object",
    "label_gains": "map: added to the chance of a right label in full view",
    "wash_clean_rewards": "map: reward of washing a clean object",
    "grip_offset_stds": "map: spread of the hidden grip offset",
    "num_paths": "map: logged paths",
    "cut_share": "map: share of cut paths",
    "num_tables": "map: random tables of each repetition",
    "episodes_per_table": "map: evaluation episodes of each table and repetition",
    "worthwhile_share": "map: gain from which on learning is worth it",
}
# Smaller shares are within what perception errs.
SMALLEST_HIDDEN_SHARE = 0.02


def write_report(results: StudyResults, pictures: Mapping[str, bytes], folder: Path) -> None:
    """Write ``report.html``.

    Parameters
    ----------
    results
        What the study found.
    pictures
        PNG of each scene, by its name; a scene without one is described in words alone.
    folder
        Where to; made if it is not there.

    Raises
    ------
    ArgumentError
        A picture belongs to no scene.
    """
    names = [scene.name for scene in results.scenes]
    for name in pictures:
        if name not in names:
            raise ArgumentError(
                f"a picture of {name!r}, but the scenes are {', '.join(names)}; name it after its scene"
            )
    environment = jinja2.Environment(
        autoescape=True, undefined=jinja2.StrictUndefined, trim_blocks=True, lstrip_blocks=True
    )
    environment.globals.update(amount=wording.amount, measured=wording.measured, interval=wording.interval)
    environment.globals.update(p_value=wording.p_value, share=wording.share, difference=wording.difference)
    template = environment.from_string(files("halfseen.study").joinpath("report.html.j2").read_text(encoding="utf-8"))
    page = template.render(_content(results, pictures))
    figures.write_whole(folder / "report.html", page.encode())


def _content(results: StudyResults, pictures: Mapping[str, bytes]) -> dict[str, Any]:
    """Everything that the template names."""
    design = results.design
    rivals = (results.best_planner, results.best_heuristic)
    titles = (
        figure1_title(results.figure1, results.table1, design, rivals),
        figure4_title(results.figure4, design),
        figure5_title(results.grasp_tests),
        map_title(results.map, design.world),
        figure2_title(results.figure2),
        figure3_title(results.figure3),
        regret_title(results.regret, design.table_cut_share),
    )
    return {
        "sentences": results.sentences,
        "titles": titles,
        "design": design,
        "log_random_share": wording.share_in_words(LOG_RANDOM_SHARE),
        "logging_heuristic": BASELINE_NAMES["history-penalty"],
        "figure1": inline_svg(partial(figures.figure1_of, is_titled=False), results, "f1", titles[0]),
        "figure1_numbers": _figure1_numbers(results),
        "figure4": inline_svg(partial(figures.figure4_of, is_titled=False), results, "f4", titles[1]),
        "figure4_counts": _count_intervals(results.figure4),
        "figure4_numbers": _figure4_numbers(results.figure4),
        "figure5": inline_svg(partial(figure5_of, is_titled=False), results, "f5", titles[2]),
        "grasp_sentence": grasp_sentence(results.grasp_tests, design),
        "grasp_numbers": _grasp_numbers(results.grasp),
        "grasp_repetitions": int(results.grasp["repetitions"].iloc[0]),
        "grasp_tests": _grasp_tests(results.grasp_tests),
        "figure2": inline_svg(partial(figure2_for, is_titled=False), results, "f2", titles[4]),
        "figure3": inline_svg(partial(figure3_for, is_titled=False), results, "f3", titles[5]),
        "planning_sentence": planning_sentence(results.figure2),
        "horizon_sentence": horizon_sentence(results.figure3),
        "planning_rows": _planning_rows(results.figure2),
        "strongest": {BASELINE_NAMES[name]: policy_name(of) for name, of in results.strongest_planners.items()},
        "learning_s": results.learning_s,
        "regret_figure": inline_svg(partial(regret_figure_for, is_titled=False), results, "f7", titles[6]),
        "regret_sentence": regret_sentence(
            results.regret, design.table_cut_share, design.regret_tables, design.regret_horizon
        ),
        "regret_rows": _regret_rows(results.regret),
        "map_figure": inline_svg(partial(map_figure_of, is_titled=False), results, "map-figure", titles[3]),
        "map_sentence": map_sentence(results.map, design.clutter_map, design.world),
        "map_rows": [row | {"best": BASELINE_NAMES[row["best_heuristic"]]} for row in results.map.to_dict("records")],
        "map_repetitions": int(results.map["repetitions"].iloc[0]),
        "clutter_map": design.clutter_map,
        "map_share": wording.share_in_words(design.clutter_map.cut_share),
        "best_planner": BASELINE_NAMES.get(results.best_planner, results.best_planner),
        "best_heuristic": BASELINE_NAMES.get(results.best_heuristic, results.best_heuristic),
        "table1": _table1(results.table1),
        "num_adjusted": int(results.table1["p_holm"].notna().sum()),
        "table_share": wording.share_in_words(design.table_cut_share),
        "treatment_share": wording.share_in_words(design.treatment_cut_share),
        "weights": _weights(results.weights, design),
        "scenes": [_scene(scene, pictures.get(scene.name)) for scene in results.scenes],
        "world": _in_words(_flat(asdict(design.world)), WORLD_WORDS),
        "parameters": _in_words(_own_numbers(design), DESIGN_WORDS) + _in_words(asdict(design.clutter_map), MAP_WORDS),
        "changed": _changed(design),
        "versions": dict(sorted(results.versions.items())),
    }


def inline_svg(figure_of: Callable[[StudyResults], Figure], results: StudyResults, prefix: str, title: str) -> Markup:
    """Draw a figure as an SVG element to stand in a page beside others.

    Parameters
    ----------
    figure_of
        `figure1_of`, `figure4_of` or `figure5_of`.
    results
        What the study found.
    prefix
        Put before every id, which must be unique in a page.
    title
        What it shows, for those who do not see it.
    """
    text = figures.svg(figure_of, results).decode()
    text = text[text.index("<svg") :]
    text = re.sub(r'\s(?:xmlns(?::xlink)?|version)="[^"]*"', "", text)
    text = re.sub(r"<!--.*?-->\s*", "", text, flags=re.DOTALL).replace("xlink:href", "href")
    # A page's style sheet reaches all of the page, so this one is bound to its figure.
    text = text.replace("*{stroke-linejoin", f"#{prefix} *{{stroke-linejoin", 1)
    text = re.sub(r'\bid="', f'id="{prefix}-', text)
    text = re.sub(r'(href="#|url\(#)', rf"\g<1>{prefix}-", text)
    text = re.sub(
        r'(<svg)\swidth="[^"]*"\sheight="[^"]*"([^>]*>)', rf'\1 id="{prefix}" role="img"\2TITLE', text, count=1
    )
    text = text.replace("TITLE", f"<title>{escape(title)}</title>", 1)
    return Markup(text.strip())


def _table1(table1: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows of Table 1, a group for each measure."""
    groups = []
    for measure, name in MEASURES.items():
        rows = [
            {**row, "name": BASELINE_NAMES.get(row["baseline"], row["baseline"]), "supported": bool(row["supported"])}
            for row in table1.to_dict("records")
            if row["measure"] == measure
        ]
        if rows:
            groups.append({"measure": measure, "name": name, "claim": CLAIMS[measure], "rows": rows})
    return groups


def _planning_rows(figure2: pd.DataFrame) -> list[dict[str, Any]]:
    return [row | {"name": policy_name(row["policy"])} for row in figure2.to_dict("records")]


def _regret_rows(regret: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows of the table of regrets, with names for people and an interval where something was repeated."""
    return [
        {
            "name": policy_name(row["policy"]),
            "num_paths": None if pd.isna(row["num_paths"]) else int(row["num_paths"]),
            "cut": None if pd.isna(row["cut_share"]) else wording.share(float(row["cut_share"])),
            "regret": Estimate(float(row["regret"]), float(row["se"])),
            "percent": 100 * float(row["regret_share"]),
        }
        for row in regret.to_dict("records")
    ]


def _grasp_tests(tests: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows of Table 3, a group for each measure."""
    rows = [{str(name): value for name, value in row.items()} for row in tests.to_dict("records")]
    return [
        {
            "name": name,
            "decimals": _decimals(measure),
            "rows": [row | {"supported": bool(row["supported"])} for row in rows if row["measure"] == measure],
        }
        for measure, name in GRASP_MEASURES.items()
    ]


def _grasp_numbers(grasp: pd.DataFrame) -> list[dict[str, Any]]:
    return [
        {
            "name": GRASP_NAMES[row["model"]],
            "num_paths": int(row["num_paths"]),
            "estimates": [
                (Estimate(row[measure], row[f"{measure}_se"]), _decimals(measure)) for measure in GRASP_MEASURES
            ],
        }
        for row in grasp.to_dict("records")
    ]


def _decimals(grasp_measure: str) -> int:
    return 2 if grasp_measure.endswith("reward") else 4


def _figure1_numbers(results: StudyResults) -> list[dict[str, Any]]:
    """Learned policy: for each size of log, an estimate at each share of cut paths."""
    design = results.design
    return [
        {"num_paths": size, "estimates": [learned(results.figure1, size, cut_share) for cut_share in design.cut_shares]}
        for size in design.num_paths
    ]


def _figure4_numbers(figure4: pd.DataFrame) -> list[dict[str, Any]]:
    return [
        {
            "cut_kind": wording.CUT_KIND_NAMES[row["cut_kind"]],
            "treatment": TREATMENT_NAMES[row["treatment"]],
            "num_paths": int(row["num_paths"]),
            "reward": Estimate(row["mean_reward"], row["se"]),
            "gain": None if row["treatment"] == WEIGHTED else Estimate(row["behind_weighted"], row["se_behind"]),
        }
        for row in figure4.to_dict("records")
    ]


def _count_intervals(figure4: pd.DataFrame) -> dict[str, int]:
    """How many intervals of the paired differences lie above 0 and below 0."""
    others = figure4[figure4["treatment"] != WEIGHTED]
    pairs = zip(others["behind_weighted"], others["se_behind"], strict=True)
    signs = [Estimate(float(mean), float(se)).sign for mean, se in pairs]
    return {"all": len(signs), "above": signs.count(1), "below": signs.count(-1)}


def _weights(weights: pd.DataFrame, design: StudyDesign) -> list[dict[str, Any]]:
    """Weights of each size of log at each share of cut paths; None where the study has none."""
    table = []
    for size in design.num_paths:
        cells = []
        for cut_share in design.cut_shares:
            is_here = (weights["num_paths"] == size) & np.isclose(np.asarray(weights["cut_share"], float), cut_share)
            rows = pd.DataFrame(weights[is_here]).to_dict("records")
            cells.append(rows[0] if rows else None)
        table.append({"num_paths": size, "cells": cells})
    return table


def _scene(scene: Scene, picture: bytes | None) -> dict[str, Any]:
    occlusion = scene.occlusion
    pairs = np.argwhere(scene.hides >= SMALLEST_HIDDEN_SHARE)
    hidden = {int(i): [(int(j), float(scene.hides[i, j])) for k, j in pairs if k == i] for i in np.unique(pairs[:, 0])}
    return {
        "name": Path(scene.name).stem.replace("_", " "),
        "picture": None if picture is None else base64.b64encode(picture).decode(),
        "num_objects": scene.num_objects,
        "mean": float(np.mean(occlusion)) if len(occlusion) else 0.0,
        "max": float(np.max(occlusion)) if len(occlusion) else 0.0,
        "hidden": [
            {"object": i, "occlusion": float(occlusion[i]), "by": sorted(by, key=lambda pair: (-pair[1], pair[0]))}
            for i, by in sorted(hidden.items(), key=lambda item: (-occlusion[item[0]], item[0]))
        ],
    }


def _own_numbers(design: StudyDesign) -> dict[str, Any]:
    """The design without the world and the places of the map, which have words of their own."""
    return {name: value for name, value in design.as_dict().items() if name not in ("world", "clutter_map")}


def _flat(values: Mapping[str, Any]) -> dict[str, Any]:
    """The numbers of the laws among those of the world, as ``"seeing.floor"``."""
    laws = {f"{law}.{name}": value for law in ("grasping", "seeing") for name, value in values[law].items()}
    return {name: value for name, value in values.items() if name not in ("grasping", "seeing")} | laws


def _in_words(values: Mapping[str, Any], words: Mapping[str, str]) -> list[tuple[str, str, str]]:
    """Parameters as (name for people, name in the code, value)."""
    return [(words.get(name, name.replace("_", " ")), name, _written(name, value)) for name, value in values.items()]


def _written(name: str, value: Any) -> str:
    if isinstance(value, (tuple, list)):
        return ", ".join(_written(name, each) for each in value)
    if isinstance(value, str):
        return wording.CUT_KIND_NAMES.get(value, value)
    is_cut_share = name in ("cut_shares", "treatment_cut_share", "table_cut_share", "cut_share")
    return wording.share(value) if is_cut_share else f"{value:g}".replace("-", "−")


def _changed(design: StudyDesign) -> list[str]:
    """Parameters beyond repetitions and seed that are not the default: the command does not set them."""
    default = StudyDesign()
    own = [field.name for field in fields(design) if field.name not in ("repetitions", "seed")]
    return [name for name in own if getattr(design, name) != getattr(default, name)]
