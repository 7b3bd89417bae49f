"""How an episode ended, by the flags of each format in all combinations."""

from itertools import product

import numpy as np
import pytest

from foreign import CUT, FINISHED, arrays, episodes, last_of, rows_of, write_arrays, write_lerobot, write_rows
from halfseen.errors import HalfseenWarning
from halfseen.logs.formats import StepRules, read_lerobot, read_minari, read_step_arrays, read_steps
from refusals import refused

UNKNOWN, BROKE_OFF = ("cut", "unknown"), ("cut", "end-of-data")
FLAGS = list(product([False, True], repeat=2))
"""Of the last step: terminated (or what the format has), truncated. As in Gymnasium, what terminated has no future."""
BY_GYMNASIUM = dict(zip(FLAGS, [UNKNOWN, CUT, FINISHED, FINISHED], strict=True))
OF_LEROBOT = dict(zip(FLAGS, [UNKNOWN, CUT, FINISHED, CUT], strict=True))
"""LeRobot's `next.done` is terminated or truncated."""
TRUNCATED = pytest.mark.parametrize("truncated", ["cut", "finished"])


def endings_of(logs):
    return [
        (ending, cause)
        for ending, cause in logs.trajectories[["ending", "cause"]].astype(object).replace({np.nan: None}).to_numpy()
    ]


def wanted(table, truncated):
    """What each combination is, where what was truncated finished, or was cut."""
    return [FINISHED if table[flags] == CUT and truncated == "finished" else table[flags] for flags in FLAGS]


@TRUNCATED
@pytest.mark.parametrize(
    ("own", "table"),
    [("next.done", OF_LEROBOT), ("next.terminated", BY_GYMNASIUM), ("next.success", BY_GYMNASIUM)],
)
@pytest.mark.parametrize("is_named", [False, True])
def test_each_combination_of_lerobot_is_an_ending(tmp_path, own, table, truncated, is_named):
    found = episodes(lengths=(3, 1, 2, 4))
    flags = {own: [one for one, _ in FLAGS], "next.truncated": [two for _, two in FLAGS]}
    write_lerobot(tmp_path, found, extra={name: last_of(found, each) for name, each in flags.items()})
    logs = read_lerobot(tmp_path, StepRules(truncated=truncated, done=own if is_named else None))
    assert endings_of(logs) == wanted(table, truncated)
    # The frame in which an episode was cut has no outcome; a finished one is whole.
    assert logs.stages["reward"].isna().sum() == sum(ending == "cut" for ending, _ in endings_of(logs))


@TRUNCATED
def test_what_terminated_says_goes_before_done(tmp_path, truncated):
    found = episodes(lengths=(3, 1, 2, 4))
    terminated = [True, False, True, False]
    flags = {"next.done": [True] * 4, "next.terminated": terminated, "next.truncated": [False, True, True, False]}
    write_lerobot(tmp_path, found, extra={name: last_of(found, each) for name, each in flags.items()})
    ending = CUT if truncated == "cut" else FINISHED
    assert endings_of(read_lerobot(tmp_path, StepRules(truncated=truncated))) == [FINISHED, ending, FINISHED, UNKNOWN]


def test_done_alone_may_be_a_truncation_and_truncated_alone_no_end(tmp_path):
    found = episodes()
    write_lerobot(tmp_path / "done", found, extra={"next.done": last_of(found, [True] * 3)})
    with pytest.warns(HalfseenWarning, match=r"every episode ends with next\.done, which LeRobot sets where one was"):
        assert endings_of(read_lerobot(tmp_path / "done")) == [FINISHED] * 3
    write_lerobot(tmp_path / "cut", found, extra={"next.truncated": last_of(found, [True, False, True])})
    assert endings_of(read_lerobot(tmp_path / "cut")) == [CUT, UNKNOWN, CUT]


@pytest.mark.parametrize("flag", ["next.done", "next.terminated", "next.truncated"])
def test_an_episode_that_ends_before_its_last_frame_is_refused(tmp_path, flag):
    found = episodes()
    write_lerobot(tmp_path, found, extra={flag: [False] * 4 + [True] + [False] * 3})
    with refused(r"episode 2: step 1 of 4 ends it; make two episodes of it"):
        read_lerobot(tmp_path)


@TRUNCATED
def test_each_combination_of_rlds_is_an_ending(tmp_path, truncated):
    found = episodes(lengths=(3, 1, 2))
    last, terminal = [False, True, True], [False, False, True]
    file = write_rows(tmp_path / "steps", rows_of(found, terminal, last=last))
    logs = read_steps(file, StepRules(step_s=1.0, truncated=truncated))
    assert endings_of(logs) == [UNKNOWN, CUT if truncated == "cut" else FINISHED, FINISHED]
    file = write_rows(tmp_path / "wrong", rows_of(found, [True] * 3, last=last))
    with refused(r"episode 'e0': its last row terminates it and is not is_last"):
        read_steps(file, StepRules(step_s=1.0))


@TRUNCATED
@pytest.mark.parametrize("has_next", [False, True])
def test_each_combination_of_d4rl_is_an_ending(tmp_path, truncated, has_next):
    found = episodes(lengths=(3, 1, 2, 4))
    rows = arrays(found, terminated=[0, 2], timed_out=[1, 2], has_next=has_next)
    logs = read_step_arrays(write_arrays(tmp_path / "a.hdf5", rows), StepRules(step_s=1.0, truncated=truncated))
    assert endings_of(logs) == [FINISHED, CUT if truncated == "cut" else FINISHED, FINISHED, BROKE_OFF]


@TRUNCATED
@pytest.mark.filterwarnings("ignore::UserWarning:minari.utils")
def test_each_combination_of_minari_is_an_ending(tmp_path, monkeypatch, truncated):
    import minari
    from gymnasium import spaces
    from minari.data_collector import EpisodeBuffer

    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))
    buffers = [
        EpisodeBuffer(
            observations=np.zeros((3, 1)), actions=np.array([0, 1]), rewards=[0.0, 1.0],
            terminations=[False, terminated], truncations=[False, cut_off], infos={},
        )
        for terminated, cut_off in FLAGS
    ]  # fmt: skip
    seen = {"action_space": spaces.Discrete(2), "observation_space": spaces.Box(-1, 1, (1,), np.float64)}
    dataset = minari.create_dataset_from_buffers("flags-v0", buffers, **seen)
    assert endings_of(read_minari(dataset, step_s=1.0, truncated=truncated)) == wanted(BY_GYMNASIUM, truncated)
