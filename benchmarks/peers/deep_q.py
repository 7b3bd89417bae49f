"""Offline learners of d3rlpy, on completed stages: a cut trajectory is one that was truncated where its stage was cut.

The state is the standardised covariates and the stage, one-hot; impossible actions are masked when a policy decides.
Adam at 3e-4 on batches of 64, a target network that follows every 200 steps, no discount; d3rlpy's own 8,000 steps
between targets and rate of 6e-5 are made for millions of steps. Logs are small, and networks learn them by heart: of
100 to 10,000 steps, rates of 1e-4 to 1e-3, batches of 64 and 256 and CQL's α of 0.3 to 16, these numbers of steps (and
α of 1) did best on logs of the cell and the trial of seeds below 1000.
"""

import logging
from typing import Any

import d3rlpy
import numpy as np
import pandas as pd
import structlog
import torch
from d3rlpy.algos import DiscreteCQLConfig, DoubleDQNConfig
from d3rlpy.constants import ActionSpace
from d3rlpy.dataset import MDPDataset
from peers.completed import Begun, begun, possible_of
from worlds.world import Chances, World

from halfseen.logs import Logs

NUM_STEPS = {"CQL": 300, "double DQN": 1500}
CONFIGS = {"CQL": DiscreteCQLConfig, "double DQN": DoubleDQNConfig}
SETTINGS: dict[str, Any] = {"learning_rate": 3e-4, "batch_size": 64, "gamma": 1.0, "target_update_interval": 200}


def trained(kind: str, world: World, logs: Logs, num_steps: int | None = None, **changed: Any) -> Chances:
    """Train one of `CONFIGS`."""
    structlog.configure(wrapper_class=structlog.make_filtering_bound_logger(logging.WARNING))
    d3rlpy.seed(0)
    torch.set_num_threads(1)
    num_steps = num_steps or NUM_STEPS[kind]
    rows = begun(logs, world)
    mean, scale = rows.state.mean(axis=0), rows.state.std(axis=0) + 1e-9

    def observed(state: np.ndarray, stage: np.ndarray) -> np.ndarray:
        one_hot = np.eye(len(world.actions_by_stage))[stage - 1]
        return np.column_stack([(state - mean) / scale, one_hot]).astype(np.float32)

    learner = CONFIGS[kind](**(SETTINGS | changed)).create(device="cpu:0")
    learner.fit(
        _dataset(rows, observed(rows.state, rows.stage), len(world.actions)),
        n_steps=num_steps,
        n_steps_per_epoch=num_steps,
        show_progress=False,
        logger_adapter=d3rlpy.logging.NoopAdapterFactory(),
    )

    def chances(frame: pd.DataFrame, stage: int) -> np.ndarray:
        stages = np.full(len(frame), stage)
        state = observed(frame[list(world.covariates)].to_numpy(dtype=np.float64), stages)
        each = [learner.predict_value(state, np.full(len(frame), a)) for a in range(len(world.actions))]
        q = np.where(possible_of(stages, world), np.stack(each, axis=1), -np.inf)
        return np.eye(len(world.actions))[q.argmax(axis=1)]

    return chances


def _dataset(rows: Begun, observations: np.ndarray, num_actions: int) -> MDPDataset:
    """Episodes; the stage in which a trajectory was cut is there as the successor of the one before."""
    last = rows.is_last
    is_first = np.append(True, last[:-1])
    is_used = ~(is_first & last & ~rows.is_completed)
    ends = last & rows.is_completed
    return MDPDataset(
        observations=observations[is_used],
        actions=rows.action[is_used],
        rewards=np.nan_to_num(rows.reward[is_used]).astype(np.float32),
        terminals=ends[is_used].astype(np.float32),
        timeouts=(last & ~ends)[is_used].astype(np.float32),
        action_space=ActionSpace.DISCRETE,
        action_size=num_actions,
    )
