"""Logs of attempts at physical tables, drawn by the law of `truth`, and cut at random."""

import numpy as np
import pandas as pd
from scipy.special import expit

from halfseen.cell.calibration.fits import CENTRES, SCALES
from halfseen.logs import Logs
from halfseen.perception.labels import FACING_SHARE

TRUTH = np.array([3.0, -2.0, -1.5, -0.4, 0.3, np.log(0.8)])


def attempt_log(num_tables=40, seed=0, truth=TRUTH, num_objects=4, num_stages=6, cut_rate=0.01):
    """Each table is tried `num_stages` times, an object drawn at random each time, unless it is cut."""
    rng = np.random.default_rng(seed)
    parts = [_table(trajectory, rng, truth, num_objects, num_stages, cut_rate) for trajectory in range(num_tables)]
    return Logs(*(pd.DataFrame([row for part in rows for row in part]) for rows in zip(*parts, strict=True)))


def _table(trajectory, rng, truth, num_objects, num_stages, cut_rate):
    things = [_thing(rng, truth) for _ in range(num_objects)]
    stages, objects, clock_s, cut_s = [], [], 0.0, rng.exponential(1.0 / cut_rate)
    for stage in range(1, num_stages + 2):
        for number, thing in enumerate(things):
            objects.append({"trajectory": trajectory, "stage": stage, "object": number, **_seen(thing)})
        row = {"trajectory": trajectory, "stage": stage, "action": "FINISH", "object": None}
        row |= {"elapsed_s": clock_s + 1.0, "reward": 0.0}
        if stage <= num_stages:
            number = int(rng.integers(num_objects))
            held, attempt_s = _tried(things[number], rng, truth)
            clock_s += attempt_s + 5.0
            is_cut = clock_s > cut_s
            row |= {"action": "LIFT", "object": number, "elapsed_s": None if is_cut else clock_s}
            row["reward"] = None if is_cut else 0.0
            if not is_cut:
                things[number]["outcomes"].append(held)
                things[number]["attempt_s"].append(attempt_s)
                if held:
                    things[number]["labels"].append((0.0, True, things[number]["shows"] > 0.2))
        stages.append(row)
        if row["elapsed_s"] is None:
            end = {"trajectory": trajectory, "end_s": cut_s, "ending": "cut", "cause": "operator"}
            return stages, [end], objects
    return stages, [{"trajectory": trajectory, "end_s": clock_s + 1.0, "ending": "finished", "cause": None}], objects


def _thing(rng, truth):
    hidden = float(rng.uniform(0.0, 0.8)) * (rng.random() < 0.6)
    shows, is_dirty = rng.random(), bool(rng.random() < 0.5)
    facts = {"is_lying": bool(rng.random() < 0.3), "width_m": float(rng.normal(0.075, 0.015))}
    return {
        "facts": facts | {"room_m": float(rng.uniform(0.0, 0.1))},
        "offset": np.exp(truth[-1]) * rng.normal(),
        "occlusion": hidden,
        "is_dirty": is_dirty,
        "shows": shows if is_dirty else 0.25 * shows,
        "labels": [(hidden, False, shows * FACING_SHARE * (1 - hidden) > 0.15)],
        "outcomes": [],
        "attempt_s": [],
    }


def _tried(thing, rng, truth):
    x = [1.0, thing["occlusion"], *((thing["facts"][name] - CENTRES[name]) / SCALES[name] for name in CENTRES)]
    held = bool(rng.random() < expit(np.dot(truth[:-1], x) + thing["offset"]))
    return held, float(np.exp(rng.normal(2.0 if held else 1.8, 0.1)))


def _seen(thing):
    occlusions, held, dirty = zip(*thing["labels"], strict=True)
    return {
        "occlusion": thing["occlusion"],
        "successes": sum(thing["outcomes"]),
        "failures": len(thing["outcomes"]) - sum(thing["outcomes"]),
        "attempt_s": list(thing["attempt_s"]),
        **thing["facts"],
        "glance_occlusions": list(occlusions),
        "glance_held": list(held),
        "glance_dirty": [bool(each) for each in dirty],
        "is_dirty": thing["is_dirty"],
    }
