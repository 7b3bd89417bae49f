"""The tiny study from end to end: its files, and that a killed one goes on to the same bytes."""

import json
import shutil
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from chromium import PAGES, faults_of, in_browser
from examples import SETTING, TINY
from halfseen.cell.calibration.law import shipped_law
from halfseen.errors import ArgumentError
from halfseen.study.runner import run_study, store_of, without_laws
from halfseen.study.setting import under
from halfseen.workers import Workers

REWARD = "mean_reward se low high"
COLUMNS = {
    "figure1": f"policy num_trajectories cut_share repetitions {REWARD} role gain gain_se gain_low gain_high",
    "table1": "baseline measure censored_q other p_value p_holm effect supported effect_low effect_high num_episodes",
    "peer": "num_trajectories cut_share p_value p_holm effect supported effect_low effect_high",
    "weights": "num_trajectories cut_share effective_sample_size largest_weight by_laws",
    "figure2": f"policy kind simulations decision_ms {REWARD} over_censored_q se_over over_low over_high "
    "repetitions episodes",
    "figure4": f"treatment cut_kind num_trajectories cut_share repetitions {REWARD} behind_default se_behind "
    "behind_low behind_high",
    "grasp_tests": "measure num_trajectories svm beta p_value p_holm effect supported effect_low effect_high",
    "figure5": "model num_trajectories bin_from attempts mean_probability share_succeeded difference se low high",
    "map": "num_objects occlusion labels reward_wash_clean grip_offset_std is_assumed num_trajectories cut_share "
    "repetitions censored_q best_heuristic heuristic_reward finish_reward gain gain_se gain_share gain_share_low "
    "gain_share_high verdict",
    "regret": "policy num_trajectories cut_share regret se low high regret_share optimum repetitions",
}
OF_LAW = (
    replace(TINY[0], num_trajectories=(50,), cut_shares=(0.5,), planners=((4, 2),)),
    replace(TINY[1], simulations=((4, 2),)),
    replace(TINY[2], num_trajectories=(50,)),
    replace(TINY[3], num_trajectories=(50,)),
    TINY[4],
    replace(TINY[5], num_trajectories=(50,), cut_shares=(0.5,)),
    TINY[6],
)
"""With fewer sizes of logs: what they come to is asked of the others."""
FIGURES = ("opening", "figure1", "figure2", "figure3", "figure4", "figure5", "map", "regret")


@pytest.fixture(scope="module")
def study_folder(tmp_path_factory):
    """Where the tiny study was run from end to end, once."""
    folder = tmp_path_factory.mktemp("study") / "new" / "folder"
    run_study(SETTING, folder, TINY, workers=Workers(1))
    return folder


def outputs(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def pieces(folder, name):
    kept = sorted((folder / "progress" / name).glob("repetition-*.json"))
    return [json.loads(path.read_text())["piece"] for path in kept]


@pytest.mark.slow
def test_it_writes_all_that_it_promises(study_folder):
    tables = {f"{name}.csv" for name in (*COLUMNS, "figure3", "grasp", "learning")}
    figures = {f"{name}.{kind}" for name in FIGURES for kind in ("svg", "png")}
    assert set(outputs(study_folder)) == tables | figures | {"report.html", "study.json"}
    for name, columns in COLUMNS.items():
        assert (study_folder / f"{name}.csv").read_text().splitlines()[0].split(",") == columns.split()


def by_size(rows, policy):
    return {(row["num_trajectories"], row["cut_share"]): row["reward"] for row in rows if row["policy"] == policy}


def rewards_of(rows):
    return {row["policy"]: row["reward"] for row in rows}


def untimed(file):
    """A table without the times in it."""
    table = pd.read_csv(file)
    return table.query("measure != 'decision_ms'") if "measure" in table else table.drop(columns="decision_ms")


@pytest.mark.slow
def test_the_numbers_are_those_of_the_pieces_and_experiments_share_episodes_and_the_log_of_a_repetition(study_folder):
    by_experiment = [pieces(study_folder, name) for name in ("reward", "planning", "grasp")]
    figure1 = pd.read_csv(study_folder / "figure1.csv").set_index("policy")
    for name in ("greedy", "history-penalty"):
        expected = np.mean([rewards_of(piece["baselines"])[name] for piece in by_experiment[0]])
        assert figure1.loc[name, "mean_reward"] == pytest.approx(expected)
    first = pd.DataFrame(by_experiment[1][0]["rows"])
    assert first["policy"].unique()[:2].tolist() == ["censored_q", "greedy"]
    assert set(first["policy"].value_counts()) == {1, 2, 4}
    for reward, planning, grasp in zip(*by_experiment, strict=True):
        played = pd.DataFrame(planning["rows"]).groupby("policy")["reward"].mean()
        rule = rewards_of(reward["baselines"])["history-penalty"]
        assert played["history-penalty"] == pytest.approx(rule, abs=1e-5)
        assert played["censored_q"] == pytest.approx(by_size(reward["rows"], "censored_q")[50, 0.5], abs=1e-5)
        linear = by_size(reward["rows"], "linear_q")
        for row in grasp["rows"]:
            if row["model"] == "succession":
                assert row["learned_reward"] == pytest.approx(linear[row["num_trajectories"], 0.5], abs=1e-5)
            if row["model"] == "oracle":
                assert row["heuristic_reward"] == pytest.approx(played["history-penalty"], abs=1e-5)
    # Nobody is better than the optimum.
    regret = pd.read_csv(study_folder / "regret.csv")
    assert (regret.loc[~regret["policy"].str.startswith("planner"), "regret"] >= 0.0).all()
    assert regret["policy"].iloc[-1] == "optimum"


@pytest.mark.slow
def test_resuming_a_killed_study_in_two_processes_writes_the_same_bytes(study_folder, tmp_path):
    """The others make again how each experiment is prepared, and its last repetition."""
    shutil.copytree(study_folder / "progress", tmp_path / "progress")
    for each in TINY:
        for name in ("prepared", "repetition-00001"):
            (tmp_path / "progress" / each.name / f"{name}.json").unlink()
    run_study(SETTING, tmp_path, TINY, is_resumed=True, workers=Workers(2))
    assert outputs(tmp_path) == outputs(study_folder)
    for each in TINY:
        assert pieces(tmp_path, each.name) == pieces(study_folder, each.name)


@pytest.mark.slow
def test_of_what_is_drawn_only_the_labels_of_figure_1_depend_on_measured_times(study_folder, tmp_path):
    shutil.copytree(study_folder / "progress", tmp_path / "progress")
    for store in (store_of(experiment, SETTING, tmp_path, is_resumed=True) for experiment in TINY):
        if store.has("measured") and (measured := store.read("measured")):
            slower = {name: 100.0 * value for name, value in measured["decision_ms"].items()}
            store.keep("measured", {**measured, "decision_ms": slower})
    run_study(SETTING, tmp_path, TINY, is_resumed=True, workers=Workers(1))
    before, after = outputs(study_folder), outputs(tmp_path)
    changed = {name for name in before if before[name] != after[name]}
    drawn = {"figure1.svg", "figure1.png"}
    assert changed == {"figure2.csv", "figure3.csv", "table1.csv", "study.json", "report.html", *drawn}
    for name in ("figure2", "figure3", "table1"):
        pd.testing.assert_frame_equal(*(untimed(folder / f"{name}.csv") for folder in (study_folder, tmp_path)))


@pytest.mark.slow
def test_under_the_law_of_a_cell_everything_runs_and_says_so(tmp_path):
    setting, law = under(SETTING, shipped_law())
    setting = replace(
        setting, scenes=tuple(replace(scene, grip=np.linspace(-2, 0, scene.num_objects)) for scene in SETTING.scenes)
    )
    results = run_study(setting, tmp_path, OF_LAW, workers=Workers(1))
    assert "are estimated, not assumed" in results.answer[-1]
    result = pd.read_csv(tmp_path / "map.csv")
    assert result["is_assumed"].tolist() == [False] * 4 + [True] * 2
    assert sorted(set(result["labels"])) == pytest.approx(sorted({0.3, law.seeing.facing}))
    assert (pd.read_csv(tmp_path / "regret.csv")["regret"] > -1e-6).all()
    assert json.loads((tmp_path / "study.json").read_text())["scenes"][0]["grip"][0] == -2


@pytest.mark.slow
def test_a_study_without_laws_has_one_curve_of_what_is_learned_and_laws_for_others(tmp_path):
    plain = without_laws(TINY)
    changed = [each.name for each, before in zip(plain, TINY, strict=True) if each != before]
    assert changed == ["reward", "planning", "clutter", "regret"]
    assert not any(getattr(each, "laws", False) for each in plain)
    design = replace(plain[0], num_trajectories=(50,), cut_shares=(0.5,), planners=((4, 2),))
    results = run_study(SETTING, tmp_path, [design], workers=Workers(1))
    policies = set(pd.read_csv(tmp_path / "figure1.csv")["policy"])
    assert {"censored_q", "fitted-one-step", "fitted-rule", "fitted-planner-4"} < policies
    assert "linear_q" not in policies
    assert pd.read_csv(tmp_path / "weights.csv")["by_laws"].tolist() == [0.0]
    assert not any("linear eq. 3 without laws" in sentence for sentence in results.sections["reward"].sentences)


@pytest.mark.parametrize(
    ("whole", "changed", "message"),
    [
        (SETTING, {"repetitions": 1}, "repetitions is 1; "),
        (TINY[0], {"table_num_trajectories": 30}, "table_num_trajectories is 30; give one of num_trajectories"),
        (TINY[0], {"table_cut_share": 0.3}, "table_cut_share is 0.3; give one of cut_shares"),
        (TINY[1], {"horizons": (3, 2)}, "horizons is .3, 2.; give at least two"),
        (TINY[2], {"compared_num_trajectories": 30}, "compared_num_trajectories is 30; give one of num_trajectories"),
        (TINY[4], {"cut_share": 1.0}, "cut_share of the map is 1"),
    ],
)
def test_a_design_that_contradicts_itself_is_refused(whole, changed, message):
    with pytest.raises(ArgumentError, match=message):
        replace(whole, **changed)


@in_browser
@pytest.mark.slow
@PAGES
def test_everybody_can_read_the_page(study_folder, width_px, scheme):
    assert faults_of([study_folder / "report.html"], width_px, scheme) == []
