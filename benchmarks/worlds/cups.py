"""The ten shipped tables of half-hidden cups: no optimum is known, so a policy's value is what it earns on episodes."""

from functools import cached_property
from typing import Any

from halfseen.learning import CensoredQLearner
from halfseen.logs import Logs
from halfseen.scene.shipped import table_paths
from halfseen.study.pipeline import Source
from halfseen.study.policies import logging_policy
from halfseen.study.setting import look_at
from halfseen.world import TableWorld, WorldConfig
from halfseen.world.state import pad_scenes

NUM_EPISODES = 1000


class Cups:
    world = WorldConfig()

    @cached_property
    def scenes(self) -> Any:
        return look_at(table_paths())[0]

    @cached_property
    def layouts(self) -> Any:
        return pad_scenes(list(self.scenes))

    def log(self, num_trajectories: int, seed: int, share: float) -> Logs:
        return TableWorld(self.world).simulate(self.scenes, logging_policy(self.world), num_trajectories, seed, share)

    def learned(self, logs: Logs, **parameters: Any) -> Any:
        return CensoredQLearner.for_table(self.world.horizon, **parameters).fit(logs).policy_

    def value(self, policy: Any, seed: int) -> float:
        """Mean reward on episodes that all policies of a log share."""
        return Source(self.world, self.layouts, seed).evaluate(policy, NUM_EPISODES).means()["reward"]
