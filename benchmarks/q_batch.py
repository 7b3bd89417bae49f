"""One thousand logs of 200 paths and ten stages, learned from in one batch, beside a loop over scikit-learn.

python benchmarks/q_batch.py [--out runs/benchmarks/q_batch.json]

The loop does what eq. 3 says, regression by regression: for each log, backwards over its stages, one weighted `Ridge`
of scikit-learn for each action on features of unit weighted variance; once with λ given, and once with λ chosen among
eleven by weighted cross-validation over five folds of paths, which is the learner's default. It is timed on a few logs
and counted up to a thousand. Both get arrays that are ready: the batch as JAX holds them, the loop as NumPy does. The
coefficients of the few logs are compared.
"""

import argparse
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
from sklearn.linear_model import Ridge
from timings import Row, write

from halfseen.learning.fitting import BackwardOptions, fit_q_functions
from halfseen.learning.q_space import REGS
from halfseen.learning.transitions import Transitions

NUM_LOGS, NUM_PATHS, HORIZON, NUM_ACTIONS, NUM_COVARIATES = 1_000, 200, 10, 2, 4
NUM_FOLDS, REG = 5, 0.1
NUM_RUNS = 5


def drawn(num_logs, seed=0):
    rng = np.random.default_rng(seed)
    shape = (num_logs, NUM_PATHS, HORIZON)
    covariates = rng.normal(size=(*shape, 1, NUM_COVARIATES))
    action = rng.integers(0, NUM_ACTIONS, shape)
    stage = np.arange(HORIZON)
    num_completed = rng.integers(HORIZON // 2, HORIZON + 1, shape[:2])[..., None]
    is_completed = stage < num_completed
    signal = covariates[..., 0, 0] * (2 * action - 1) + rng.normal(size=shape)
    return Transitions(
        features=covariates,
        is_possible=np.ones((*shape, NUM_ACTIONS), dtype=bool),
        action=action,
        reward=np.where(is_completed, signal, 0.0),
        weight=np.where(is_completed, rng.uniform(1.0, 3.0, shape), 0.0),
        is_last=is_completed & (stage == num_completed - 1),
        fold=np.tile(rng.permutation(NUM_PATHS) % NUM_FOLDS, (num_logs, 1)),
    )


def looped(log, is_chosen):
    """Coefficients of Q_1 … Q_T of one log, by scikit-learn."""
    after, coefficients = np.zeros(NUM_PATHS), np.zeros((HORIZON, NUM_ACTIONS, 1 + NUM_COVARIATES))
    for stage in reversed(range(HORIZON)):
        target = log.reward[:, stage] + np.where(log.is_last[:, stage], 0.0, after)
        q = np.zeros((NUM_PATHS, NUM_ACTIONS))
        for action in range(NUM_ACTIONS):
            rows = (log.action[:, stage] == action) & (log.weight[:, stage] > 0)
            x, weight = log.features[rows, stage, 0], log.weight[rows, stage]
            mean = np.average(x, axis=0, weights=weight)
            scale = np.sqrt(np.average((x - mean) ** 2, axis=0, weights=weight))
            reg = chosen(x / scale, target[rows], weight, log.fold[rows]) if is_chosen else REG
            ridge = Ridge(alpha=reg * NUM_PATHS).fit(x / scale, target[rows], sample_weight=weight)
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
            alpha = reg * NUM_PATHS * (NUM_FOLDS - 1) / NUM_FOLDS
            ridge = Ridge(alpha=alpha).fit(x[train], target[train], sample_weight=weight[train])
            errors[k] += np.sum(weight[test] * (target[test] - ridge.predict(x[test])) ** 2)
    return REGS[int(np.argmin(errors))]


def compare(logs, is_chosen, num_looped):
    regs, num_folds = (REGS, NUM_FOLDS) if is_chosen else (np.array([REG]), 1)
    options = BackwardOptions(NUM_ACTIONS, "separate", num_folds, end_action=None, is_scaled=True)
    with jax.enable_x64(True):
        ready = jax.block_until_ready(jax.tree.map(jnp.asarray, logs._replace(fold=logs.fold % num_folds)))

    def batch():
        return fit_q_functions(ready, np.arange(NUM_ACTIONS), regs, options).coefficients

    fitted = batch()
    few = [jax.tree.map(lambda leaf, k=k: leaf[k], logs) for k in range(num_looped)]
    ours_s, loop_s, difference = [], [], 0.0
    for _ in range(NUM_RUNS):
        begin = time.perf_counter()
        batch()
        middle = time.perf_counter()
        by_loop = [looped(log, is_chosen) for log in few]
        ours_s.append(middle - begin)
        loop_s.append((time.perf_counter() - middle) * NUM_LOGS / num_looped)
        difference = float(np.abs(np.stack(by_loop) - fitted[:num_looped]).max())
    ours, loop = float(np.median(ours_s)), float(np.median(loop_s))
    return {"ours_s": ours, "loop_s": loop, "ratio": loop / ours, "largest_difference_of_coefficients": difference}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/q_batch.json"))
    args = parser.parse_args()
    logs = drawn(NUM_LOGS)
    found = {
        "λ given": compare(logs, is_chosen=False, num_looped=10),
        "λ chosen (default)": compare(logs, is_chosen=True, num_looped=2),
    }
    print(f"{NUM_LOGS:,} logs of {NUM_PATHS} paths and {HORIZON} stages, medians of {NUM_RUNS} runs in turn")
    print(f"{'':20}{'ours [s]':>10}{'loop [s]':>10}{'ratio':>8}   bar: 100")
    for name, row in found.items():
        verdict = "holds" if row["ratio"] >= 100 else "missed"
        print(f"{name:20}{row['ours_s']:10.2f}{row['loop_s']:10.1f}{row['ratio']:8.0f}   {verdict}")
    worst = max(row["largest_difference_of_coefficients"] for row in found.values())
    print(f"coefficients differ by {worst:.1e} at most")
    rows = [
        Row(
            f"{NUM_LOGS:,} logs of {NUM_PATHS} paths, {name}",
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
