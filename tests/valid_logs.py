"""Logs that break nothing: one to be broken by hand, and any number drawn at random."""

import numpy as np
import pandas as pd
from hypothesis import strategies as st

CAUSES, DONE = ["battery", "operator", "camera"], ("elapsed_s", "reward")


def small_tables():
    """Trajectory 1 finishes in two stages, trajectory 2 is cut in its second, trajectory 3 in its first."""
    stages = pd.DataFrame(
        {
            "trajectory": [1, 1, 2, 2, 3],
            "stage": [1, 2, 1, 2, 1],
            "elapsed_s": [1.5, 4.0, 2.0, np.nan, np.nan],
            "action": ["LIFT", "FINISH", "WASH", "WASH", None],
            "object": ["cup", None, "mug", "cup", None],
            "reward": [-0.1, -5.0, 5.0, np.nan, np.nan],
            "probability": [0.5, 1.0, 0.25, 0.25, np.nan],
            "steps_to_go": [10, 9, 10, 9, 10],
        }
    )
    trajectories = pd.DataFrame(
        {
            "trajectory": [1, 2, 3],
            "end_s": [4.0, 3.5, 0.5],
            "ending": ["finished", "cut", "cut"],
            "cause": [None, "battery", "operator"],
            "scene": ["a", "b", "b"],
        }
    )
    objects = pd.DataFrame(
        {
            "trajectory": np.repeat([1, 1, 2, 2, 3], 2),
            "stage": np.repeat([1, 2, 1, 2, 1], 2),
            "object": ["cup", "mug"] * 5,
            "occlusion": np.linspace(0.0, 0.9, 10),
            "hidden_by": [[0.1 * row, 0.0] for row in range(10)],
        }
    )
    return {"stages": stages, "trajectories": trajectories, "objects": objects}


@st.composite
def valid_tables(draw):
    """Tables of any number of trajectories, in any order, with text or integers for names."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    is_text = draw(st.booleans())
    num_trajectories = draw(st.integers(1, 6))
    ids = rng.choice(1000, num_trajectories, replace=False)
    trajectories, stages, objects = [], [], []
    for trajectory in (f"p{i}" for i in ids) if is_text else ids.tolist():
        is_cut = bool(rng.random() < 0.5)
        clock = np.cumsum(rng.integers(1, 4, rng.integers(1, 5)) / 2)
        end = {"trajectory": trajectory, "end_s": clock[-1], "ending": "cut" if is_cut else "finished"}
        trajectories.append(end | {"seed": rng.integers(9), "cause": rng.choice(CAUSES) if is_cut else None})
        for stage, elapsed_s in enumerate(clock, start=1):
            is_completed = not (is_cut and stage == len(clock))
            names, at = rng.permutation(9)[: rng.integers(1, 4)], {"trajectory": trajectory, "stage": stage}
            target = int(names[0]) if rng.random() < 0.7 else None
            came = {"elapsed_s": elapsed_s, "reward": rng.normal()} if is_completed else dict.fromkeys(DONE)
            seen = {"x": np.float32(rng.normal()), "is_held": bool(rng.random() < 0.5)}
            stages.append({**at, "action": "WASH", "object": target, **came, **seen})
            objects += [{**at, "object": int(name), "hidden_by": rng.random(rng.integers(0, 3))} for name in names]
    frames = (pd.DataFrame(rows).sample(frac=1.0, random_state=1) for rows in (stages, trajectories, objects))
    tables = dict(zip(("stages", "trajectories", "objects"), frames, strict=True))
    if draw(st.booleans()):
        tables["objects"] = None
    return tables


def assert_same(left, right):
    assert left.tables.keys() == right.tables.keys()
    for name, table in left.tables.items():
        pd.testing.assert_frame_equal(table, right.tables[name])
