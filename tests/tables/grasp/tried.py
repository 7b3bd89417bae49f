"""Attempts made up for the tests."""

import numpy as np
import pandas as pd


def beta_attempts(num_objects=400, num_tries=4, intercept=1.5, slope=-2.5, strength=3.0, seed=0, occlusion=None):
    """Objects whose own chance is drawn from the Beta prior; each is tried again and again at its own occlusion."""
    rng = np.random.default_rng(seed)
    occluded = rng.random(num_objects) if occlusion is None else np.full(num_objects, occlusion)
    mean = 1.0 / (1.0 + np.exp(-(intercept + slope * occluded)))
    chance = rng.beta(strength * mean, strength * (1.0 - mean))
    succeeded = rng.random((num_objects, num_tries)) < chance[:, None]
    before = np.cumsum(succeeded, axis=1) - succeeded
    return pd.DataFrame(
        {
            "object": np.repeat(np.arange(num_objects), num_tries),
            "occlusion": np.repeat(occluded, num_tries),
            "successes": before.ravel(),
            "failures": (np.arange(num_tries) - before).ravel(),
            "succeeded": succeeded.ravel(),
        }
    )


def cut_some(frame, seed=0, mean_s=10.0):
    """Give attempts a duration, failures the longest one, and cut some; their outcome is unknown then."""
    rng = np.random.default_rng(seed)
    duration = np.where(frame["succeeded"], rng.uniform(1.0, 7.0, len(frame)), 7.0)
    cut_s = rng.exponential(mean_s, len(frame))
    is_finished = duration <= cut_s
    outcome = frame["succeeded"].astype("boolean").mask(~is_finished)
    return frame.assign(time_s=np.minimum(duration, cut_s), is_finished=is_finished, succeeded=outcome)
