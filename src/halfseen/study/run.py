"""The study from end to end: look, measure decision times, repeat, tabulate, draw, report."""

from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
from matplotlib.figure import Figure
from tqdm import tqdm

from halfseen.perception import View
from halfseen.perception.picture import draw
from halfseen.study.design import StudyDesign
from halfseen.study.figures import figure1_of, figure4_of, write_figure
from halfseen.study.findings import LEARNED
from halfseen.study.grasp import run_grasp_repetition
from halfseen.study.grasp_figure import figure5_of
from halfseen.study.grasp_tables import calibration, grasp_frame, grasp_table, grasp_tests
from halfseen.study.map_figure import map_figure_of
from halfseen.study.map_repetition import map_cut_rates, run_map_repetition
from halfseen.study.map_table import map_table
from halfseen.study.planning import (
    Planner,
    learning_time_s,
    planner_times_ms,
    planning_contenders,
    run_planning_repetition,
)
from halfseen.study.planning_figure import figure2_for, figure3_for
from halfseen.study.planning_table import figure2, figure3, planner_rows, planning_frames, strongest_within
from halfseen.study.policies import HEURISTICS, heuristics, logging_policy
from halfseen.study.regret import SmallTables, run_regret_baselines, run_regret_repetition, small_tables
from halfseen.study.regret_figure import regret_figure_for
from halfseen.study.regret_table import regret_table
from halfseen.study.repetition import CutRates, cut_rates, run_repetition
from halfseen.study.report import write_report
from halfseen.study.results import BUDGETS_MS, StudyResults
from halfseen.study.scenes import look_at, scenes_of
from halfseen.study.sentences import plain_sentences
from halfseen.study.store import Store, as_json, write_text
from halfseen.study.tables import baseline_frame, figure1, figure4, learned_frame, strongest, table1, weights
from halfseen.study.timing import decision_times_ms
from halfseen.tables.features import NUM_FEATURES
from halfseen.tables.table_policy import LinearTablePolicy
from halfseen.world.action_space import Verb
from halfseen.world.episodes import play
from halfseen.world.scene import Scene
from halfseen.world.state import Layout, TableState, pad_scenes

NUM_TIMED_STATES = 60
TABLES = ("figure1", "figure2", "figure3", "figure4", "figure5", "table1", "grasp", "grasp_tests", "map", "regret")
FIGURES: dict[str, Callable[..., Figure]] = {
    "figure1": figure1_of,
    "figure2": figure2_for,
    "figure3": figure3_for,
    "figure4": figure4_of,
    "figure5": figure5_of,
    "map": map_figure_of,
    "regret": regret_figure_for,
}
PACKAGES = ("halfseen", "jax", "jaxlib", "mujoco", "numpy", "pandas", "scipy")


class Pieces(NamedTuple):
    """Plain numbers of each part of the study, one for each repetition."""

    main: list[dict[str, Any]]
    planning: list[dict[str, Any]]
    grasp: list[dict[str, Any]]
    regret_baselines: dict[str, Any]
    regret: list[dict[str, Any]]
    map: list[dict[str, Any]]


def run_study(design: StudyDesign, clouds: Sequence[Path], folder: Path, *, is_resumed: bool = False) -> StudyResults:
    """Run the study and write all that it makes into a folder.

    Parameters
    ----------
    design
        What to do.
    clouds
        Captured tables.
    folder
        Where to write: report.html, figure1.csv to figure5.csv, table1.csv, grasp.csv, grasp_tests.csv, regret.csv,
        map.csv, figures as .svg and .png, study.json; and ``progress/``, from which a killed study is resumed.
    is_resumed
        Go on where a killed study stopped.

    Raises
    ------
    ArgumentError
        The folder cannot be written, or holds another study that is to be resumed.
    """
    views = look_at(clouds)
    scenes = scenes_of(views, clouds)
    store = Store(folder, _fingerprint(design, clouds), is_resumed)
    layouts = pad_scenes(scenes)
    contenders = planning_contenders(
        design.world, design.planning_horizons, design.planning_simulations, design.search_simulations
    )
    times_ms = _decision_times(design, contenders, layouts, store)
    rates = cut_rates(design, layouts)
    learning_s = _kept(store, "learning_s", lambda: learning_time_s(design, layouts, rates))
    tables = small_tables(design, design.regret_tables, design.regret_horizon)
    pieces = Pieces(
        main=_repetitions(design, layouts, rates, store),
        planning=_planning_repetitions(design, contenders, layouts, rates, store),
        grasp=_grasp_repetitions(design, scenes, layouts, rates, store),
        regret_baselines=_kept(store, "regret-baselines", lambda: run_regret_baselines(tables)),
        regret=_regret_repetitions(design, tables, store),
        map=_map_repetitions(design, store),
    )
    results = tabulate(design, scenes, pieces, times_ms, learning_s)
    write_results(results, _pictures(views, scenes), folder)
    return results


def _fingerprint(design: StudyDesign, clouds: Sequence[Path]) -> dict[str, Any]:
    """All that a piece depends on; more repetitions add pieces and change none."""
    fixed = {key: value for key, value in design.as_dict().items() if not key.endswith("repetitions")}
    return {"design": fixed, "clouds": [path.name for path in clouds], "versions": versions()}


def versions() -> dict[str, str]:
    """Versions of the packages that the numbers depend on."""
    return {name: version(name) for name in PACKAGES}


def _decision_times(
    design: StudyDesign, contenders: dict[str, Planner], layouts: Layout, store: Store
) -> dict[str, np.ndarray]:
    """Measured once, first, and kept: a resumed study reports what the killed one measured."""
    kept = store.get("decision_times_ms")
    if kept is None:
        # The time of a learned decision does not depend on what was learned.
        unlearned = jnp.zeros((design.world.horizon, len(Verb), NUM_FEATURES + 1), dtype=jnp.float32)
        policies = {LEARNED: LinearTablePolicy(unlearned)} | heuristics(design)
        states = _states_along_the_way(design, layouts)
        times = decision_times_ms(policies, states, NUM_TIMED_STATES) | planner_times_ms(contenders, states)
        kept = store.put("decision_times_ms", {name: values.tolist() for name, values in times.items()})
    return {name: np.array(values) for name, values in kept.items()}


def _states_along_the_way(design: StudyDesign, layouts: Layout) -> TableState:
    """One state from each of many paths, early and late ones in turn."""
    episodes = play(design.world, layouts, logging_policy(design), jax.random.key(design.seed), NUM_TIMED_STATES)
    num_stages = np.asarray(episodes.is_taken).sum(axis=1)
    paths = np.arange(NUM_TIMED_STATES)
    return jax.tree.map(lambda leaf: leaf[paths, paths % num_stages], episodes.states)


def _repetitions(design: StudyDesign, layouts: Layout, rates: CutRates, store: Store) -> list[dict[str, Any]]:
    """All repetitions, those already kept read back."""
    # In turn: two threads that execute compiled code at once can wait for one another for ever (seen with jaxlib 0.10).
    return [
        _kept(store, f"repetition-{k:05d}", lambda k=k: run_repetition(design, layouts, rates, k))
        for k in tqdm(range(design.repetitions), desc="repetitions", unit="rep", disable=None)
    ]


def _planning_repetitions(
    design: StudyDesign, contenders: dict[str, Planner], layouts: Layout, rates: CutRates, store: Store
) -> list[dict[str, Any]]:
    """The repetitions of the planners, those already kept read back."""
    return [
        _kept(store, f"planning-{k:05d}", lambda k=k: run_planning_repetition(design, contenders, layouts, rates, k))
        for k in tqdm(_up_to(design, design.planning_repetitions), desc="planners", unit="rep", disable=None)
    ]


def _regret_repetitions(design: StudyDesign, tables: SmallTables, store: Store) -> list[dict[str, Any]]:
    """The repetitions on small tables, those already kept read back."""
    return [
        _kept(store, f"regret-{k:05d}", lambda k=k: run_regret_repetition(tables, design.regret_num_paths, k))
        for k in tqdm(_up_to(design, design.regret_repetitions), desc="small tables", unit="rep", disable=None)
    ]


def _up_to(design: StudyDesign, num_repetitions: int) -> range:
    return range(min(design.repetitions, num_repetitions))


def _grasp_repetitions(
    design: StudyDesign, scenes: Sequence[Scene], layouts: Layout, rates: CutRates, store: Store
) -> list[dict[str, Any]]:
    """The repetitions of the grasp ablation, those already kept read back."""
    return [
        _kept(store, f"grasp-{k:05d}", lambda k=k: run_grasp_repetition(design, scenes, layouts, rates, k))
        for k in tqdm(_up_to(design, design.grasp_repetitions), desc="grasp models", unit="rep", disable=None)
    ]


def _map_repetitions(design: StudyDesign, store: Store) -> list[dict[str, Any]]:
    """The repetitions of the map, those already kept read back."""
    rates = map_cut_rates(design, design.clutter_map)
    return [
        _kept(store, f"map-{k:05d}", lambda k=k: run_map_repetition(design, design.clutter_map, rates, k))
        for k in tqdm(_up_to(design, design.map_repetitions), desc="map", unit="rep", disable=None)
    ]


def _kept(store: Store, name: str, make: Callable[[], Any]) -> Any:
    """A piece of the study, made if it is not there."""
    kept = store.get(name)
    return store.put(name, make()) if kept is None else kept


def tabulate(
    design: StudyDesign,
    scenes: tuple[Scene, ...],
    pieces: Pieces,
    times_ms: dict[str, np.ndarray],
    learning_s: float,
) -> StudyResults:
    """Make the tables and the answer in words."""
    learned, baselines, planned = (
        learned_frame(pieces.main),
        baseline_frame(pieces.main),
        planning_frames(pieces.planning),
    )
    by_time = figure2(planned, times_ms)
    planners = {name: strongest_within(by_time, budget_ms) for name, budget_ms in BUDGETS_MS.items()}
    found = {name: planner for name, planner in planners.items() if planner is not None}
    planner, heuristic = list(found)[-1], strongest(baselines, HEURISTICS)
    grasp = grasp_frame(pieces.grasp)
    against = planner_rows(planned, by_time, times_ms, BUDGETS_MS)
    tables = (
        figure1(learned, baselines, by_time, found),
        table1(learned, baselines, times_ms, against, design),
        figure4(learned, design),
    )
    return StudyResults(
        design=design,
        scenes=scenes,
        figure1=tables[0],
        table1=tables[1],
        figure2=by_time,
        figure3=figure3(planned, times_ms, design.planning_simulations),
        learning_s=learning_s,
        figure4=tables[2],
        weights=weights(learned),
        grasp=grasp_table(grasp, design),
        grasp_tests=grasp_tests(grasp, design),
        figure5=calibration(grasp),
        map=map_table(pieces.map, design.clutter_map, design.world),
        regret=regret_table(pieces.regret_baselines, pieces.regret),
        strongest_planners=found,
        best_planner=planner,
        best_heuristic=heuristic,
        sentences=plain_sentences(*tables, design, planner, heuristic),
        versions=versions(),
    )


def write_results(results: StudyResults, pictures: dict[str, bytes], folder: Path) -> None:
    """Write tables, figures and report, each whole or not at all."""
    for name in TABLES:
        frame: pd.DataFrame = getattr(results, name)
        write_text(folder / f"{name}.csv", frame.to_csv(index=False, lineterminator="\n"))
    for name, figure_of in FIGURES.items():
        write_figure(figure_of, results, folder, name)
    write_text(folder / "study.json", as_json(_as_dict(results)))
    write_report(results, pictures, folder)


def _as_dict(results: StudyResults) -> dict[str, Any]:
    tables = {name: _records(getattr(results, name)) for name in (*TABLES, "weights")}
    return {
        "answer": results.sentences,
        "best_heuristic": results.best_heuristic,
        "best_planner": results.best_planner,
        "learning_s": results.learning_s,
        "strongest_planners": results.strongest_planners,
        "design": results.design.as_dict(),
        "scenes": [{"name": scene.name, "hides": scene.hides.tolist()} for scene in results.scenes],
        "versions": results.versions,
        **tables,
    }


def _records(frame: pd.DataFrame) -> list[dict[str, Any]]:
    return frame.astype(object).where(frame.notna(), None).to_dict(orient="records")


def _pictures(views: Sequence[View], scenes: Sequence[Scene]) -> dict[str, bytes]:
    """What perception saw, as PNG, by scene."""
    pictures = {}
    with TemporaryDirectory() as folder:
        for view, scene in zip(views, scenes, strict=True):
            path = Path(folder) / f"{scene.name}.png"
            draw(view, path)
            pictures[scene.name] = path.read_bytes()
    return pictures
