"""The configuration of the experiment, and the models."""

from dataclasses import dataclass

from halfseen.figures import BLUE, INK, ORANGE, RED, SKY

SUCCESSION, ORACLE, CLAIMED, RIVAL = "succession", "oracle", "svm", "beta"
MODEL_NAMES = {
    SUCCESSION: "rule of succession",
    RIVAL: "Beta mean",
    "beta-dropped": "Beta mean, cut attempts dropped",
    CLAIMED: "SVM",
    ORACLE: "true model",
}
"""Model of the probability of a grasp → name for people."""
MODEL_COLOURS = {SUCCESSION: ORANGE, RIVAL: BLUE, "beta-dropped": SKY, CLAIMED: RED, ORACLE: INK}
MEASURES = {
    "log_loss": "log-loss on held-out attempts",
    "brier": "Brier score on held-out attempts",
    "learned_reward": "reward of the policy by linear eq. 3",
    "heuristic_reward": "reward of the heuristic",
}
"""What models are judged by; the scores are better the smaller they are, the rewards the larger."""
REWARDS = ("learned_reward", "heuristic_reward")
NUM_BINS = 10
"""Of predicted probabilities, evenly over [0, 1]."""


@dataclass(frozen=True)
class GraspDesign:
    """Models of the probability of a grasp, learned from logs of `num_trajectories`, of which `cut_share` are cut.

    All are scored on fresh trajectories, some six attempts each: on as many as were learned from, `most_held_out` at
    most. What V° is worth as tables are set is the mean over `num_starts`.
    """

    num_trajectories: tuple[int, ...] = (50, 200, 800)
    cut_share: float = 1 / 2
    most_held_out: int = 400
    episodes_per_scene: int = 5
    num_starts: int = 100_000
    most_repetitions: int | None = 12
