import numpy as np
import pytest

from halfseen.errors import LogError
from halfseen.logs import Logs, read_logs
from halfseen.tables.features import table_features
from halfseen.world import TableWorld, UniformPolicy, table_world
from halfseen.world.actions import possible_actions
from halfseen.world.cuts import cut, cut_rate
from halfseen.world.logs import states_of, to_logs
from picked import leaves_of, picked


@pytest.fixture(scope="module")
def recorded(played, scenes):
    sample = picked(played, np.s_[:90])
    cuts = cut(sample, cut_rate(sample, 0.4, "occlusion"), "occlusion", np.random.default_rng(0))
    return cuts, to_logs(cuts, "occlusion", scenes)


def test_the_log_says_what_happened(recorded):
    cuts, logs = recorded
    assert logs.num_paths == 90
    assert np.array_equal(logs.is_finished, cuts.is_finished)
    assert np.array_equal(logs.end_s, cuts.end_s)
    assert set(logs.paths["cause"].dropna()) == {"sensor-lost"}
    assert logs.paths["scene"].tolist()[:4] == ["random-1", "random-3", "random-5", "random-1"]
    assert logs.num_stages == cuts.is_begun.sum()
    expected = np.where(cuts.is_completed, np.asarray(cuts.episodes.elapsed_s), np.nan)[:, : logs.horizon]
    np.testing.assert_allclose(logs.elapsed_s(), expected, rtol=1e-5)
    reward = np.where(cuts.is_completed, np.asarray(cuts.episodes.reward), np.nan)[:, : logs.horizon]
    np.testing.assert_array_equal(logs.stage_values("reward"), reward)


def test_the_log_holds_nothing_hidden(recorded):
    _, logs = recorded
    assert logs.objects is not None
    assert set(logs.objects.columns) == {
        *("path", "stage", "object", "location", "occlusion", "log_odds"),
        *("successes", "failures", "lifts", "hidden_by", "attempt_occlusions", "attempt_succeeded"),
    }
    assert logs.stage_covariates == []
    assert logs.path_columns == ["scene"]


def test_the_states_come_back_from_the_log(recorded):
    cuts, logs = recorded
    states = states_of(logs, 10)
    begun = cuts.is_begun
    truth = cuts.episodes.states
    for name in ("hides", "is_object", "is_on_table", "lifts", "steps_to_go"):
        assert np.array_equal(np.asarray(getattr(states, name))[begun], np.asarray(getattr(truth, name))[begun]), name
    is_object = np.asarray(truth.is_object)[begun]
    log_odds = (np.asarray(leaf.log_odds)[begun][is_object] for leaf in (states, truth))
    assert np.array_equal(*log_odds)


def test_features_come_back_to_the_last_bit(recorded):
    cuts, logs = recorded
    states, truth = states_of(logs, 10), cuts.episodes.states
    is_possible, was_possible = possible_actions(states), possible_actions(truth)
    assert np.array_equal(is_possible[cuts.is_begun], was_possible[cuts.is_begun])
    seen = cuts.is_begun[..., None] & was_possible
    assert np.array_equal(table_features(states)[seen], table_features(truth)[seen])


def test_what_was_not_begun_is_an_empty_table(recorded):
    cuts, logs = recorded
    states = states_of(logs, 10)
    assert not states.is_object[~cuts.is_begun].any()
    assert not possible_actions(states)[~cuts.is_begun][:, 1:].any()


def test_a_log_survives_the_disk(recorded, tmp_path):
    _, logs = recorded
    logs.write(tmp_path / "logs")
    back = states_of(read_logs(tmp_path / "logs"), 10)
    for left, right in zip(leaves_of(back), leaves_of(states_of(logs, 10)), strict=True):
        assert np.array_equal(left, right)


def spoilt(logs, **columns):
    objects = logs.objects.copy()
    for name, values in columns.items():
        objects[name] = values(objects)
    return Logs(logs.stages, logs.paths, objects)


def first_replaced(name, value):
    def replaced(objects):
        values = objects[name].tolist()
        values[0] = value
        return values

    return replaced


@pytest.mark.parametrize(
    ("column", "value", "message"),
    [
        ("location", "SINK", "location is none of"),
        ("hidden_by", [0.0] * 9, "hidden_by does not give one share"),
        ("attempt_occlusions", [0.5], "attempt_occlusions and attempt_succeeded differ"),
    ],
)
def test_a_broken_object_is_named(recorded, column, value, message):
    _, logs = recorded
    with pytest.raises(LogError, match=f"path 0, stage 1, object 0: {message}"):
        states_of(spoilt(logs, **{column: first_replaced(column, value)}), 10)


def test_an_object_that_vanishes_is_named(recorded):
    _, logs = recorded
    objects = logs.objects
    stages = logs.stages
    path = int(stages.loc[(stages["stage"] == 2) & (stages["path"] % 3 == 2), "path"].iloc[0])
    acted = stages.loc[(stages["path"] == path) & (stages["stage"] == 2), "object"].iloc[0]
    gone = next(k for k in range(5) if k != acted)
    kept = ~((objects["path"] == path) & (objects["stage"] == 2) & (objects["object"] == gone))
    with pytest.raises(LogError, match=f"path {path}, stage 1, object {gone}: stage 2 lists it no more"):
        states_of(Logs(stages, logs.paths, objects[kept]), 10)


def test_a_log_without_objects_or_with_too_many_stages_is_refused(recorded):
    _, logs = recorded
    stages = logs.stages.drop(columns="object")
    with pytest.raises(LogError, match="the log has none"):
        states_of(Logs(stages, logs.paths), 10)
    with pytest.raises(LogError, match="there is no column 'lifts' among"):
        states_of(Logs(logs.stages, logs.paths, logs.objects.drop(columns="lifts")), 10)
    with pytest.raises(LogError, match="more than horizon=2"):
        states_of(logs, 2)


def test_the_door_gives_the_same_logs_for_the_same_seed(scenes, monkeypatch):
    monkeypatch.setattr(table_world, "NUM_PILOT_PATHS", 40)
    world = TableWorld()
    first, again = (
        world.simulate(scenes, UniformPolicy(), episodes=40, seed=3, cut_share=0.5, cut_kind="attempt")
        for _ in range(2)
    )
    other = world.simulate(scenes, UniformPolicy(), episodes=40, seed=4, cut_share=0.5, cut_kind="attempt")
    assert first.stages.equals(again.stages)
    assert first.paths.equals(again.paths)
    assert not first.paths.equals(other.paths)
    assert 0.2 < first.cut_share < 0.8
    assert set(first.paths["cause"].dropna()) == {"operator"}


@pytest.mark.parametrize(
    ("episodes", "share", "message"), [(0, 0.0, "simulate at least 1"), (5, 1.0, r"in \[0, 1\)"), (5, -0.5, "share")]
)
def test_the_door_refuses_nonsense(scenes, episodes, share, message):
    with pytest.raises(ValueError, match=message):
        TableWorld().simulate(scenes, UniformPolicy(), episodes=episodes, seed=0, cut_share=share)
