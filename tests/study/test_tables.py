import numpy as np
import pandas as pd
import pytest

from halfseen.study.design import TREATMENTS, StudyDesign
from halfseen.study.policies import HEURISTICS
from halfseen.study.results import MEASURES
from halfseen.study.statistics import holm
from halfseen.study.tables import baseline_frame, figure1, figure4, learned_frame, strongest, table1, weights

DESIGN = StudyDesign(repetitions=3, num_paths=(10, 20), cut_shares=(0.0, 1 / 2), table_num_paths=20)
TIMES_MS = {name: np.full(4, 0.1 * (k + 1)) for k, name in enumerate(("cql", *HEURISTICS))}
FIGURE2 = pd.DataFrame({"policy": ["pomdp-1", "search-9"], "repetitions": 3, "mean_reward": [9.0, 9.5], "se": 0.5})
AGAINST = pd.DataFrame(
    {
        "baseline": "planner-1s",
        "measure": list(MEASURES),
        "cql": 9.0,
        "other": 8.0,
        "p_value": [0.001, 1.0, 0.5],
        "effect": 1.0,
        "effect_low": 0.5,
        "effect_high": 1.5,
    }
)


def pieces():
    """Three repetitions; weighted earns 8, 9, 10, each other treatment one less than the one before it."""
    made = []
    for repetition in (2, 0, 1):
        learned = [
            {
                "treatment": treatment,
                "cut_kind": kind,
                "cut_share": share,
                "num_paths": num_paths,
                "effective_sample_size": 5.0 + repetition,
                "largest_weight": 2.0,
                "reward": 8.0 + repetition - rank,
                "robot_s": 30.0 + repetition,
            }
            for num_paths in (10, 20)
            for kind, share in (("independent", 0.0), ("independent", 0.5), ("attempt", 0.5))
            for rank, treatment in enumerate(TREATMENTS if share else TREATMENTS[:1])
        ]
        baselines = {name: {"reward": 6.0 - k + 2.0 * repetition, "robot_s": 31.0} for k, name in enumerate(HEURISTICS)}
        made.append({"repetition": repetition, "baselines": baselines, "learned": learned})
    return made


@pytest.fixture(scope="module")
def frames():
    return learned_frame(pieces()), baseline_frame(pieces())


def test_figure1_has_a_row_for_each_policy_with_its_mean_and_error(frames):
    planners = {"planner-1s": "search-9"}
    whole = figure1(frames[0], frames[1], FIGURE2, planners)
    table = whole.set_index(["policy", "num_paths", "cut_share"])

    assert len(table) == 2 * (2 + 3) + 5
    row = table.loc[("cql", 20, 0.5)]
    assert (row["mean_reward"], row["se"], row["repetitions"]) == pytest.approx((9.0, 1 / np.sqrt(3), 3))
    assert table.loc[("cql-dropped", 10, 0.5), "mean_reward"] == pytest.approx(7.0)
    baselines = whole[whole["num_paths"].isna()].set_index("policy")
    assert set(baselines.index) == {"planner-1s", *HEURISTICS}
    assert tuple(baselines.loc["planner-1s", ["repetitions", "mean_reward", "se"]]) == (3, 9.5, 0.5)


def test_figure4_says_how_far_each_treatment_stays_behind_in_pairs(frames):
    table = figure4(frames[0], DESIGN).set_index(["treatment", "cut_kind", "num_paths"])

    assert len(table) == 4 * 2 * 2
    for rank, treatment in enumerate(TREATMENTS):
        row = table.loc[(treatment, "attempt", 10)]
        # The repetitions differ, the differences do not: paired, they have no error.
        assert (row["behind_weighted"], row["se_behind"], row["cut_share"]) == (rank, 0.0, 0.5)


def test_table1_compares_repetition_with_repetition_and_adjusts_for_all_tests(frames):
    table = table1(frames[0], frames[1], TIMES_MS, AGAINST, DESIGN)
    reward = table[table["measure"] == "reward"].set_index("baseline")

    assert list(table["baseline"].unique()) == ["planner-1s", *HEURISTICS]
    assert len(table) == 15
    np.testing.assert_allclose(reward["effect"], [1.0, 1.0, 2.0, 3.0, 4.0])
    np.testing.assert_allclose(reward["cql"] - reward["other"], reward["effect"])
    np.testing.assert_allclose(table["p_holm"], holm(table["p_value"].to_numpy()))
    assert (table["supported"] == (table["p_holm"] < DESIGN.alpha)).all()
    times = table[table["measure"] == "decision_ms"]
    assert (times["effect"][1:] < 0).all()


def test_weights_are_means_of_weighted_fits(frames):
    table = weights(frames[0])

    assert len(table) == 4
    np.testing.assert_allclose(table["effective_sample_size"], 6.0)


def test_the_strongest_is_the_one_that_earns_most_and_the_first_of_equals():
    frame = pd.DataFrame({"policy": ["a", "b", "c", "b"], "reward": [2.0, 1.0, 2.0, 3.5]})

    assert strongest(frame, ["a", "b", "c"]) == "b"
    assert strongest(frame, ["c", "a"]) == "c"
