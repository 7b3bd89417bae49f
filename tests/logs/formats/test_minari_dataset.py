import json
import resource

import gymnasium
import minari
import numpy as np
import pytest
from gymnasium import spaces

from foreign import LAST, NO, write_minari_episodes
from halfseen.errors import ArgumentError, HalfseenWarning, LogError
from halfseen.logs import Logs
from halfseen.logs.formats import read_minari, write_minari
from refusals import refused
from valid_logs import assert_same, small_tables

# Minari would like to know an author, a licence and more.
pytestmark = pytest.mark.filterwarnings("ignore::UserWarning:minari.utils")


@pytest.fixture(autouse=True)
def root(tmp_path, monkeypatch):
    """A folder of datasets of its own."""
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path / "datasets"))
    (tmp_path / "datasets").mkdir()
    return tmp_path / "datasets"


@pytest.fixture
def flat():
    """Trajectory 1 finishes in two stages, trajectory 2 is cut in its second, trajectory 3 in its first."""
    tables = small_tables()
    del tables["stages"]["object"]
    tables["stages"]["height_m"] = np.float32([0.1, 0.2, 0.3, 0.4, 0.5])
    return Logs(tables["stages"], tables["trajectories"])


# Written by halfseen.


def test_a_full_disk_is_reported_in_one_line_and_nothing_is_left(flat, root):
    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (3000, limits[1]))
    try:
        with refused(r"pick-v0: cannot be written \(File too large\)", ArgumentError):
            write_minari(flat, "pick-v0")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    assert list(root.iterdir()) == []


def test_steps_are_completed_stages_and_the_cut_stage_is_the_last_observation(flat):
    write_minari(flat, "cell/pick-v0")
    assert list(minari.list_local_datasets()) == ["cell/pick-v0"]
    dataset = minari.load_dataset("cell/pick-v0")
    assert (dataset.total_steps, len(dataset.sample_episodes(1))) == (3, 1)
    finished, cut = dataset
    names = json.loads(dataset.storage.metadata["halfseen"])["actions"]
    assert names == ["FINISH", "LIFT", "WASH"]
    assert finished.actions.tolist() == [1, 0]
    assert finished.rewards.tolist() == [-0.1, -5.0]
    assert (finished.terminations.tolist(), finished.truncations.tolist()) == ([False, True], [False, False])
    assert finished.infos["elapsed_s"].tolist() == [0.0, 1.5, 4.0]
    assert finished.observations[:, 0].tolist() == [10.0, 9.0, 9.0]
    assert (cut.actions.tolist(), cut.rewards.tolist()) == ([2], [5.0])
    assert (cut.terminations.tolist(), cut.truncations.tolist()) == ([False], [True])
    assert cut.observations.tolist() == [[10.0, np.float32(0.3)], [9.0, np.float32(0.4)]]


def test_a_log_without_numeric_covariates_shows_the_stage(root):
    tables = small_tables()
    logs = Logs(tables["stages"].drop(columns="steps_to_go"), tables["trajectories"], tables["objects"])
    write_minari(logs, "pick-v0")
    assert next(iter(minari.load_dataset("pick-v0"))).observations.tolist() == [[1.0], [2.0], [3.0]]
    for source in ("pick-v0", root / "pick-v0"):
        assert_same(logs, read_minari(source))


def test_what_halfseen_wrote_is_read_in_part_and_checked(flat):
    write_minari(flat, "pick-v0")
    with refused(r"'my pick': it is not a dataset name; use .namespace/.name-v0", ArgumentError):
        write_minari(flat, "my pick")
    with refused("leave clock, step_s and truncated out", ArgumentError):
        read_minari("pick-v0", step_s=2.0)
    # Some episodes alone, without those that have no step.
    dataset = minari.load_dataset("pick-v0")
    cut = dataset.filter_episodes(lambda episode: bool(episode.truncations[-1]))
    assert_same(flat.select([2]), read_minari(cut))
    noted = json.loads(dataset.storage.metadata["halfseen"])
    for broken in ({}, {**noted, "version": 9}, {**noted, "observations": ["x"]}, {**noted, "actions": ["FINISH"]}):
        dataset.storage.update_metadata({"halfseen": json.dumps(broken)})
        with refused(r"dataset pick-v0: (it is broken|trajectory)", LogError):
            read_minari("pick-v0")


# Written by others.


def cartpole(seeds, max_steps=12):
    env = minari.DataCollector(gymnasium.make("CartPole-v1", max_episode_steps=max_steps), record_infos=False)
    for seed in seeds:
        env.reset(seed=seed)
        env.action_space.seed(seed)
        is_over = False
        while not is_over:
            *_, terminated, truncated, _ = env.step(env.action_space.sample())
            is_over = terminated or truncated
    dataset = env.create_dataset("cartpole/test-v0", eval_env=None)
    env.close()
    return dataset


@pytest.mark.filterwarnings("ignore:Implicitly cleaning up:ResourceWarning")  # Minari's own temporary folders
def test_episodes_of_a_data_collector_are_read_with_steps_as_seconds():
    dataset = cartpole(range(6))
    with pytest.warns(HalfseenWarning, match="every step counts as 1 s; name it as clock"):
        logs = read_minari(dataset)
    episodes = list(dataset)
    assert logs.num_trajectories == 6
    assert logs.is_finished.tolist() == [bool(episode.terminations[-1]) for episode in episodes]
    assert 0 < logs.cut_share < 1
    assert set(logs.trajectories["cause"].dropna()) == {"truncated"}
    for trajectory, episode in enumerate(episodes):
        stages = logs.stages[logs.stages["trajectory"] == trajectory]
        num_steps = len(episode)
        assert stages["elapsed_s"].dropna().tolist() == list(range(1, num_steps + 1))
        assert stages["action"].dropna().tolist() == episode.actions.tolist()
        seen = stages[["obs_0", "obs_1", "obs_2", "obs_3"]].to_numpy()
        assert np.array_equal(seen, episode.observations[: len(stages)])
        assert len(stages) == num_steps + (0 if episode.terminations[-1] else 1)


@pytest.mark.parametrize(("truncated", "ending"), [("cut", "truncated"), ("finished", None)])
def test_each_ending_has_its_meaning(truncated, ending):
    dataset = write_minari_episodes("hand-v0", [(LAST, NO), (NO, LAST), (LAST, LAST), (NO, NO)])
    logs = read_minari(dataset, step_s=0.5, truncated=truncated)
    assert logs.trajectories["cause"].tolist() == [None, ending, None, "unknown"]
    assert logs.is_finished.tolist() == [True, ending is None, True, False]
    assert logs.end_s.tolist() == [1.5] * 4
    assert logs.stages.groupby("trajectory").size().tolist() == [3, 4 - (ending is None), 3, 4]


def test_parts_of_an_observation_become_columns():
    space = spaces.Dict({"pose": spaces.Box(-9, 9, (1, 2), np.float64), "mode": spaces.Discrete(3)})
    seen = {"pose": np.arange(8.0).reshape(4, 1, 2), "mode": np.array([0, 1, 2, 0])}
    logs = read_minari(
        write_minari_episodes("hand-v0", [(NO, LAST)], observation_space=space, observations=seen), step_s=1.0
    )
    assert sorted(logs.stage_covariates) == ["mode_0", "pose_0", "pose_1"]
    assert logs.stages["mode_0"].tolist() == [0, 1, 2, 0]


STANDS = {"t": np.array([1.0, 1.0, 4.0])}
TORQUE = {"action_space": spaces.Box(-1, 1, (1,), np.float64), "actions": np.zeros((3, 1))}
IN_WORDS = {"observation_space": spaces.Text(4), "observations": ["a", "b", "c", "d"]}


@pytest.mark.parametrize(
    ("endings", "other", "options", "message"),
    [
        ((LAST, NO), {}, {"clock": "time"}, r"dataset hand-v0, episode 0: there is no info 'time' among note, t"),
        ((LAST, NO), {}, {"clock": "note"}, "info 'note' is object"),
        ((LAST, NO), {}, {"step_s": -1.0}, r"step_s -1\.0"),
        ((LAST, NO), {"infos": STANDS}, {"clock": "t"}, r"trajectory 0, stage 2: elapsed_s 1\.0 is also the 1\.0"),
        ((LAST, NO), TORQUE, {"step_s": 1.0}, r"hand-v0: actions are Box.*discretise them"),
        ((LAST, NO), IN_WORDS, {"step_s": 1.0}, r"hand-v0: observations are Text.*flatten them"),
        ((LAST, NO), {"observations": np.zeros((3, 2))}, {"step_s": 1.0}, "3 observations for 3 steps"),
        (
            ([False, True, False], LAST),
            {},
            {"step_s": 1.0},
            "hand-v0, episode 0: step 2 of 3 ends it; make two",
        ),
    ],
)
def test_what_is_wrong_is_reported(endings, other, options, message):
    dataset = write_minari_episodes("hand-v0", [endings], **other)
    with refused(message):
        read_minari(dataset, **options)


def test_what_is_not_there_is_reported(root):
    (root / "broken-v0" / "data").mkdir(parents=True)
    with refused("dataset nowhere-v0: it cannot be loaded .*`minari list local`", ArgumentError):
        read_minari("nowhere-v0")
    with refused("broken-v0: it cannot be loaded", ArgumentError):
        read_minari("broken-v0")
