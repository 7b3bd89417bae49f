"""CQL and BCQ of d3rlpy on a finite world: a state is one-hot, and a cut trajectory was truncated.

Adam on batches of 64, a target network that follows every 200 steps, two layers of 256; d3rlpy's own rate and steps are
made for millions of steps. `SETTINGS` did best on a random world (`icu_deep.py --tune --repetitions 1`).
"""

import logging
from typing import Any

import d3rlpy
import numpy as np
import structlog
import torch
from d3rlpy.algos import DiscreteBCQConfig, DiscreteCQLConfig
from d3rlpy.constants import ActionSpace
from d3rlpy.dataset import MDPDataset
from worlds.mdp import FiniteWorld, Steps

CONFIGS = {"CQL": DiscreteCQLConfig, "BCQ": DiscreteBCQConfig}
COMMON: dict[str, Any] = {"learning_rate": 1e-3, "batch_size": 64, "target_update_interval": 200}
SETTINGS: dict[str, dict[str, Any]] = {
    "CQL": {"num_steps": 2000, "alpha": 1.0},
    "BCQ": {"num_steps": 2000, "action_flexibility": 0.6},
}


def learned(kind: str, world: FiniteWorld, steps: Steps, num_steps: int, **changed: Any) -> np.ndarray:
    """π(a | s) of one of `CONFIGS`."""
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.WARNING))
    d3rlpy.seed(0)
    torch.set_num_threads(1)
    one_hot = np.eye(world.num_states, dtype=np.float32)
    learner = CONFIGS[kind](**(COMMON | changed)).create(device="cpu:0")
    learner.fit(
        episodes(world, steps, one_hot),
        n_steps=num_steps,
        n_steps_per_epoch=num_steps,
        show_progress=False,
        logger_adapter=d3rlpy.logging.NoopAdapterFactory(),
    )
    return np.eye(world.num_actions)[learner.predict(one_hot)]


def episodes(world: FiniteWorld, steps: Steps, one_hot: np.ndarray) -> MDPDataset:
    """Trajectories as d3rlpy has them; a cut stage is there as the successor of the one before."""
    is_last = np.append(np.diff(steps.trajectory) > 0, True)
    is_first = np.append(True, is_last[:-1])
    done = steps.successor >= 0
    used = ~(is_first & is_last & ~done)
    return MDPDataset(
        observations=one_hot[steps.state[used]],
        actions=steps.action[used],
        rewards=np.where(done, world.reward[steps.successor], 0.0)[used].astype(np.float32),
        terminals=(is_last & done)[used].astype(np.float32),
        timeouts=(is_last & ~done)[used].astype(np.float32),
        action_space=ActionSpace.DISCRETE,
        action_size=world.num_actions,
    )
