"""What the tests of the recorder record, and what must be read of it."""

import numpy as np

from halfseen.errors import LogError
from halfseen.logs import read_logs

THREE = {"objects": [{"object": k} for k in range(3)], "object": 0, "robot": 0}
"""A stage of the first robot, at the first of three objects."""


def begin(trajectory, **given):
    trajectory.begin_stage(**({"covariates": {"x": 1.0}, "action": "A"} | given))


def step(trajectory, elapsed_s=None, reward=1.0, **given):
    begin(trajectory, **given)
    trajectory.complete_stage(reward, elapsed_s=elapsed_s)


def of_robot(trajectory, robot, target=None):
    begin(trajectory, **THREE | {"object": target, "robot": robot})


def covariates_of(trajectory, stage):
    return {"x": trajectory + stage / 10}


def reward_of(trajectory, stage):
    return float(trajectory * stage)


def record_trajectory(recorder, name=None, num_stages=3, cause=None, given=None, **known):
    """A trajectory of which each number says where it stands; finished, unless a cause cuts it."""
    trajectory = recorder.begin_trajectory(name, **known)
    for stage in range(1, num_stages + 1):
        seen = covariates_of(trajectory.name, stage)
        step(trajectory, float(stage), reward_of(trajectory.name, stage), covariates=seen, **given or {})
    trajectory.finish() if cause is None else trajectory.cut(cause)


def as_recorded(logs):
    """Check each number; by trajectory: completed stages, and whether it finished, the others having crashed."""
    completed = logs.stages[logs.stages["elapsed_s"].notna()]
    np.testing.assert_array_equal(logs.stages["x"], logs.stages["trajectory"] + logs.stages["stage"] / 10)
    np.testing.assert_array_equal(completed["reward"], completed["trajectory"] * completed["stage"])
    assert set(logs.trajectories["cause"][~logs.is_finished]) <= {"crash"}
    count = completed.groupby("trajectory").size()
    ends = zip(logs.trajectory_ids.tolist(), logs.is_finished.tolist(), strict=True)
    return {trajectory: (int(count.get(trajectory, 0)), is_finished) for trajectory, is_finished in ends}


def finished(logs):
    """Names of the trajectories that finished, where each number was read as it was recorded."""
    return {trajectory for trajectory, (_, is_finished) in as_recorded(logs).items() if is_finished}


def logs_or_none(folder, *message):
    """Logs, or None where nothing is recorded yet."""
    try:
        return read_logs(folder)
    except LogError as error:
        assert any(words in str(error) for words in ("no stage is recorded yet", *message))  # noqa: PT017
        return None
