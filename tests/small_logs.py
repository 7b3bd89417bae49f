"""Small logs, some trajectories cut, made without the simulated world, whose compilation takes longer."""

import numpy as np
import pandas as pd

from halfseen.learning import CensoredQLearner
from halfseen.logs import Logs
from halfseen.policies.folder import read_policy, write_policy

HIDES = np.array([[0.0, 0.4], [0.1, 0.0]])


def log_of(ends=None, objects=None, **columns):
    """A log by columns of its stages; a trajectory whose last one has no clock was cut, unless `ends` say otherwise."""
    own = {"trajectory": 1, "stage": 1, "elapsed_s": 1.0, "action": "A", "reward": 1.0}
    stages = pd.DataFrame(own | columns)
    stages["reward"] = stages["reward"].where(stages["elapsed_s"].notna())
    last = stages.drop_duplicates("trajectory", keep="last")
    ending = np.where(last["elapsed_s"].isna(), "cut", "finished")
    known = {"trajectory": last["trajectory"], "end_s": last["elapsed_s"], "ending": ending}
    return Logs(stages, pd.DataFrame(known | (ends or {})), objects)


def flat_log(num_trajectories=40, horizon=2, seed=0, cut_after_s=6.0):
    """Actions A and B at stage 1, A and C at stage 2; one covariate in words."""
    rng = np.random.default_rng(seed)
    stages, trajectories = [], []
    for trajectory in range(num_trajectories):
        clock, cut_s = 0.0, rng.exponential(cut_after_s) + 0.1
        for stage in range(1, horizon + 1):
            x1, x2 = rng.normal(), rng.integers(0, 3)
            action = rng.choice(["A", "B" if stage == 1 else "C"])
            clock += rng.uniform(0.5, 2.0)
            is_seen = clock <= cut_s
            row = {"trajectory": trajectory, "stage": stage, "action": action, "x1": x1, "x2": x2, "colour": "red"}
            reward = x1 * (1 if action == "A" else -1) + 0.1 * rng.normal() if is_seen else None
            stages.append({**row, "elapsed_s": clock if is_seen else None, "reward": reward})
            if not is_seen:
                break
        trajectories.append(
            {"trajectory": trajectory, "end_s": min(clock, cut_s), "ending": "finished" if is_seen else "cut"}
        )
    return Logs(pd.DataFrame(stages), pd.DataFrame(trajectories))


def flat_learner(reg=0.1, **options):
    return CensoredQLearner.of_paper(2, {1: ["A", "B"], 2: ["A", "C"]}, ["x1", "x2"], reg=reg, **options)


def kept(learner, logs, folder, **how):
    """A policy that is learned from logs, written and read."""
    write_policy(learner.fit(logs), logs, folder, **how)
    return read_policy(folder)


def table_log(num_trajectories=24, horizon=3, num_objects=2, seed=0, hides=HIDES):
    """Tables of which each action grasps one object more often than not; FINISH is rare."""
    rng = np.random.default_rng(seed)
    tables = [_table_trajectory(trajectory, horizon, num_objects, hides, rng) for trajectory in range(num_trajectories)]
    stages, ends, objects = zip(*tables, strict=True)
    return Logs(*(pd.DataFrame([row for part in rows for row in part]) for rows in (stages, ends, objects)))


def _table_trajectory(trajectory, horizon, num_objects, hides, rng):
    there, tried, lifts = np.ones(num_objects, dtype=bool), [[] for _ in range(num_objects)], [0] * num_objects
    log_odds = rng.normal(0.4, 1.0, num_objects)
    stages, objects = [], []
    clock, cut_s = 0.0, rng.exponential(25.0) + 0.1
    for stage in range(1, horizon + 1):
        occluded = 1.0 - np.prod(np.where(there, 1.0 - hides, 1.0), axis=1)
        for k in range(num_objects):
            shares, outcomes = ([each[part] for each in tried[k]] for part in (0, 1))
            where = "TABLE" if there[k] else "DISHWASHER"
            row = {"trajectory": trajectory, "stage": stage, "object": k, "location": where, "occlusion": occluded[k]}
            row |= {"log_odds": log_odds[k], "successes": sum(outcomes), "failures": len(outcomes) - sum(outcomes)}
            row |= {"lifts": lifts[k], "hidden_by": hides[k].tolist()}
            objects.append(row | {"attempt_occlusions": shares, "attempt_succeeded": outcomes})
        verb = rng.choice(["WASH", "LIFT", "FINISH"], p=[0.55, 0.35, 0.1])
        target = int(rng.choice(np.flatnonzero(there)))
        clock += rng.uniform(1.0, 6.0)
        is_seen = clock <= cut_s
        held = bool(rng.random() < 0.7 * (1.0 - occluded[target]))
        reward = {"WASH": 2.0 * log_odds[target] if held else -1.0, "LIFT": -0.4, "FINISH": -2.0 * there.sum()}[verb]
        done = {"action": verb, "object": None if verb == "FINISH" else target, "probability": 0.25}
        came = {"elapsed_s": clock if is_seen else None, "reward": reward if is_seen else None}
        stages.append({"trajectory": trajectory, "stage": stage, **done, **came})
        if verb != "FINISH":
            tried[target].append((occluded[target], held))
            lifts[target] += verb == "LIFT" and held
            there[target] &= not (verb == "WASH" and held)
            log_odds = log_odds + rng.normal(0.0, 0.5, num_objects)
        if not is_seen or verb == "FINISH" or not there.any():
            break
    ending = "finished" if is_seen else "cut"
    return stages, [{"trajectory": trajectory, "end_s": min(clock, cut_s), "ending": ending}], objects


def begun_log(scene):
    """Logs of a table: three trajectories, and a last one that has come to its first stage without an action."""
    logs = table_log(num_trajectories=4, num_objects=scene.num_objects, hides=scene.hides, seed=1)
    stages, objects = (
        rows[(rows["trajectory"] < 3) | (rows["stage"] == 1)].copy() for rows in (logs.stages, logs.objects)
    )
    trajectories, is_now = logs.trajectories.copy(), stages["trajectory"] == 3
    stages.loc[is_now, ["elapsed_s", "reward"]] = np.nan
    stages.loc[is_now, ["action", "object"]] = None
    trajectories.loc[trajectories["trajectory"] == 3, ["end_s", "ending", "cause"]] = [1.0, "cut", "crash"]
    return Logs(stages, trajectories, objects)
