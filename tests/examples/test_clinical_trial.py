"""The trial, what policies of it are worth, and what its script prints; under slow, what the learner reaches."""

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread
from trial_comparison import METHODS, compare
from trial_optimum import GRID, best_sequence, optimum, policy_value, random_value
from trial_patients import ACTIONS, TREATMENTS, YEAR_S, follow, trial
from trial_words import standard_error, table

SCRIPT = Path(__file__).parents[2] / "examples" / "clinical_trial" / "clinical_trial.py"

NUM_FOLLOWED = 32_000


def optimal(covariates, stage):
    """The optimum's treatment at the nearest grid point."""
    q = optimum()[1][stage - 1]
    w, m = (np.rint(covariates[name].to_numpy() * (len(GRID) - 1)).astype(int) for name in ("wellness", "tumour"))
    return q[w, m].argmax(axis=-1)


def fixed(names):
    return lambda covariates, stage: np.full(len(covariates), TREATMENTS.index(names[stage - 1]))


def simulated(decide):
    """Mean survival of fresh patients [years], and its standard error."""
    total = follow(NUM_FOLLOWED, decide, np.random.default_rng(5)).groupby("patient")["survival"].sum()
    return total.mean(), total.sem()


def test_values_are_those_of_simulated_patients():
    best, name = best_sequence()
    for decide, value in ((None, random_value()), (fixed(name), best), (optimal, optimum()[0])):
        mean, error = simulated(decide)
        assert abs(mean - value) < 4 * error
        assert error < 0.01


def test_the_optimum_is_above_all_and_needs_every_treatment():
    value, q_of_stage = optimum()
    assert value == pytest.approx(policy_value(optimal), abs=1e-9)
    assert value > 1.1 * best_sequence()[0] > 1.1 * random_value()
    for stage, q in enumerate(q_of_stage, start=1):
        shares = (q.argmax(axis=-1)[..., None] == np.arange(len(TREATMENTS))).mean(axis=(0, 1))
        assert [TREATMENTS[k] for k in np.flatnonzero(shares > 0.1)] == ACTIONS[stage]


@pytest.mark.parametrize("share", [0.0, 0.3, 0.5])
def test_the_log_has_its_cuts_its_actions_and_times_as_rewards(share):
    logs = trial(4000, share, seed=2)
    assert logs.cut_share == pytest.approx(share, abs=0.025)
    stages = logs.stages
    for stage, names in ACTIONS.items():
        assert set(stages.loc[stages["stage"] == stage, "action"]) == set(names)
    counts = stages.groupby("trajectory").size()[logs.is_finished]
    assert set(counts) == {1, 2, 3}
    spent_s = np.diff(logs.elapsed_s(), axis=1, prepend=0.0)
    rewards = stages["reward"].to_numpy()[stages["elapsed_s"].notna()]
    assert spent_s[~np.isnan(spent_s)] / YEAR_S == pytest.approx(rewards, rel=1e-9)


def test_a_policy_is_learned_and_reported():
    found = compare(100, 1, seed=4, cut_shares=(0.5,), methods=("kernel",))
    assert found["ratio"].item() > 0.8
    measured, ratio = (found[name].item() for name in ("measured_share", "ratio"))
    assert table(found).split()[-5:] == ["50%", f"{measured:.1%}", f"{ratio:.1%}", "(one", "trial)"]


@pytest.mark.slow
def test_the_script_prints_and_draws(tmp_path):
    options = ["--patients", "80", "--trials", "1", "--seed", "4", "--out", str(tmp_path)]
    command = [sys.executable, SCRIPT, *options]
    done = subprocess.run(command, capture_output=True, text=True, encoding="utf-8", check=False)
    assert (done.returncode, done.stderr) == (0, "")
    lines = done.stdout.splitlines()
    assert lines[0].startswith("Expected survival in 3 stages [years]: optimum 2.645; best fixed sequence (ABB) 2.303")
    assert lines[3].split() == ["wanted", "patients", "cut", *" ".join(METHODS).split()]
    assert [line.split()[0] for line in lines[4:7]] == ["0%", "30%", "50%"]
    _, kernel, _, doubly_robust, uncut_only = re.findall(r"([\d.]+)% \(one trial\)", lines[4])
    # Nobody is cut: what is done about cuts does nothing.
    assert kernel == doubly_robust == uncut_only
    assert any(line.startswith("Rewards are times: ") for line in lines)
    assert min(imread(tmp_path / "clinical_trial.png").shape[:2]) > 500


@pytest.mark.slow
def test_from_1000_patients_the_policy_nearly_is_the_optimum_and_cut_patients_count():
    found = compare(1000, 10, seed=100, cut_shares=(0.3, 0.5), methods=("kernel", "uncut only"))
    ratios = found.pivot_table(index="trial", columns=["cut_share", "method"], values="ratio")
    for column in ratios:
        values = ratios[column].to_numpy()
        print(f"{column[0]:.0%} cut, {column[1]}: {values.mean():.2%} ± {standard_error(values):.2%} of the optimum")
    assert ratios[0.3, "kernel"].mean() >= 0.95
    assert ratios[0.5, "kernel"].mean() > ratios[0.5, "uncut only"].mean()


def test_the_same_patients_are_followed_under_all_cuts():
    full, cut = trial(300, 0.0, seed=3), trial(300, 0.5, seed=3)
    kept = cut.stages["elapsed_s"].notna()
    there = full.stages.merge(cut.stages.loc[kept, ["trajectory", "stage"]], on=["trajectory", "stage"])
    assert there["reward"].to_numpy() == pytest.approx(cut.stages.loc[kept, "reward"].to_numpy())
