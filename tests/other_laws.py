"""Laws unlike those that are assumed: a grasp that moves things, and errors that stay as long as the view does."""

import numpy as np

from halfseen.arrays import at, record
from halfseen.world import Attempt, LookOutcome, Verb, random
from halfseen.world.state import numbered


@record
class Nudging:
    """Every attempt holds; LIFT puts the object down where it hides nothing and is hidden by nothing.

    Its latent counts the attempts on each object. What it does is known of no formula: it can only be drawn from.
    """

    limit_s: float = 4.0

    def draw_latent(self, num_objects, key):
        return {"count": np.zeros((*key.shape[:-1], num_objects), dtype=np.int32)}

    def attempt(self, table, latent, verb, target, key):
        is_target = numbered(target, table.is_on_table.shape[-1])
        is_moved = is_target & (verb == Verb.LIFT)[..., None]
        hides = np.where(is_moved[..., :, None] | is_moved[..., None, :], np.float32(0.0), table.hides)
        seconds = 1.0 + at(table.occlusion, target)
        return Attempt(np.ones(verb.shape, dtype=bool), seconds, hides, {"count": latent["count"] + is_target})


@record
class Persisting:
    """A label is right with probability 0.5 + 0.4·(1 − occ), but the same view gives the same label again.

    Its latent holds, for each object, the view that was counted last (its occlusion; −1 before the first).
    """

    gain: float = 0.4

    def draw_latent(self, num_objects, key):
        return np.full((*key.shape[:-1], num_objects), -1.0, dtype=np.float32)

    def look(self, glimpse, log_odds, is_dirty, latent, key):
        accuracy = 0.5 + self.gain * (1.0 - glimpse.occluded)
        is_right = random.uniform(key, accuracy.shape[-1]) < accuracy
        evidence = np.log(accuracy) - np.log1p(-accuracy)
        is_news = glimpse.is_seen & (glimpse.occluded != latent)
        update = np.where(is_news, np.where(is_dirty == is_right, evidence, -evidence), 0.0)
        return LookOutcome(log_odds + update, glimpse.seen, np.where(is_news, glimpse.occluded, latent))
