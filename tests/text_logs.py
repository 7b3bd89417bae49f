"""A log with text among its covariates, and the same with indicators made by pandas."""

import numpy as np
import pandas as pd

from halfseen.logs import Logs

ACTIONS = ["A", "B"]
COLOURS = ("blue", "green", "red")
COVARIATES = ["x", "colour", "is_heavy"]
BY_HAND = ["x", "colour=green", "colour=red", "is_heavy"]


def text_log(num_trajectories=60, seed=0, colours=COLOURS, **columns):
    """B is worth more than A on what is red; trajectories are cut after a while."""
    rng = np.random.default_rng(seed)
    stages, trajectories = [], []
    for trajectory in range(num_trajectories):
        clock, cut_s = 0.0, rng.exponential(6.0) + 0.1
        for stage in (1, 2):
            x, colour, is_heavy = rng.normal(), str(rng.choice(colours)), bool(rng.integers(2))
            action = str(rng.choice(ACTIONS))
            clock += rng.uniform(0.5, 2.0)
            is_seen = clock <= cut_s
            worth = x + (1.0 if (colour == "red") == (action == "B") else -1.0)
            begun = {"trajectory": trajectory, "stage": stage, "action": action}
            seen = {"x": x, "colour": colour, "is_heavy": is_heavy}
            made = {name: make(trajectory, stage) for name, make in columns.items()}
            reward = worth + 0.1 * rng.normal() if is_seen else None
            done = {"elapsed_s": clock if is_seen else None, "reward": reward, "probability": 0.5}
            stages.append({**begun, **seen, **made, **done})
            if not is_seen:
                break
        trajectories.append(
            {"trajectory": trajectory, "end_s": min(clock, cut_s), "ending": "finished" if is_seen else "cut"}
        )
    return Logs(pd.DataFrame(stages), pd.DataFrame(trajectories))


def with_indicators(frame, colours=COLOURS):
    """The same states, as pandas makes indicators of all categories but the first."""
    typed = frame.assign(colour=pd.Categorical(frame["colour"], categories=sorted(colours)))
    return pd.get_dummies(typed, columns=["colour"], prefix_sep="=", drop_first=True, dtype=float)


def by_hand(logs):
    """The same log, with indicators."""
    return Logs(with_indicators(logs.stages), logs.trajectories)
