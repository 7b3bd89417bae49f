"""The grasp ablation from end to end, against the study's own pieces."""

import json

import numpy as np
import pytest

from halfseen.study.grasp import GRASP_MODELS
from halfseen.study.grasp_tables import grasp_frame


@pytest.fixture(scope="module")
def pieces(study_folder):
    return [json.loads((study_folder / f"progress/grasp-0000{k}.json").read_text()) for k in (0, 1)]


@pytest.fixture(scope="module")
def main_pieces(study_folder):
    return [json.loads((study_folder / f"progress/repetition-0000{k}.json").read_text()) for k in (0, 1)]


def test_every_model_is_there_at_every_size(pieces):
    frame = grasp_frame(pieces)
    assert len(frame) == 2 * 2 * len(GRASP_MODELS)
    assert set(frame["model"]) == set(GRASP_MODELS)
    assert frame["log_loss"].between(0.2, 1.0).all()


def test_laplaces_guess_learns_what_the_study_learns_from_the_same_log(pieces, main_pieces):
    for piece, main in zip(pieces, main_pieces, strict=True):
        learned = {
            row["num_paths"]: row["reward"]
            for row in main["learned"]
            if (row["treatment"], row["cut_kind"], row["cut_share"]) == ("weighted", "independent", 0.5)
        }
        for row in piece["grasp"]:
            if row["model"] == "laplace":
                assert row["learned_reward"] == pytest.approx(learned[row["num_paths"]], abs=1e-6)


def test_the_true_model_in_the_heuristic_is_the_heuristic(pieces, main_pieces):
    for piece, main in zip(pieces, main_pieces, strict=True):
        for row in piece["grasp"]:
            if row["model"] == "oracle":
                assert row["heuristic_reward"] == pytest.approx(
                    main["baselines"]["history-penalty"]["reward"], abs=1e-6
                )


def test_the_true_model_scores_best_and_is_calibrated(pieces):
    frame = grasp_frame(pieces)
    mean = frame.groupby("model")["log_loss"].mean()
    assert mean.idxmin() == "oracle"
    bins = frame.loc[frame["model"] == "oracle", "bins"].tolist()
    attempts, chances, successes = (np.sum([of[k] for of in bins]) for k in ("attempts", "chances", "successes"))
    assert abs(successes - chances) < 4 * np.sqrt(attempts / 4)
    assert attempts > 500
