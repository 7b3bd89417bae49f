"""Where learning is worth it: the map over clutter and worlds, Figure 6."""

from halfseen.study.experiments.clutter.experiment import Clutter

__all__ = ["Clutter"]
