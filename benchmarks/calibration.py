"""Are explanations calibrated? What is said to be best with 90 % is to be best in nine cases of ten.

python benchmarks/calibration.py [--out runs/benchmarks/calibration.json] [--tables 8] [--states 14] [--paths 50 800]
python benchmarks/calibration.py --fit

States are those that the logging policy reaches on random small tables; the truth is the exact optimum. An action is
best where its exact Q is within 1e-9 of the largest: of actions that are worth the same, all are. `--fit` prints the
constants of ``planners.explanation``, fitted on tables that the check never sees. The learned policy is measured
twice: against the optimum, and against what it learns from very many paths, which is all that a bootstrap can know.
"""

import argparse
import json
import time
from pathlib import Path

import jax
import numpy as np
from scipy.optimize import minimize
from scipy.special import gammaln

from halfseen.learners import CensoredQLearner
from halfseen.planners import GreedyPolicy, solve_table
from halfseen.planners.explanation import DEGREES_OF_FREEDOM, PlannerError, expected_q, explain, own_error, rollouts_of
from halfseen.tables.learned_explanation import LearnedExplainer
from halfseen.world import ExploringPolicy, Scene, TableWorld, WorldConfig
from halfseen.world.episodes import play
from halfseen.world.state import pad_scenes

FIT_TABLES = {(3, 6): 1, (2, 8): 2}
CHECK_TABLES = {(3, 6): 13, (3, 5): 14, (4, 4): 15, (2, 10): 16}
"""(Cups, steps) and the seed of their tables."""
LEARNED_TABLES, LOG_SEED = (3, 6), 99
CUT_SHARE, NUM_GRIP_NODES, NUM_ROLLOUTS = 1 / 3, 31, 512
BINS = np.array([0.0, 0.05, 0.15, 0.25, 0.35, 0.45, 0.55, 0.65, 0.75, 0.85, 0.95, 1.0 + 1e-9])


def random_scene(rng, num_objects):
    is_hidden = (rng.random((num_objects, num_objects)) < 0.6) * ~np.eye(num_objects, dtype=bool)
    return Scene(rng.uniform(0.0, 0.6, (num_objects, num_objects)) * is_hidden)


def logging_policy(config):
    return ExploringPolicy(GreedyPolicy(config, uses_history=True, counts_penalty=True), 0.5)


def states_with_truth(num_objects, horizon, seed, num_tables, num_states):
    """States of random tables, and the exact Q of each."""
    rng, config = np.random.default_rng(seed), WorldConfig(horizon=horizon)
    found = []
    for table in range(num_tables):
        scene = random_scene(rng, num_objects)
        optimum = solve_table(scene, config, num_grip_nodes=NUM_GRIP_NODES)
        key = jax.random.key(1000 * seed + table)
        played = play(config, pad_scenes([scene]), logging_policy(config), key, num_states + 2)
        reached = rng.permutation(np.argwhere(np.asarray(played.is_taken)))[:num_states]
        states = [jax.tree.map(lambda leaf, at=(i, t): leaf[*at], played.states) for i, t in reached]
        found += [(state, optimum.q_values(state)) for state in states]
    return config, found


class Calibration:
    """What was said of actions, and what was so."""

    def __init__(self):
        self.said, self.was, self.holds, self.lift_holds, self.stop_said, self.stop_was = ([] for _ in range(6))
        self.num_states = 0

    def add(self, told, truth):
        possible, num_objects = np.isfinite(truth), len(told.lift_worth)
        is_best = truth >= truth.max() - 1e-9
        self.num_states += 1
        self.said += told.probability_best[possible].tolist()
        self.was += is_best[possible].tolist()
        self.stop_said.append(told.probability_stop_is_right)
        self.stop_was.append(bool(is_best[0]))
        possible[0] = False
        self.holds += ((told.low <= truth) & (truth <= told.high))[possible].tolist()
        worth = truth[1 + num_objects :] - truth[: 1 + num_objects].max()
        is_there = possible[1 + num_objects :]
        self.lift_holds += ((told.lift_low <= worth) & (worth <= told.lift_high))[is_there].tolist()

    def report(self, title):
        told = {
            "states": self.num_states,
            "coverage_of_q": float(np.mean(self.holds)),
            "coverage_of_lift_worth": float(np.mean(self.lift_holds)),
            "best": binned(self.said, self.was),
            "stop": binned(self.stop_said, self.stop_was),
        }
        print(
            f"{title}: {self.num_states} states; 90 % intervals hold Q in {told['coverage_of_q']:.3f}, "
            f"the worth of LIFT in {told['coverage_of_lift_worth']:.3f}"
        )
        for name in ("best", "stop"):
            print(f"  {name}: " + "  ".join(f"{b['said']:.2f}→{b['was']:.2f} ({b['count']})" for b in told[name]))
        return told


def binned(said, was):
    """Mean chance and share that was so, for each bin that is not empty."""
    said, was = np.asarray(said), np.asarray(was)
    place = np.digitize(said, BINS)
    return [
        {"said": said[place == k].mean(), "was": was[place == k].mean(), "count": int((place == k).sum())}
        for k in np.unique(place)
    ]


def planner_calibration(num_tables, num_states):
    told, everything, seconds = {}, Calibration(), []
    for (num_objects, horizon), seed in CHECK_TABLES.items():
        config, found = states_with_truth(num_objects, horizon, seed, num_tables, num_states)
        calibration = Calibration()
        for k, (state, truth) in enumerate(found):
            begin_s = time.perf_counter()
            one = explain(config, state, jax.random.key(k), num_rollouts=NUM_ROLLOUTS)
            seconds.append(time.perf_counter() - begin_s)
            calibration.add(one, truth)
            everything.add(one, truth)
        name = f"{num_objects} cups, {horizon} steps"
        told[name] = calibration.report(f"planner, {name}")
    told["all"] = everything.report("planner, all")
    told["median_s"] = float(np.median(seconds))
    print(f"  an explanation takes {told['median_s']:.3f} s")
    return told


def learned_calibration(sizes, num_tables, num_states):
    """Against the optimum, and against the same learner on four times the paths of the largest log."""
    num_objects, horizon = LEARNED_TABLES
    config, found = states_with_truth(num_objects, horizon, CHECK_TABLES[LEARNED_TABLES], num_tables, num_states)
    rng = np.random.default_rng(LOG_SEED)
    scenes = [random_scene(rng, num_objects) for _ in range(40)]

    def logged(num_paths, seed):
        return TableWorld(config).simulate(scenes, logging_policy(config), num_paths, seed, CUT_SHARE)

    limit = CensoredQLearner.for_table(horizon).fit(logged(4 * max(sizes), LOG_SEED)).policy_
    told = {}
    for num_paths in sizes:
        logs = logged(num_paths, num_paths)
        begin_s = time.perf_counter()
        learner = CensoredQLearner.for_table(horizon).fit(logs)
        fitted_s = time.perf_counter()
        explainer = LearnedExplainer.of(learner, logs)
        done_s = time.perf_counter()
        by_optimum, by_limit = Calibration(), Calibration()
        for state, truth in found:
            one = explainer.explain(state)
            by_optimum.add(one, truth)
            by_limit.add(one, np.asarray(limit.q_values(state), dtype=np.float64))
        print(f"{num_paths} paths: fit {fitted_s - begin_s:.1f} s, 100 replicates {done_s - fitted_s:.1f} s")
        told[str(num_paths)] = {
            "optimum": by_optimum.report("learned, against the optimum"),
            "limit": by_limit.report(f"learned, against itself from {4 * max(sizes)} paths"),
            "fit_s": fitted_s - begin_s,
            "replicates_s": done_s - fitted_s,
        }
    return told


def fitted_error(num_tables, num_states):
    """The error of greatest likelihood; interchangeable actions count once."""
    known = []
    for (num_objects, horizon), seed in FIT_TABLES.items():
        config, found = states_with_truth(num_objects, horizon, seed, num_tables, num_states)
        known += [
            (rollouts_of(config, state, jax.random.key(k), NUM_ROLLOUTS), truth)
            for k, (state, truth) in enumerate(found)
        ]

    def loss(log_constants):
        error = PlannerError(*np.exp(log_constants).tolist())
        return -sum(log_likelihood(rollouts, truth, error) for rollouts, truth in known)

    start = np.log([0.003, 0.01, 0.01, 0.005])
    best = minimize(loss, start, method="Nelder-Mead", options={"xatol": 0.01, "fatol": 0.1})
    error = PlannerError(*np.exp(best.x).tolist())
    print(f"{len(known)} states, log-likelihood {-best.fun:.1f}")
    print(f"FITTED_ERROR = PlannerError({', '.join(f'{n}={v:.4f}' for n, v in error._asdict().items())})")
    return error._asdict()


def log_likelihood(rollouts, truth, error):
    """Multivariate t with the covariance of the sampling error and of what the rollouts miss."""
    num_actions = len(truth)
    chosen = np.flatnonzero(rollouts.is_uncertain & (rollouts.first_alike == np.arange(num_actions)))
    size, degrees = len(chosen), DEGREES_OF_FREEDOM
    sampling = np.atleast_2d(np.cov(rollouts.worths[:, chosen].T)) / len(rollouts.worths)
    missed = error.common**2 + np.diag(own_error(num_actions, error)[chosen] ** 2)
    scale = (sampling + rollouts.difficulty**2 * missed) * (degrees - 2.0) / degrees
    root = np.linalg.cholesky(scale)
    z = np.linalg.solve(root, (truth - expected_q(rollouts, error))[chosen])
    constant = gammaln((degrees + size) / 2) - gammaln(degrees / 2) - size / 2 * np.log(np.pi * degrees)
    return constant - np.log(np.diag(root)).sum() - (degrees + size) / 2 * np.log1p(z @ z / degrees)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fit", action="store_true", help="fit the constants and stop")
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/calibration.json"))
    parser.add_argument("--tables", type=int, default=8)
    parser.add_argument("--states", type=int, default=14)
    parser.add_argument("--paths", type=int, nargs="*", default=[50, 200, 800, 3200])
    args = parser.parse_args()
    if args.fit:
        fitted_error(args.tables, args.states)
        return
    results = {"planner": planner_calibration(args.tables, args.states)}
    if args.paths:
        results["learned"] = learned_calibration(args.paths, args.tables, args.states)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_text(json.dumps(results, indent=2), encoding="utf-8")
    print(f"Results: {args.out}")


if __name__ == "__main__":
    main()
