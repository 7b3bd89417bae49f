"""What is learned from logs of growing size, against heuristics and planners: Figure 1 and Tables 1 and 2."""

from halfseen.study.experiments.reward.experiment import Reward

__all__ = ["Reward"]
