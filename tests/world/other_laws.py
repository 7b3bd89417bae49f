"""Laws unlike those that are assumed: a grasp that moves things, and errors that stay as long as the view does."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from halfseen.world import Attempt, Told, Verb


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Nudging:
    """Every attempt holds; LIFT puts the object down where it hides nothing and is hidden by nothing.

    Its trait counts the attempts on each object. What it does is known of no formula: it can only be drawn from.
    """

    limit_s: float = 4.0

    def draw_trait(self, num_objects, key):
        return {"count": jnp.zeros(num_objects, dtype=jnp.int32)}

    def attempt(self, table, trait, verb, target, key):
        is_moved = (jnp.arange(len(table.hides)) == target) & (verb == Verb.LIFT)
        hides = jnp.where(is_moved[:, None] | is_moved[None, :], 0.0, table.hides)
        count = trait["count"].at[target].add(1)
        return Attempt(jnp.asarray(True), 1.0 + table.occlusion[target], hides, {"count": count})


@jax.tree_util.register_dataclass
@dataclass(frozen=True)
class Persisting:
    """A label is right with probability 0.5 + 0.4·(1 − occ), but the same view gives the same label again.

    Its trait holds, for each object, the view that was counted last (its occlusion; −1 before the first).
    """

    gain: float = 0.4

    def draw_trait(self, num_objects, key):
        return jnp.full(num_objects, -1.0)

    def look(self, glimpse, log_odds, is_dirty, trait, key):
        accuracy = 0.5 + self.gain * (1.0 - glimpse.occluded)
        is_right = jax.random.uniform(key, accuracy.shape) < accuracy
        evidence = jnp.log(accuracy) - jnp.log1p(-accuracy)
        is_news = glimpse.is_seen & (glimpse.occluded != trait)
        update = jnp.where(is_news, jnp.where(is_dirty == is_right, evidence, -evidence), 0.0)
        return Told(log_odds + update, glimpse.seen, jnp.where(is_news, glimpse.occluded, trait))
