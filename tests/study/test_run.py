import json
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import asdict

import numpy as np
import pandas as pd
import pytest

from halfseen.errors import ArgumentError
from halfseen.study.design import StudyDesign
from halfseen.study.run import run_study

COLUMNS = {
    "figure1": "policy num_paths cut_share repetitions mean_reward se",
    "figure2": "policy kind simulations decision_ms mean_reward se low high over_cql se_over over_low over_high "
    "repetitions episodes",
    "figure3": "planning_horizon simulations decision_ms mean_reward se low high over_previous se_over_previous "
    "over_previous_low over_previous_high over_first se_over_first over_first_low over_first_high repetitions episodes",
    "regret": "policy num_paths cut_share regret se regret_share optimum repetitions",
    "figure4": "treatment cut_kind num_paths cut_share repetitions mean_reward se behind_weighted se_behind",
    "map": "num_objects occlusion label_gain reward_wash_clean grip_offset_std num_paths cut_share repetitions cql "
    "best_heuristic heuristic_reward finish_reward gain gain_se gain_share gain_share_low gain_share_high verdict",
    "figure5": "model num_paths bin_from attempts mean_chance share_succeeded se",
    "grasp_tests": "measure num_paths svm beta p_value p_holm effect supported effect_low effect_high",
    "table1": "baseline measure cql other p_value p_holm effect supported effect_low effect_high",
}


def outputs(folder):
    """Bytes of every file, those of progress/ included."""
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


def test_everything_is_written_and_nothing_else(study_folder):
    figures = {f"figure{k}.{kind}" for k in range(1, 6) for kind in ("csv", "png", "svg")}
    figures |= {f"{name}.{kind}" for name in ("map", "regret") for kind in ("csv", "png", "svg")}
    progress = {"design", "decision_times_ms", "repetition-00000", "repetition-00001"}
    progress |= {f"{part}-0000{k}" for part in ("grasp", "map", "planning", "regret") for k in (0, 1)}
    progress |= {"learning_s", "regret-baselines"}
    expected = (
        figures
        | {"table1.csv", "grasp.csv", "grasp_tests.csv", "study.json", "report.html"}
        | {f"progress/{name}.json" for name in progress}
    )

    assert set(outputs(study_folder)) == expected


@pytest.mark.parametrize("name", COLUMNS)
def test_tables_have_the_columns_that_they_promise(study_folder, name):
    assert (study_folder / f"{name}.csv").read_text().splitlines()[0] == COLUMNS[name].replace(" ", ",")


def test_the_numbers_are_those_of_the_pieces(study_folder):
    pieces = [json.loads((study_folder / f"progress/repetition-0000{k}.json").read_text()) for k in (0, 1)]
    figure1 = pd.read_csv(study_folder / "figure1.csv").set_index("policy")

    for name in ("greedy", "history-penalty"):
        expected = np.mean([piece["baselines"][name]["reward"] for piece in pieces])
        assert figure1.loc[name, "mean_reward"] == pytest.approx(expected)
    times = json.loads((study_folder / "progress/decision_times_ms.json").read_text())
    assert all(min(values) > 0 for values in times.values())


def test_resuming_a_finished_study_writes_the_same_bytes(study_folder, tiny_design, two_clouds, tmp_path):
    folder = shutil.copytree(study_folder, tmp_path / "copy")
    run_study(tiny_design, two_clouds, folder, is_resumed=True)

    assert outputs(folder) == outputs(study_folder)


def test_resuming_a_killed_study_writes_the_same_bytes(study_folder, tiny_design, two_clouds, tmp_path):
    shutil.copytree(study_folder / "progress", tmp_path / "progress")
    for name in ("repetition-00001", "grasp-00000", "planning-00001", "regret-00000"):
        (tmp_path / "progress" / f"{name}.json").unlink()
    run_study(tiny_design, two_clouds, tmp_path, is_resumed=True)

    assert outputs(tmp_path) == outputs(study_folder)


@pytest.mark.slow
def test_beginning_anew_finds_the_same_rewards(study_folder, tiny_design, two_clouds, tmp_path):
    run_study(tiny_design, two_clouds, tmp_path)

    for name in ("figure4.csv", "grasp.csv", "regret.csv", "map.csv", "progress/repetition-00001.json"):
        assert (tmp_path / name).read_bytes() == (study_folder / name).read_bytes()


def test_another_seed_is_not_resumed(study_folder, tiny_design, two_clouds, tmp_path):
    folder = shutil.copytree(study_folder, tmp_path / "copy")
    other = StudyDesign(**{**vars(tiny_design), "seed": 1})

    with pytest.raises(ArgumentError, match="another design, seed or version"):
        run_study(other, two_clouds, folder, is_resumed=True)
    assert outputs(folder) == outputs(study_folder)


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"repetitions": 1}, "repetitions is 1; "),
        ({"planning_horizons": (2, 3)}, "planning_horizons is .2, 3.; it holds 1"),
        ({"table_num_paths": 30}, "table_num_paths is 30; it is one of num_paths"),
        ({"table_cut_share": 0.3}, "table_cut_share is 0.3; it is one of cut_shares"),
    ],
)
def test_a_design_that_contradicts_itself_is_refused(wrong, message):
    with pytest.raises(ArgumentError, match=message):
        StudyDesign(**wrong)


SCRIPT = """
import json, sys
from pathlib import Path
from halfseen.study import StudyDesign, run_study
from halfseen.study.map_cells import MapDesign
tuples = lambda values: {k: tuple(v) if isinstance(v, list) else v for k, v in values.items()}
design = tuples(json.loads(sys.argv[2]))
clutter_map = MapDesign(**tuples(design.pop("clutter_map")))
design = StudyDesign(**design, clutter_map=clutter_map)
run_study(design, [Path(cloud) for cloud in sys.argv[3:]], Path(sys.argv[1]), is_resumed=True)
"""


@pytest.mark.slow
def test_a_study_killed_among_its_repetitions_goes_on_to_the_same_numbers(tiny_design, two_clouds, tmp_path):
    design = {k: v for k, v in asdict(tiny_design).items() if k != "world"} | {"repetitions": 30}
    tail = [json.dumps(design), *map(str, two_clouds)]

    def command(name):
        return [sys.executable, "-c", SCRIPT, str(tmp_path / name), *tail]

    killed = subprocess.Popen(command("killed"), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    while not (tmp_path / "killed" / "progress" / "repetition-00002.json").exists():
        assert killed.poll() is None
        time.sleep(0.02)
    killed.send_signal(signal.SIGKILL)
    killed.wait()
    assert not (tmp_path / "killed" / "progress" / "repetition-00029.json").exists()
    for name in ("killed", "whole"):
        subprocess.run(command(name), check=True, capture_output=True)

    assert (tmp_path / "killed" / "figure1.csv").read_bytes() == (tmp_path / "whole" / "figure1.csv").read_bytes()
