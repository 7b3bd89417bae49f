"""Rewards that no square can hold are refused, in either direction; others only scale what is learned."""

import numpy as np
import pytest

from halfseen.errors import LogError
from halfseen.learning import CensoredQLearner
from halfseen.logs import LogRecorder, Logs

RNG = np.random.default_rng(0)
N = 40
REWARD = RNG.normal(size=N)


def log_of(scale):
    each = np.arange(N)
    stages = {"trajectory": each, "stage": np.ones(N, int), "elapsed_s": np.ones(N), "reward": scale * REWARD}
    stages |= {"action": np.where(each % 2, "a", "b"), "x": np.linspace(0.0, 1.0, N)}
    return Logs(stages=stages, trajectories={"trajectory": each, "end_s": np.ones(N), "ending": ["finished"] * N})


@pytest.mark.parametrize("scale", [1e155, 1e76])
def test_no_reward_too_large_to_be_squared(tmp_path, scale):
    with pytest.raises(LogError, match=r"trajectory .*: reward .* give rewards in another unit"):
        log_of(scale)
    with LogRecorder(tmp_path / "logs") as recorder:
        trajectory = recorder.begin_trajectory()
        trajectory.begin_stage({"x": 0.5}, action="a")
        with pytest.raises(LogError, match=r"stage 1: reward is 1e\+\d+; give rewards in another unit"):
            trajectory.complete_stage(scale)
        trajectory.complete_stage(1.0)


@pytest.mark.parametrize("scale", [1e-76, 1e-200])
def test_nothing_is_learned_from_rewards_too_small_to_be_squared(scale):
    with pytest.raises(LogError, match=r"largest reward is .*e-\d+, .* give rewards in another unit"):
        CensoredQLearner(1, ["a", "b"], ["x"]).fit(log_of(scale))


@pytest.mark.parametrize("scale", [1e70, 1e-70])
def test_other_sizes_only_scale_q(scale):
    q = [CensoredQLearner(1, ["a", "b"], ["x"]).fit(log_of(s)).policy_ for s in (1.0, scale)]
    frames = log_of(1.0).stages[["x"]]
    one, other = (policy.scores(frames, 1) for policy in q)
    np.testing.assert_allclose(other, scale * one, rtol=1e-6)
