"""What simulations and a longer planning horizon are worth to a planner: Figures 2 and 3."""

from halfseen.study.experiments.planning.experiment import Planning

__all__ = ["Planning"]
