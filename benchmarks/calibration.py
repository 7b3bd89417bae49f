"""Are explanations calibrated? What is said to be best with 90 % is to be best in nine cases of ten.

python benchmarks/calibration.py [--out runs/benchmarks/calibration.json] [--tables 8] [--states 14] [--trajectories 50
800] python benchmarks/calibration.py --fit python benchmarks/calibration.py --stored

States are those that the logging policy reaches on random small tables; the truth is the exact optimum. An action is
best where its exact Q is within 1e-9 of the largest: of actions that are worth the same, all are. `--fit` prints what
the constants of ``planners.explanation`` and ``tables.explain`` were chosen by, on tables that the check
never sees. `--stored` checks what `halfseen act` says: 95 % intervals and chances by the margin that a policy's folder
holds.
"""

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
from scipy.optimize import minimize
from scipy.special import gammaln

from halfseen.arrays import mapped
from halfseen.learning import CensoredQLearner
from halfseen.planners import GreedyPolicy, solve_table
from halfseen.planners.explanation import DEGREES_OF_FREEDOM, PlannerError, expected_q, explain, own_error, rollouts_of
from halfseen.policies import certainty, decider_of
from halfseen.policies.folder.log_facts import stages_left
from halfseen.tables import explain as explained_tables
from halfseen.tables.explain import LASTING_ERROR, LearnedExplainer
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
STRETCHES = [(1.0, 0.0), (1.2, 0.1), (1.35, 0.06), (1.35, 0.1), (1.5, 0.06), (1.5, 0.1), (1.7, 0.08), (2.0, 0.08)]
"""Of the learned explanation, to choose from: (WIDENED, LASTING_ERROR)."""
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

    @property
    def log_score(self):
        """Mean log-probability of what was so; the larger the better."""
        said = np.clip(self.said, 0.005, 0.995)
        return float(np.mean(np.where(self.was, np.log(said), np.log1p(-said))))

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
            one = explain(config, state, random.key_of(k), num_rollouts=NUM_ROLLOUTS)
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
    """Against the optimum, by size of the log, over all tables of the check."""
    told = {str(num_trajectories): Calibration() for num_trajectories in sizes}
    for (num_objects, horizon), seed in CHECK_TABLES.items():
        for num_trajectories, explainer, found in learned(num_objects, horizon, seed, sizes, num_tables, num_states):
            for state, truth in found:
                told[str(num_trajectories)].add(explainer.explain(state), truth)
    return {size: calibration.report(f"learned from {size} trajectories") for size, calibration in told.items()}


def learned(num_objects, horizon, seed, sizes, num_tables, num_states):
    """Explainers of what was learned."""
    for num_trajectories, learner, logs, found in fitted(num_objects, horizon, seed, sizes, num_tables, num_states):
        yield num_trajectories, LearnedExplainer.of(learner, logs), found


def fitted(num_objects, horizon, seed, sizes, num_tables, num_states):
    """Learners of logs of other tables than those that the states are of."""
    config, found = states_with_truth(num_objects, horizon, seed, num_tables, num_states)
    rng = np.random.default_rng(LOG_SEED + seed)
    scenes = [random_scene(rng, num_objects) for _ in range(NUM_LOGGED_TABLES)]
    for num_trajectories in sizes:
        logs = TableWorld(config).simulate(
            scenes, logging_policy(config), num_trajectories, LOG_SEED + num_trajectories, CUT_SHARE
        )
        yield num_trajectories, CensoredQLearner.for_table(horizon, laws=None).fit(logs), logs, found


def stored_calibration(sizes, num_tables, num_states):
    """Whether 95 % intervals hold the exact Q, and chances of being best come true, by size of the log."""
    told = {}
    for num_trajectories in sizes:
        said, was, holds = [], [], []
        for (num_objects, horizon), seed in CHECK_TABLES.items():
            for _, learner, logs, found in fitted(
                num_objects, horizon, seed, [num_trajectories], num_tables, num_states
            ):
                lasting = certainty.LASTING_ERROR * float(np.nanstd(logs.stages["reward"].astype(float)))
                q_error = certainty.QError(learner.model_.pessimism, stages_left(logs), lasting)
                decider = decider_of(learner.policy_, q_error=q_error)
                names = ActionSpace(num_objects).names
                for state, truth in found:
                    decision = decider.decide(Present(state, horizon - int(state.steps_to_go) + 1))
                    for k, name in enumerate(names):
                        if name in decision.intervals and np.isfinite(truth[k]):
                            low, high = decision.intervals[name]
                            holds.append(low <= truth[k] <= high)
                            said.append(decision.chance_best[name])
                            was.append(bool(truth[k] >= truth.max() - 1e-9))
        told[str(num_trajectories)] = {"coverage_of_q": float(np.mean(holds)), "best": binned(said, was)}
        print(f"stored, {num_trajectories} trajectories: 95 % intervals hold Q in {np.mean(holds):.3f}")
        print(
            "  best: "
            + "  ".join(f"{b['said']:.2f}→{b['was']:.2f} ({b['count']})" for b in told[str(num_trajectories)]["best"])
        )
    return told


def compared_stretches(sizes, num_tables, num_states):
    """How well each stretch of the bootstrap's deviations tells what is best, and covers Q."""
    tried = {stretch: Calibration() for stretch in STRETCHES}
    for (num_objects, horizon), seed in FIT_TABLES.items():
        for _, explainer, found in learned(num_objects, horizon, seed, sizes, num_tables, num_states):
            for widened, lasting in STRETCHES:
                one = replace(explainer, lasting_error=explainer.lasting_error / LASTING_ERROR * lasting)
                with patch.object(explained_tables, "WIDENED", widened):
                    for state, truth in found:
                        tried[widened, lasting].add(one.explain(state), truth)
    for stretch, calibration in tried.items():
        print(f"(WIDENED, LASTING_ERROR) = {stretch}: log score {calibration.log_score:.4f}")
        calibration.report("  learned")


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
    parser.add_argument("--stored", action="store_true", help="check what `halfseen act` says, and stop")
    parser.add_argument("--out", type=Path, default=Path("runs/benchmarks/calibration.json"))
    parser.add_argument("--tables", type=int, default=8)
    parser.add_argument("--states", type=int, default=14)
    parser.add_argument("--trajectories", type=int, nargs="*", default=[50, 200, 800, 3200])
    args = parser.parse_args()
    if args.fit:
        fitted_error(args.tables, args.states)
        compared_stretches(args.trajectories, args.tables, args.states)
        return
    if args.stored:
        stored_calibration(args.trajectories, args.tables, args.states)
        return
    results = {"planner": planner_calibration(args.tables, args.states)}
    if args.trajectories:
        results["learned"] = learned_calibration(args.trajectories, args.tables, args.states)
    args.out.parent.mkdir(parents=True, exist_ok=True)
    args.out.write_text(json.dumps(results, indent=2), encoding="utf-8")
    print(f"Results: {args.out}")


if __name__ == "__main__":
    main()
