"""What a log has seen completed, by stage and block of coefficients: nothing is known of what it has not.

An action of a block without completed stages has no value, which is not the value 0. It is impossible for the maximum
in eq. 3 and for the policy. Only where a state allows nothing that was seen do all actions stay that it allows.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Int

from halfseen.learning.path_arrays import PathArrays
from halfseen.learning.transitions import StageMode


class Support(NamedTuple):
    """How often each block was begun and completed in each stage; support of parts of a log adds up."""

    num_begun: Int[np.ndarray, "T K"]
    num_completed: Int[np.ndarray, "T K"]
    is_allowed: Bool[np.ndarray, "T K"]
    """Blocks that some state of the stage allowed."""

    def plus(self, other: "Support") -> "Support":
        """Join what another part of the log has seen."""
        begun, completed = self.num_begun + other.num_begun, self.num_completed + other.num_completed
        return Support(begun, completed, self.is_allowed | other.is_allowed)

    def is_seen(self, stages: StageMode) -> Bool[np.ndarray, "T K"]:
        """Blocks that have a value: seen completed in the stage, or anywhere where stages are pooled."""
        seen = self.num_completed > 0
        return np.broadcast_to(seen.any(axis=0), seen.shape) if stages == "pooled" else seen


def support_of(paths: PathArrays, blocks: Int[np.ndarray, " A"], num_blocks: int) -> Support:
    """Count what a log has seen.

    Parameters
    ----------
    paths
        The log.
    blocks
        Block of each action.
    num_blocks
        K.
    """
    known = paths.is_begun & paths.has_action
    is_block = blocks[paths.action][..., None] == np.arange(num_blocks)
    of_block = blocks[:, None] == np.arange(num_blocks)
    return Support(
        num_begun=(is_block & known[..., None]).sum(axis=0),
        num_completed=(is_block & (known & paths.is_completed)[..., None]).sum(axis=0),
        is_allowed=(paths.is_possible & paths.is_begun[..., None]).any(axis=0) @ of_block,
    )


def unseen_in_words(support: Support, names: tuple[str, ...], stages: StageMode) -> list[str]:
    """Say of each block that was allowed and never seen completed where that was, and how often it was begun."""
    reached: Bool[np.ndarray, "T 1"] = np.any(support.num_completed > 0, axis=1, keepdims=True)
    lacking = support.is_allowed & ~support.is_seen(stages) & reached
    told = []
    for block in np.flatnonzero(lacking.any(axis=0)):
        rows = np.flatnonzero(lacking[:, block])
        begun = int(support.num_begun[rows, block].sum())
        where = "" if stages == "pooled" else f" in stage {', '.join(str(row + 1) for row in rows)}"
        cut = f"begun {begun} times and cut each time" if begun else "never taken"
        told.append(
            f"{names[block]} was never seen completed{where} ({cut}), so its value is not known and the policy never "
            "takes it there; to learn it, log it uniformly at random now and then"
        )
    return told
