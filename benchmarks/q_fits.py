"""Logs of 200 trajectories and ten stages, learned from one after the other, beside a loop over scikit-learn.

python benchmarks/q_fits.py [--out runs/benchmarks/q_fits.json]

The loop does what eq. 3 says, regression by regression: for each log, backwards over its stages, one weighted `Ridge`
of scikit-learn for each action on features of unit weighted variance; once with λ given, and once with λ chosen among
eleven by weighted cross-validation over five folds of trajectories, which is the learner's default. Both get arrays
that are ready, and are timed on a few logs of their own number; figures are for one. The coefficients are compared.
"""

import argparse
import time
from pathlib import Path

import numpy as np
from sklearn.linear_model import Ridge
from timings import Row, write

from halfseen.learning.q_space import REGS
from halfseen.learning.recursion import Regression, fit_q
from halfseen.learning.rows import Transitions

NUM_TRAJECTORIES, HORIZON, NUM_ACTIONS, NUM_COVARIATES = 200, 10, 2, 4
NUM_FOLDS, REG = 5, 0.1
NUM_RUNS = 5


def drawn(seed):
    rng = np.random.default_rng(seed)
    shape = (NUM_TRAJECTORIES, HORIZON)
    covariates = rng.normal(size=(*shape, 1, NUM_COVARIATES))
    action = rng.integers(0, NUM_ACTIONS, shape)
    stage = np.arange(HORIZON)
    num_completed = rng.integers(HORIZON // 2, HORIZON + 1, NUM_TRAJECTORIES)[:, None]
    is_completed = stage < num_completed
    signal = covariates[..., 0, 0] * (2 * action - 1) + rng.normal(size=shape)
    return Transitions(
        features=covariates,
        is_possible=np.ones((*shape, NUM_ACTIONS), dtype=bool),
        action=action,
        reward=np.where(is_completed, signal, 0.0),
        weight=np.where(is_completed, rng.uniform(1.0, 3.0, shape), 0.0),
        is_last=is_completed & (stage == num_completed - 1),
        fold=rng.permutation(NUM_TRAJECTORIES) % NUM_FOLDS,
    )


def looped(log, is_chosen):
    """Coefficients of Q_1 … Q_T of one log, by scikit-learn."""
    after, coefficients = np.zeros(NUM_TRAJECTORIES), np.zeros((HORIZON, NUM_ACTIONS, 1 + NUM_COVARIATES))
    for stage in reversed(range(HORIZON)):
        target = log.reward[:, stage] + np.where(log.is_last[:, stage], 0.0, after)
        q = np.zeros((NUM_TRAJECTORIES, NUM_ACTIONS))
        for action in range(NUM_ACTIONS):
            rows = (log.action[:, stage] == action) & (log.weight[:, stage] > 0)
            x, weight = log.features[rows, stage, 0], log.weight[rows, stage]
            mean = np.average(x, axis=0, weights=weight)
            scale = np.sqrt(np.average((x - mean) ** 2, axis=0, weights=weight))
            reg = chosen(x / scale, target[rows], weight, log.fold[rows]) if is_chosen else REG
            ridge = Ridge(alpha=reg * NUM_TRAJECTORIES).fit(x / scale, target[rows], sample_weight=weight)
            q[:, action] = ridge.predict(log.features[:, stage, 0] / scale)
            coefficients[stage, action] = [ridge.intercept_, *(ridge.coef_ / scale)]
        after = q.max(axis=1)
    return coefficients


def chosen(x, target, weight, fold):
    errors = np.zeros(len(REGS))
    for held in range(NUM_FOLDS):
        train, test = fold != held, fold == held
        if not test.any():
            continue
        for k, reg in enumerate(REGS):
            alpha = reg * NUM_TRAJECTORIES * (NUM_FOLDS - 1) / NUM_FOLDS
            ridge = Ridge(alpha=alpha).fit(x[train], target[train], sample_weight=weight[train])
            errors[k] += np.sum(weight[test] * (target[test] - ridge.predict(x[test])) ** 2)
    return REGS[int(np.argmin(errors))]


def compare(is_chosen, num_ours, num_looped):
    """Seconds a log, ours and looped, and how far coefficients differ."""
    regs, num_folds = (REGS, NUM_FOLDS) if is_chosen else (np.array([REG]), 1)
    regression = Regression(np.arange(NUM_ACTIONS), NUM_ACTIONS, regs, num_folds, "separate")
    logs = [drawn(seed) for seed in range(num_ours)]
    ours_s, loop_s, difference = [], [], 0.0
    for _ in range(NUM_RUNS):
        begin = time.process_time()
        fitted = [fit_q(log._replace(fold=log.fold % num_folds), regression).coefficients for log in logs]
        middle = time.process_time()
        by_loop = [looped(log, is_chosen) for log in logs[:num_looped]]
        ours_s.append((middle - begin) / num_ours)
        loop_s.append((time.process_time() - middle) / num_looped)
        difference = float(np.abs(np.stack(by_loop) - np.stack(fitted[:num_looped])).max())
    ours, loop = float(np.median(ours_s)), float(np.median(loop_s))
    return {"ours_s": ours, "loop_s": loop, "ratio": loop / ours, "largest_difference_of_coefficients": difference}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/q_fits.json"))
    args = parser.parse_args()
    found = {
        "λ given": compare(is_chosen=False, num_ours=40, num_looped=10),
        "λ chosen (default)": compare(is_chosen=True, num_ours=20, num_looped=2),
    }
    print(
        f"logs of {NUM_TRAJECTORIES} trajectories and {HORIZON} stages, CPU seconds a log, medians of {NUM_RUNS} runs "
        "in turn"
    )
    print(f"{'':20}{'ours [s]':>10}{'loop [s]':>10}{'ratio':>8}")
    for name, row in found.items():
        print(f"{name:20}{row['ours_s']:10.4f}{row['loop_s']:10.4f}{row['ratio']:8.1f}")
    worst = max(row["largest_difference_of_coefficients"] for row in found.values())
    print(f"coefficients differ by {worst:.1e} at most")
    rows = [
        Row(
            f"a log of {NUM_TRAJECTORIES} trajectories, {name}",
            row["ours_s"],
            "s",
            "scikit-learn in a loop",
            row["loop_s"],
        )
        for name, row in found.items()
    ]
    write(args.out, found, rows)


if __name__ == "__main__":
    main()
