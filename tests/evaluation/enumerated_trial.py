"""A trial of two stages on whole numbers, whose values follow by enumeration; cuts, ties and early ends included."""

from dataclasses import dataclass

import numpy as np
import pandas as pd

from halfseen.evaluation import QSpec
from halfseen.evaluation.off_policy import default_q, default_targets, q_model_of
from halfseen.evaluation.problem import problem_of
from halfseen.learning import NamedActions
from halfseen.logs import Logs

ACTIONS = ("A", "B")
CHANCE_B = np.array([0.3, 0.6])
"""Of the logging policy, by state."""


def pays(state, action, duration):
    return state - 0.5 * action + 2.0 * (state == action) + 0.5 * duration


def leaves(state, action):
    return state == 1 and action == 0


@dataclass(frozen=True)
class StatePolicy:
    chance_b: tuple[float, float]
    horizon: int = 2
    actions: tuple[str, ...] = ACTIONS

    def probabilities(self, frame, stage):
        chance_b = np.array(self.chance_b)[frame["x"].to_numpy(dtype=int)]
        return np.stack([1.0 - chance_b, chance_b], axis=1)


def truth(chance_b):
    """States are fair coins; a stage lasts 1 to 3 s alike, or 2 to 4 s in state 1."""
    last = after = 0.0
    for _ in range(2):
        after, last = last, 0.0
        for state in (0, 1):
            for action, chance in enumerate((1.0 - chance_b[state], chance_b[state])):
                goes_on = 0.0 if leaves(state, action) else after
                last += 0.5 * chance * (pays(state, action, 2.0 + state) + goes_on)
    return last


def trial(seed, num_trajectories=200, cut_rate=0.0, has_probability=True, knows_last_action=True):
    rng = np.random.default_rng(seed)
    stages, trajectories = [], []
    for trajectory in range(num_trajectories):
        clock, cut_s, is_cut = 0, np.inf if cut_rate == 0 else rng.geometric(cut_rate), False
        for stage in (1, 2):
            state = int(rng.integers(0, 2))
            action = int(rng.random() < CHANCE_B[state])
            duration = int(rng.integers(1, 4)) + state
            is_cut = clock + duration > cut_s
            chance = CHANCE_B[state] if action else 1.0 - CHANCE_B[state]
            knows = knows_last_action or not is_cut
            stages.append(
                {
                    "trajectory": trajectory,
                    "stage": stage,
                    "elapsed_s": None if is_cut else float(clock + duration),
                    "action": ACTIONS[action] if knows else None,
                    "reward": None if is_cut else pays(state, action, duration) + rng.normal(),
                    "probability": chance if knows else None,
                    "x": float(state),
                }
            )
            clock = cut_s if is_cut else clock + duration
            if is_cut or leaves(state, action):
                break
        trajectories.append(
            {"trajectory": trajectory, "end_s": float(clock), "ending": "cut" if is_cut else "finished"}
        )
    frame = pd.DataFrame(stages).astype({"elapsed_s": float, "reward": float, "probability": float})
    frame = frame if has_probability else frame.drop(columns="probability")
    return Logs(frame, pd.DataFrame(trajectories))


def problem(logs, policy, targets=None, num_folds=3):
    """What an evaluation is given to solve, with the Q and the targets that are its defaults."""
    spec, widened = default_q(policy, logs)
    model = q_model_of(policy, widened, targets or default_targets(logs), spec)
    return problem_of(policy, widened, model, "logged", np.random.default_rng(0), num_folds)


def specified(censoring="kaplan-meier", actions=ACTIONS, covariates=("x",)):
    """What `evaluate` is given: the model of the cuts, and Q that is saturated unless it sees less."""
    return {"censoring": censoring, "q": QSpec(NamedActions(actions, covariates), reg=1e-6)}
