"""Made-up results of a study, for the tests of what is drawn and written from them."""

import numpy as np
import pandas as pd
from example_map import example_table
from example_planning import example_pieces, example_times
from example_regret import example_regret

from halfseen.study.design import TREATMENTS, StudyDesign
from halfseen.study.grasp_tables import calibration, grasp_frame, grasp_table, grasp_tests
from halfseen.study.planning_table import figure2, figure3, planning_frames
from halfseen.study.policies import HEURISTICS
from halfseen.study.results import BUDGETS_MS, GRASP_NAMES, MEASURES, StudyResults
from halfseen.study.sentences import plain_sentences
from halfseen.world.scene import Scene

BASELINE_REWARDS = dict(zip((*HEURISTICS, *BUDGETS_MS), (3.1, 3.6, 6.2, 6.4, 9.1, 9.15), strict=True))
SE = 0.09


def example_results(
    lead: float = 0.0, gain: float = 0.4, design: StudyDesign | None = None, svm_lead: float = 0.0
) -> StudyResults:
    """Make results in which the learned policy ends `lead` away from the best planner.

    Parameters
    ----------
    lead
        Over the best planner, of the policy that Table 1 compares.
    gain
        What weights buy over the other treatments under independent cuts; nothing under other cuts.
    design
        The default design if not given.
    svm_lead
        By how much the SVM's scores are better than the Beta mean's.
    """
    design = design or StudyDesign()
    figure1, figure4 = _figure1(design, lead), _figure4(design, lead, gain)
    table1 = _table1(design, lead)
    grasp = grasp_frame(_grasp_pieces(design, svm_lead))
    planned, times_ms = planning_frames(example_pieces(lead)), example_times()
    by_time = figure2(planned, times_ms)
    return StudyResults(
        design=design,
        scenes=example_scenes(),
        figure1=figure1,
        figure2=by_time,
        figure3=figure3(planned, times_ms, design.planning_simulations),
        learning_s=0.3,
        figure4=figure4,
        table1=table1,
        weights=_weights(design),
        grasp=grasp_table(grasp, design),
        grasp_tests=grasp_tests(grasp, design),
        figure5=calibration(grasp),
        map=example_table(lambda cell: 0.3 if cell.reward_wash_clean == -20 else 0.0, design.clutter_map),
        regret=example_regret(),
        strongest_planners={"planner-100ms": "search-5000", "planner-1s": "search-50000"},
        best_planner="planner-1s",
        best_heuristic="history-penalty",
        sentences=plain_sentences(figure1, table1, figure4, design, "planner-1s", "history-penalty"),
        versions={"numpy": "2.3.0", "halfseen": "0.1.0", "jax": "0.7.0"},
    )


def example_scenes(num_scenes: int = 10) -> tuple[Scene, ...]:
    rng = np.random.default_rng(0)
    scenes = []
    for k in range(num_scenes):
        num_objects = 5 + k % 6
        hides = np.triu(rng.beta(0.4, 1.6, (num_objects, num_objects)), 1)
        scenes.append(Scene(np.where(hides < 0.05, 0.0, hides), f"table_{k:02d}.pcd"))
    return tuple(scenes)


def _reward(design: StudyDesign, num_paths: int, cut_share: float, lead: float) -> float:
    end = max(BASELINE_REWARDS.values()) + lead
    steps = np.log2(max(design.num_paths) / num_paths)
    return float(end - 0.35 * steps - 0.06 * steps**2 + 0.8 * (max(design.cut_shares) - cut_share))


def _figure1(design: StudyDesign, lead: float) -> pd.DataFrame:
    rows = [
        (
            "cql",
            size,
            cut_share,
            design.repetitions,
            _reward(design, size, cut_share, lead),
            1.5 * SE / (size / 25) ** 0.2,
        )
        for cut_share in design.cut_shares
        for size in design.num_paths
    ]
    rows += [
        (f"cql-{treatment}", size, 0.5, design.repetitions, _reward(design, size, 0.5, lead) - 0.5, SE)
        for treatment in TREATMENTS[1:]
        for size in design.num_paths
    ]
    rows += [(name, np.nan, np.nan, design.repetitions, reward, SE) for name, reward in BASELINE_REWARDS.items()]
    table = pd.DataFrame(rows, columns=["policy", "num_paths", "cut_share", "repetitions", "mean_reward", "se"])
    return table.astype({"num_paths": "Int64", "cut_share": "Float64"})


def _figure4(design: StudyDesign, lead: float, gain: float) -> pd.DataFrame:
    rows = []
    for kind in design.treatment_cut_kinds:
        for k, treatment in enumerate(TREATMENTS):
            for size in design.num_paths:
                wave = 0.05 * np.sin(3.0 * k + size)
                behind = 0.0 if k == 0 else (k * gain if kind == "independent" else 0.0) + wave
                reward = _reward(design, size, design.treatment_cut_share, lead) - behind
                rows.append(
                    (treatment, kind, size, design.treatment_cut_share, design.repetitions, reward, SE, behind, SE)
                )
    names = ["treatment", "cut_kind", "num_paths", "cut_share", "repetitions", "mean_reward", "se"]
    return pd.DataFrame(rows, columns=[*names, "behind_weighted", "se_behind"])


def _table1(design: StudyDesign, lead: float) -> pd.DataFrame:
    own = _reward(design, design.table_num_paths, design.table_cut_share, lead)
    rows = []
    for name in ("planner-1s", "greedy", "history", "greedy-penalty", "history-penalty"):
        gap = own - BASELINE_REWARDS[name]
        p = 1e-7 if gap > 3 * SE else 0.8 if gap < 0 else 0.03
        rows.append((name, "reward", own, own - gap, p, min(1.0, 9 * p), gap, gap > 3 * SE, gap - 2 * SE, gap + 2 * SE))
        other = 130.0 if name.startswith("planner") else 0.004
        p = 4.757e-7 if other > 1 else 1.0
        rows.append(
            (
                name,
                "decision_ms",
                0.021,
                other,
                p,
                min(1.0, 9 * p),
                0.021 - other,
                other > 1,
                0.02 - other,
                0.022 - other,
            )
        )
        rows.append((name, "robot_s", 31.25, 33.5, 0.0031, 0.0279, -2.25, False, -3.9, -0.6))
    names = [
        "baseline",
        "measure",
        "cql",
        "other",
        "p_value",
        "p_holm",
        "effect",
        "supported",
        "effect_low",
        "effect_high",
    ]
    assert set(MEASURES) == {row[1] for row in rows}
    return pd.DataFrame(rows, columns=names)


def _weights(design: StudyDesign) -> pd.DataFrame:
    rows = [
        (size, cut_share, 5.5 * size * (1 - cut_share), 1.0 + 8.0 * cut_share * np.log10(size))
        for cut_share in design.cut_shares
        for size in design.num_paths
    ]
    return pd.DataFrame(rows, columns=["num_paths", "cut_share", "effective_sample_size", "largest_weight"])


def _grasp_pieces(design: StudyDesign, svm_lead: float) -> list[dict]:
    rng = np.random.default_rng(0)
    pieces = []
    for repetition in range(min(design.repetitions, design.grasp_repetitions)):
        luck = rng.normal(size=2)
        rows = []
        for size in design.grasp_num_paths:
            for k, model in enumerate(GRASP_NAMES):
                above = {"laplace": 0.2, "oracle": 0.0, "svm": 0.01 - svm_lead}.get(model, 0.01)
                noise = rng.normal(size=4) * 0.001
                attempts = rng.integers(100, 300, size=10)
                chances = attempts * (np.arange(10) + 0.5) / 10
                rows.append(
                    {
                        "model": model,
                        "num_paths": size,
                        "log_loss": 0.5 + above + 0.01 * luck[0] + noise[0],
                        "brier": 0.15 + above / 3 + 0.01 * luck[0] + noise[1],
                        "learned_reward": 9.0 + luck[1] - above + 0.1 * k + noise[2],
                        "heuristic_reward": 6.0 + luck[1] - above + noise[3],
                        "bins": {
                            "attempts": attempts.tolist(),
                            "chances": chances.tolist(),
                            "successes": rng.binomial(attempts, chances / attempts).tolist(),
                        },
                    }
                )
        pieces.append({"repetition": repetition, "grasp": rows})
    return pieces
