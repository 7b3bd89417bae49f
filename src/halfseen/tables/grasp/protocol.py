"""What every model of grasps can do that learns from attempts."""

from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from halfseen.logs.frames import FrameLike


@runtime_checkable
class GraspEstimator(Protocol):
    """What `BetaGrasp` and `SVMGrasp` are: fitted to attempts, it tells their probabilities."""

    def fit(self, frame: FrameLike) -> "GraspEstimator":
        """Learn from attempts."""
        ...

    def predict_proba(self, frame: FrameLike) -> Float[np.ndarray, "m 2"]:
        """Probability that an attempt fails, and that it succeeds."""
        ...
