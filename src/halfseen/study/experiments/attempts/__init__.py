"""What physical attempts say of models of a grasp and of occlusion: Figure 8, Table 4."""

from halfseen.study.experiments.attempts.experiment import Attempts

__all__ = ["Attempts"]
