"""The columns grip and seen of a log of tables, and logs without them."""

import numpy as np
import pytest

from fitted_laws import FITTED
from halfseen.errors import LogError
from halfseen.logs import Logs, read_logs
from halfseen.world import Scene, TableWorld, UniformPolicy
from halfseen.world.envs import CupsEnv
from halfseen.world.logs import states_of
from picked import leaves_of

SCENES = [
    Scene(np.array([[0.0, 0.6, 0.0], [0.1, 0.0, 0.0], [0.0, 0.4, 0.0]]), grip=np.array([-1.25, 0.5, 2.0])),
    Scene(np.zeros((2, 2)), grip=np.array([0.75, 0.0])),
]


@pytest.fixture(scope="module")
def cuts():
    return TableWorld(FITTED).record(SCENES, UniformPolicy(), episodes=60, seed=1)


@pytest.fixture(scope="module")
def logs():
    return TableWorld(FITTED).simulate(SCENES, UniformPolicy(), episodes=60, seed=1)


def replaced(logs, **columns):
    return Logs(logs.stages, logs.paths, logs.objects.assign(**columns))


def test_what_shows_and_what_was_seen_come_back(cuts, logs, tmp_path):
    logs.write(tmp_path / "logs")
    begun, truth = cuts.is_begun, cuts.episodes.states
    for told in (logs, read_logs(tmp_path / "logs")):
        states = states_of(told, 10)
        for name in ("grip", "seen"):
            expected = np.asarray(getattr(truth, name))[begun]
            assert np.array_equal(np.asarray(getattr(states, name))[begun], expected), name
            assert np.unique(expected).size > 3


def test_a_log_without_them_is_read_as_if_they_were_0(logs):
    plain = states_of(Logs(logs.stages, logs.paths, logs.objects.drop(columns=["grip", "seen"])), 10)
    zeros = states_of(replaced(logs, grip=0.0, seen=0.0), 10)
    assert not np.asarray(plain.grip).any()
    for left, right in zip(leaves_of(plain), leaves_of(zeros), strict=True):
        assert np.array_equal(left, right)


@pytest.mark.parametrize(
    ("column", "value", "message"),
    [
        ("grip", np.nan, "grip"),
        ("grip", np.inf, "grip"),
        ("seen", np.nan, "seen"),
        ("seen", 1.5, r"seen is outside \[0, 1\]; give a share"),
        ("seen", -0.1, "seen is outside"),
    ],
)
def test_what_they_cannot_be_is_refused_in_one_line(logs, column, value, message):
    values = logs.objects[column].to_numpy().copy()
    values[4] = value
    with pytest.raises(LogError, match=message) as refused:
        states_of(replaced(logs, **{column: values}), 10)
    assert "path 0" in str(refused.value)
    assert "\n" not in str(refused.value)


def test_gymnasium_shows_them():
    env = CupsEnv(SCENES, config=FITTED)
    observation, _ = env.reset(seed=0, options={"scene": 1})
    assert observation["grip"].tolist() == [0.75, 0.0, 0.0]
    assert observation["seen"][2] == 0.0
    assert (observation["seen"][:2] >= 0.6 - 1e-6).all()
    assert env.observation_space.contains(observation)
    assert env.observation_space["log_odds"].high.max() == np.inf
