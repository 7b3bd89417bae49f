from dataclasses import dataclass

import numpy as np

from halfseen.learning.rows import Transitions


@dataclass(frozen=True)
class Blocks:
    """Blocks of actions, for logs that are arrays already."""

    blocks: tuple[int, ...]
    end_action: int | None = None

    @property
    def num_blocks(self):
        return max(self.blocks) + 1


def random_log(seed, num_trajectories=40, horizon=3, blocks=(0, 1, 1, 2), num_features=3, ends_with=None, is_cut=True):
    """Trajectories of random lengths, of which some are cut; `ends_with` is an action that ends a trajectory."""
    rng = np.random.default_rng(seed)
    shape = (num_trajectories, horizon)
    num_actions = len(blocks)
    features = rng.normal(size=(*shape, num_actions, num_features))
    action = rng.integers(0, num_actions, size=shape)
    is_possible = rng.random((*shape, num_actions)) < 0.7
    np.put_along_axis(is_possible, action[..., None], True, axis=2)
    length = rng.integers(1, horizon + 1, size=num_trajectories)
    if ends_with is not None:
        is_possible[..., ends_with] = True
        early = np.where((action == ends_with).any(axis=1), np.argmax(action == ends_with, axis=1) + 1, horizon)
        length = np.minimum(length, early)
        # A trajectory ends by that action or at the horizon, and by nothing else.
        length = np.where(action[np.arange(num_trajectories), length - 1] == ends_with, length, early)
    num_completed = np.where(is_cut & (rng.random(num_trajectories) < 0.4), rng.integers(0, length), length)
    stage = np.arange(horizon)
    is_completed = stage < num_completed[:, None]
    is_begun = stage <= np.minimum(num_completed, length - 1)[:, None]
    taken = np.take_along_axis(features, action[..., None, None], axis=2)[:, :, 0]
    # Clear in some blocks and lost in noise in others, so that cross-validation has something to choose.
    signal = taken @ rng.normal(size=num_features) * np.array([0.0, 2.0, 0.3])[np.array(blocks)][action]
    reward = signal + rng.normal(size=shape)
    return Transitions(
        features=np.where(is_begun[..., None, None], features, 0.0),
        is_possible=is_possible,
        action=action,
        reward=np.where(is_completed, reward, 0.0),
        weight=np.where(is_completed, rng.uniform(1.0, 3.0, size=shape) if is_cut else 1.0, 0.0),
        is_last=is_completed & (stage == length[:, None] - 1),
        fold=rng.permutation(num_trajectories) % 4,
    )
