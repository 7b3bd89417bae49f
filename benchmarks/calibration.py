"""Are explanations calibrated? What is said to be best with 90 % is to be best in nine cases of ten.

python benchmarks/calibration.py [--out runs/benchmarks/calibration.json] [--tables 8] [--states 14] [--trajectories 50
800] python benchmarks/calibration.py --fit

States are those that the logging policy reaches on random small tables; the truth is the exact optimum. An action is
best where its exact Q is within 1e-9 of the largest: of actions that are worth the same, all are. Of a planner it is
`halfseen.planners.explain` that is checked; of what was learned, by size of the log, what `halfseen act` says of a
policy in its folder (`halfseen.policies.decision`). `--fit` prints what the constants of ``planners.explanation`` were
chosen by, on tables that the check never sees.
"""

import argparse
import json
import time
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from scipy.optimize import minimize
from scipy.special import gammaln

from halfseen.arrays import mapped
from halfseen.learning import CensoredQLearner
from halfseen.planners import GreedyPolicy, solve_table
from halfseen.planners.explanation import DEGREES_OF_FREEDOM, PlannerError, expected_q, explain, own_error, rollouts_of
from halfseen.policies import decider_of, read_policy
from halfseen.policies.folder import write_policy
from halfseen.tables.present import Present
from halfseen.world import ExploringPolicy, Scene, TableWorld, WorldConfig, random
from halfseen.world.actions import ActionSpace
from halfseen.world.rollout import play
from halfseen.world.state import pad_scenes

FIT_TABLES = {(3, 6): 1, (2, 8): 2}
CHECK_TABLES = {(3, 6): 13, (3, 5): 14, (4, 4): 15, (2, 10): 16}
"""(Cups, steps) and the seed of their tables."""
NUM_LOGGED_TABLES, LOG_SEED = 40, 99
CUT_SHARE, NUM_GRIP_NODES, NUM_ROLLOUTS = 1 / 3, 31, 512
LEVEL = 0.95
"""That intervals are to hold with, as those of `act` do."""
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
        key = random.key_of(1000 * seed + table)
        played = play(config, pad_scenes([scene]), logging_policy(config), key, num_states + 2)
        reached = rng.permutation(np.argwhere(np.asarray(played.is_taken)))[:num_states]
        states = [mapped(lambda leaf, at=(i, t): leaf[*at], played.states) for i, t in reached]
        found += [(state, optimum.q_values(state)) for state in states]
    return config, found


class Calibration:
    """What was said of actions, and what was so."""

    def __init__(self):
        self.said, self.was, self.holds, self.lift_holds = [], [], [], []
        self.num_states = 0

    def add(self, low, high, chance_best, truth):
        """Count one state; the interval of an action that was not spoken of is NaN."""
        is_spoken_of = np.isfinite(truth) & np.isfinite(low)
        self.num_states += 1
        self.said += chance_best[is_spoken_of].tolist()
        self.was += (truth >= truth.max() - 1e-9)[is_spoken_of].tolist()
        is_spoken_of[0] = False  # what FINISH is worth is known
        self.holds += ((low <= truth) & (truth <= high))[is_spoken_of].tolist()

    def add_lifts(self, explanation, truth):
        """Count the worth of each LIFT, which only a planner tells."""
        num_objects = len(explanation.lift_worth)
        worth = truth[1 + num_objects :] - truth[: 1 + num_objects].max()
        holds = (explanation.lift_low <= worth) & (worth <= explanation.lift_high)
        self.lift_holds += holds[np.isfinite(worth)].tolist()

    def report(self, title):
        best = binned(self.said, self.was)
        found = {"states": self.num_states, "coverage_of_q": float(np.mean(self.holds)), "best": best}
        line = f"{title}: {self.num_states} states; {LEVEL:.0%} intervals hold Q in {found['coverage_of_q']:.3f}"
        if self.lift_holds:
            found["coverage_of_lift_worth"] = float(np.mean(self.lift_holds))
            line += f", the worth of LIFT in {found['coverage_of_lift_worth']:.3f}"
        print(line)
        print("  best: " + "  ".join(f"{each['said']:.2f}→{each['was']:.2f} ({each['count']})" for each in best))
        return found


def binned(said, was):
    """Mean chance and share that was so, for each bin that is not empty."""
    said, was = np.asarray(said), np.asarray(was)
    place = np.digitize(said, BINS)
    return [
        {"said": said[place == k].mean(), "was": was[place == k].mean(), "count": int((place == k).sum())}
        for k in np.unique(place)
    ]


def planner_calibration(num_tables, num_states):
    result, everything, seconds = {}, Calibration(), []
    for (num_objects, horizon), seed in CHECK_TABLES.items():
        config, found = states_with_truth(num_objects, horizon, seed, num_tables, num_states)
        calibration = Calibration()
        for k, (state, truth) in enumerate(found):
            begin_s = time.perf_counter()
            one = explain(config, state, random.key_of(k), num_rollouts=NUM_ROLLOUTS, level=LEVEL)
            seconds.append(time.perf_counter() - begin_s)
            for each in (calibration, everything):
                each.add(one.low, one.high, one.probability_best, truth)
                each.add_lifts(one, truth)
        name = f"{num_objects} cups, {horizon} steps"
        result[name] = calibration.report(f"planner, {name}")
    result["all"] = everything.report("planner, all")
    result["median_s"] = float(np.median(seconds))
    print(f"  an explanation takes {result['median_s']:.3f} s")
    return result


def learned_calibration(sizes, num_tables, num_states):
    """What `act` says of policies in their folders, by size of the log, over all tables of the check."""
    result = {num_trajectories: Calibration() for num_trajectories in sizes}
    for (num_objects, horizon), seed in CHECK_TABLES.items():
        config, found = states_with_truth(num_objects, horizon, seed, num_tables, num_states)
        names = ActionSpace(num_objects).names
        for num_trajectories, calibration in result.items():
            decider = learned_decider(config, num_objects, LOG_SEED + seed, num_trajectories)
            for state, truth in found:
                decision = decider.decide(Present(state, horizon - int(state.steps_to_go) + 1))
                low, high = np.array([decision.intervals.get(name, (np.nan, np.nan)) for name in names]).T
                chance_best = np.array([decision.chance_best.get(name, np.nan) for name in names])
                calibration.add(low, high, chance_best, truth)
    return {size: calibration.report(f"learned from {size} trajectories") for size, calibration in result.items()}


def learned_decider(config, num_objects, seed, num_trajectories):
    """Of a policy that was learned from other tables than those that are decided on, and read from its folder."""
    rng = np.random.default_rng(seed)
    scenes = [random_scene(rng, num_objects) for _ in range(NUM_LOGGED_TABLES)]
    logs = TableWorld(config).simulate(
        scenes, logging_policy(config), num_trajectories, LOG_SEED + num_trajectories, CUT_SHARE
    )
    with TemporaryDirectory() as folder:
        write_policy(CensoredQLearner.for_table(config.horizon, laws=None).fit(logs), logs, Path(folder) / "policy")
        return decider_of(read_policy(Path(folder) / "policy"))


def fitted_error(num_tables, num_states):
    """The error of greatest likelihood; interchangeable actions count once."""
    known = []
    for (num_objects, horizon), seed in FIT_TABLES.items():
        config, found = states_with_truth(num_objects, horizon, seed, num_tables, num_states)
        known += [
            (rollouts_of(config, state, random.key_of(k), NUM_ROLLOUTS), truth)
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
    parser.add_argument("--fit", action="store_true", help="show what the constants were chosen by, and stop")
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/calibration.json"))
    parser.add_argument("--tables", type=int, default=8)
    parser.add_argument("--states", type=int, default=14)
    parser.add_argument("--trajectories", type=int, nargs="*", default=[50, 200, 800, 3200])
    args = parser.parse_args()
    if args.fit:
        fitted_error(args.tables, args.states)
        return
    results = {"planner": planner_calibration(args.tables, args.states)}
    if args.trajectories:
        results["learned"] = learned_calibration(args.trajectories, args.tables, args.states)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_text(json.dumps(results, indent=2), encoding="utf-8")
    print(f"Results: {args.out}")


if __name__ == "__main__":
    main()
