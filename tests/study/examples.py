"""Made-up pieces of every experiment, and what is made of them; and the experiments as small as they go."""

from dataclasses import asdict
from functools import cache
from typing import NamedTuple

import numpy as np

from attempt_logs import attempt_log
from halfseen.cell.calibration.attempts import trials
from halfseen.study.experiment import Pieces, Section
from halfseen.study.experiments import EXPERIMENTS
from halfseen.study.experiments.attempts import COMPLETED, VISIBLE_ONLY, Attempts, plain
from halfseen.study.experiments.attempts_models import MODELS as ATTEMPT_MODELS
from halfseen.study.experiments.censoring import Censoring
from halfseen.study.experiments.clutter import Clutter
from halfseen.study.experiments.grasp import MODELS, GraspModels
from halfseen.study.experiments.planning import Planning
from halfseen.study.experiments.regret import Regret
from halfseen.study.experiments.reward import Reward
from halfseen.study.pipeline import TREATMENTS, episodes_in_turn
from halfseen.study.policies import HEURISTICS, ONE_STEP
from halfseen.study.setting import Setting
from halfseen.tables.learner import MODEL, RULE
from halfseen.world.config import WorldConfig
from halfseen.world.scene import Scene

REWARDS = dict(zip((each.name for each in HEURISTICS), (3.1, 3.6, 6.2, 6.4), strict=True))
OWN, PLANNED, NUM_EPISODES = 9.0, 9.1, 50
REWARD, PLANNING, CENSORING, GRASP, ATTEMPTS, CLUTTER, REGRET = EXPERIMENTS


def example_setting(repetitions=6):
    rng = np.random.default_rng(0)
    scenes = []
    for k in range(10):
        hides = np.triu(rng.beta(0.4, 1.6, (5 + k % 6, 5 + k % 6)), 1)
        scenes.append(Scene(np.where(hides < 0.05, 0.0, hides), f"table_{k:02d}.pcd"))
    return Setting(tuple(scenes), repetitions=repetitions)


def example_pieces(experiment, lead=0.0, gain=0.0, repetitions=6):
    """Pieces in which the learned policy ends `lead` above the planners, and weights (or the SVM) gain `gain`."""
    rng = np.random.default_rng(1)
    made = {
        "reward": lambda k: _reward(rng, lead),
        "planning": lambda k: _planning(rng, k, lead),
        "censoring": lambda k: _censoring(rng, gain),
        "grasp": lambda k: _grasp(rng, gain),
        "regret": lambda k: _regret(rng, lead),
    }
    if experiment.name == "clutter":
        return Pieces(
            {}, {}, map_pieces(lambda place: 0.3 if place.reward_wash_clean == -20 else gain, repetitions=repetitions)
        )
    if experiment.name == "attempts":
        return attempt_pieces(gain, repetitions=max(repetitions, 8))
    names = ("censored_q", *getattr(experiment, "baseline_names", ()), *getattr(experiment, "contenders", {}))
    measured = {"decision_ms": dict.fromkeys(names, 0.5), "learning_s": 0.3}
    planned = {name: PLANNED + 0.1 * k for k, name in enumerate(REWARD.planner_names)}
    exact = {name: [5.0 - 0.5 * reward] * 2 for name, reward in REWARDS.items()}
    prepared = {"selection": REWARDS | planned, "optimum": [4.0, 6.0], "finish": [-9.0, -9.0], "regrets": exact}
    return Pieces(prepared, measured, [made[experiment.name](k) for k in range(repetitions)])


class Example(NamedTuple):
    """Made-up pieces of an experiment, and all that becomes of them."""

    setting: Setting
    pieces: Pieces
    tables: dict
    section: Section


@cache
def example(experiment, repetitions=6, **options):
    """What an experiment makes of its example's pieces, once."""
    setting, pieces = example_setting(repetitions), example_pieces(experiment, repetitions=repetitions, **options)
    tables = experiment.tabulate(setting, pieces)
    return Example(setting, pieces, tables, experiment.section(setting, tables))


def _means(reward):
    return {"reward": float(reward), "robot_s": 30.0 + 0.1 * float(reward)}


def _reward(rng, lead):
    luck = rng.normal()
    own = OWN + luck + lead
    rows = []
    for size in REWARD.num_trajectories:
        for share in REWARD.cut_shares:
            steps = np.log2(max(REWARD.num_trajectories) / size)
            reward = own - 0.35 * steps + 0.8 * (0.5 - share) + 0.1 * rng.normal()
            weights = {"effective_sample_size": 5.5 * size * (1 - share), "largest_weight": 1.0 + 8.0 * share}
            weights["basis"] = MODEL if size > 25 else RULE
            rows.append({"num_trajectories": size, "cut_share": share, **weights, **_means(reward)})
    headline = next(row for row in rows if (row["num_trajectories"], row["cut_share"]) == (800, 0.5))["reward"]
    baselines = [
        _beside(name, 10, PLANNED + 0.1 * k + luck + 0.2 * rng.normal(), own)
        for k, name in enumerate(REWARD.planner_names)
    ]
    for name, reward in REWARDS.items():
        baselines.append(_beside(name, NUM_EPISODES, reward + luck + 0.1 * rng.normal(), headline))
    baselines.append(_beside(ONE_STEP.name, NUM_EPISODES, PLANNED + luck - 0.1 + 0.1 * rng.normal(), headline))
    made = [{"policy": "censored_q"} | row for row in rows]
    for k, name in enumerate(REWARD.beside_names, start=1):
        made += [{"policy": name} | _place(row) | _means(row["reward"] - 0.3 * k + 0.1 * rng.normal()) for row in rows]
        baselines.append(_beside(name, NUM_EPISODES, made[-1]["reward"], headline))
    baselines.append(_beside(REWARD.peer.name, 10, PLANNED + luck + 0.2 * rng.normal(), own))
    peer = [_place(row) | {"over_peer": lead + 0.3 * rng.normal()} for row in rows]
    return {"rows": made, "baselines": baselines, "peer": peer}


def _place(row):
    return {"num_trajectories": row["num_trajectories"], "cut_share": row["cut_share"]}


def _beside(name, num_episodes, other, own):
    own = {f"own_{measure}": mean for measure, mean in _means(own).items()}
    return {"policy": name, "num_episodes": num_episodes} | _means(other) | own


def _planning(rng, index, lead):
    luck = rng.normal(0.0, 8.0, NUM_EPISODES)
    rewards = {"censored_q": OWN} | REWARDS | dict.fromkeys(PLANNING.by_simulations, OWN - lead)
    rewards |= {name: OWN - 2.0 + 0.3 * h for name, h in PLANNING.by_horizon.items()}
    some = dict(zip(PLANNING.by_simulations, (count for _, count in PLANNING.simulations), strict=True))
    rows = []
    for name, reward in rewards.items():
        episodes = episodes_in_turn(index, some.get(name, NUM_EPISODES), NUM_EPISODES)
        earned = reward + luck[episodes] + 0.3 * rng.normal(size=len(episodes))
        earned = zip(episodes, earned.tolist(), strict=True)
        rows += [{"policy": name, "episode": episode, "reward": each} for episode, each in earned]
    return {"rows": rows}


def _censoring(rng, gain):
    luck = rng.normal()
    rows = []
    for size in CENSORING.num_trajectories:
        for kind in CENSORING.cut_kinds:
            for k, treatment in enumerate(TREATMENTS):
                behind = k * gain if kind == "independent" else 0.0
                reward = OWN + luck + 0.3 * np.log2(size / 800) - behind + 0.1 * rng.normal()
                rows.append({"treatment": treatment, "cut_kind": kind, "num_trajectories": size, **_means(reward)})
    return {"rows": rows}


def _grasp(rng, lead):
    luck = rng.normal(size=2)
    rows = []
    for size in GRASP.num_trajectories:
        for k, model in enumerate(MODELS):
            above = {"succession": 0.2, "oracle": 0.0, "svm": 0.01 - lead}.get(model, 0.01)
            noise, attempts = rng.normal(size=4) * 0.001, rng.integers(100, 300, size=10)
            said = attempts * (np.arange(10) + 0.5) / 10
            successes = rng.binomial(attempts, said / attempts).tolist()
            row: dict = {"model": model, "num_trajectories": size, "stands_in": False}
            row |= {"log_loss": 0.5 + above + 0.01 * luck[0] + noise[0]}
            row |= {"brier": 0.15 + above / 3 + 0.01 * luck[0] + noise[1]}
            row |= {"learned_reward": 9.0 + luck[1] - above + 0.1 * k + noise[2]}
            row |= {"heuristic_reward": 6.0 + luck[1] - above + noise[3]}
            rows.append(
                row | {"bins": {"attempts": attempts.tolist(), "probabilities": said.tolist(), "successes": successes}}
            )
    return {"rows": rows}


def _regret(rng, lead):
    rows = [{"policy": who.name, "regrets": [0.5 / k, 0.7 / k]} for k, who in enumerate(REGRET.planners, start=1)]
    for size in REGRET.num_trajectories:
        for share in REGRET.cut_shares:
            values = (np.maximum(0.0, [60.0 / size - lead, 2.0 * share]) + 0.02 * rng.random()).tolist()
            rows.append({"policy": "censored_q", "num_trajectories": size, "cut_share": share, "regrets": values})
    return {"rows": rows}


WORLD = WorldConfig()
OF_MAP = Setting((), world=WORLD)


def map_pieces(gain_share, design=None, repetitions=5, noise=0.01, setting=OF_MAP):
    """Make pieces in which the learned policy gains a share, by place, of the 12 that the best heuristic earns."""
    rng = np.random.default_rng(0)
    pieces = []
    for _ in range(repetitions):
        rows = []
        for place in (design or Clutter()).places(setting):
            best = 12.0 - 3.0 * place.num_objects
            learned = best + 12.0 * (gain_share(place) + noise * rng.normal())
            rewards = {"censored_q": learned, "greedy": best - 2, "history": best - 3, "greedy-penalty": best - 1}
            rows.append(asdict(place) | rewards | {"history-penalty": best})
        pieces.append({"rows": rows})
    return pieces


def table_of(pieces, design=None):
    return (design or Clutter()).tabulate(OF_MAP, Pieces({}, {}, pieces))["map"]


def map_table(gain_share, design=None, **options):
    return table_of(map_pieces(gain_share, design, **options), design)


def map_section(table, setting=OF_MAP):
    return Clutter().section(setting, {"map": table})


NUM_TABLES = 30
ABOVE = {"rate": 0.02, "beta": 0.0, "svm-facts": -0.01, "svm-set": -0.005, "law": -0.012}


@cache
def source(seed=0):
    """Attempts at some tables."""
    return plain(trials(attempt_log(NUM_TABLES, seed), 12))


def attempt_pieces(gain=0.0, repetitions=8, has_both=True):
    """Make pieces in which the SVM gains so much over the Beta mean, in each attempt."""
    design, rng = Attempts(), np.random.default_rng(3)
    prepared = {COMPLETED: source(), **({VISIBLE_ONLY: source(1)} if has_both else {})}
    decided = np.flatnonzero(prepared[COMPLETED]["is_finished"])
    trajectory = np.array(prepared[COMPLETED]["trajectory"])[decided]
    hard = rng.normal(0.15, 0.05, NUM_TABLES)
    pieces = [_attempts(design, index, decided, trajectory, hard, gain, rng) for index in range(repetitions)]
    return Pieces(prepared, {}, pieces)


def _attempts(design, index, decided, trajectory, hard, gain, rng):
    tables = design.split(np.unique(trajectory), 0, index).held_out
    rows = np.isin(trajectory, tables)
    weight = np.array([np.sum(trajectory == table) for table in tables], dtype=float)
    scores = []
    for size in design.num_tables:
        for model in ATTEMPT_MODELS:
            loss = hard[tables] + ABOVE.get(model, -gain) + rng.normal(0.0, 0.002, len(tables))
            row = {"model": model, "num_tables": size, "stands_in": model == "svm" and size == 25 and index == 0}
            scores.append(row | {"log_loss": (weight * loss).tolist(), "brier": (weight * loss / 5).tolist()})
    said = {model: np.full(int(rows.sum()), 0.9).tolist() for model in ATTEMPT_MODELS}
    said["law"] = rng.uniform(0.6, 1.0, int(rows.sum())).tolist()
    kept = {"attempts": decided[rows].tolist(), "row_weight": np.ones(int(rows.sum())).tolist(), "said": said}
    return {"rows": scores, "tables": tables.tolist(), "weight": weight.tolist(), **kept}


SIZES = (25, 50)


def table(num_objects):
    rng = np.random.default_rng(num_objects)
    return Scene(np.tril(rng.uniform(0.0, 0.6, (num_objects, num_objects)), -1), name=f"table_{num_objects}")


SETTING = Setting((table(3), table(4)), repetitions=2)
TINY = (
    Reward(
        SIZES,
        (0.0, 0.5),
        2,
        ((4, 2), (8, 1)),
        fitted_episodes=2,
        selection_blocks=2,
        selection_planned=2,
        table_num_trajectories=50,
        num_starts=300,
    ),
    Planning(
        ((4, 2), (8, 1)), (1, 2), 8, horizon_episodes=4, num_trajectories=50, episodes_per_scene=2, num_starts=300
    ),
    Censoring(SIZES, compared_num_trajectories=50, episodes_per_scene=2),
    GraspModels(SIZES, episodes_per_scene=2, num_starts=300),
    Clutter((2, 3), (0.2,), (1.0,), (-10.0,), (0.5,), num_trajectories=50, num_tables=4, episodes_per_table=5),
    Regret(2, 3, SIZES, (0.0, 0.5), planner_horizons=(1, 2), planner_simulations=8),
    Attempts((5, 10), 2),
)
