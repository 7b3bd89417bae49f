"""What a model of the probability of a grasp is worth (paper, §3: a Beta mean or an SVM): Figure 5, Table 3."""

from halfseen.study.experiments.grasp.experiment import Grasp

__all__ = ["Grasp"]
