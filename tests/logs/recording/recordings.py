"""What the tests of the recorder record, and what must be read of it."""

import numpy as np

from halfseen.errors import LogError
from halfseen.logs import read_logs

THREE = {"objects": [{"object": k} for k in range(3)], "object": 0, "robot": 0}
"""A stage of the first robot, at the first of three objects."""


def begin(path, **given):
    path.begin_stage(**({"covariates": {"x": 1.0}, "action": "A"} | given))


def step(path, elapsed_s=None, reward=1.0, **given):
    begin(path, **given)
    path.complete_stage(reward, elapsed_s=elapsed_s)


def of_robot(path, robot, target=None):
    begin(path, **THREE | {"object": target, "robot": robot})


def covariates_of(path, stage):
    return {"x": path + stage / 10}


def reward_of(path, stage):
    return float(path * stage)


def record_path(recorder, name=None, num_stages=3, cause=None, given=None, **known):
    """A path of which each number says where it stands; finished, unless a cause cuts it."""
    path = recorder.begin_path(name, **known)
    for stage in range(1, num_stages + 1):
        seen = covariates_of(path.name, stage)
        step(path, float(stage), reward_of(path.name, stage), covariates=seen, **given or {})
    path.finish() if cause is None else path.cut(cause)


def as_recorded(logs):
    """Check each number; by path: stages that are completed, and whether it finished, the others having crashed."""
    completed = logs.stages[logs.stages["elapsed_s"].notna()]
    np.testing.assert_array_equal(logs.stages["x"], logs.stages["path"] + logs.stages["stage"] / 10)
    np.testing.assert_array_equal(completed["reward"], completed["path"] * completed["stage"])
    assert set(logs.paths["cause"][~logs.is_finished]) <= {"crash"}
    count = completed.groupby("path").size()
    ends = zip(logs.path_ids.tolist(), logs.is_finished.tolist(), strict=True)
    return {path: (int(count.get(path, 0)), is_finished) for path, is_finished in ends}


def finished(logs):
    """Names of the paths that finished, where each number was read as it was recorded."""
    return {path for path, (_, is_finished) in as_recorded(logs).items() if is_finished}


def logs_or_none(folder, *told):
    """Logs, or None where nothing is recorded yet."""
    try:
        return read_logs(folder)
    except LogError as error:
        assert any(words in str(error) for words in ("no stage is recorded yet", *told))  # noqa: PT017
        return None
