"""How long attempts were watched, against the episodes that a log was made from."""

import numpy as np
import pytest
from simulated_tables import recorded, scene

from fitted_laws import FITTED
from halfseen.logs import Logs
from halfseen.tables.laws.watched import watched
from halfseen.world import WorldConfig

GRIP = [0.5, -0.5, 0.0, 1.0, -1.0]


@pytest.mark.parametrize("cut_share", [0.0, 0.6])
def test_attempts_are_watched_until_they_held_or_were_cut_and_misses_until_the_limit(cut_share):
    cuts, logs = recorded(60, cut_share, table=scene(GRIP))
    tried, config = watched(logs, WorldConfig()), WorldConfig()
    expected = []
    for path, stage in np.argwhere(cuts.is_begun & (np.asarray(cuts.episodes.action) > 0)):
        target = (int(cuts.episodes.action[path, stage]) - 1) % 5
        begun_s = float(np.sum(np.asarray(cuts.episodes.duration_s, dtype=float)[path, :stage]))
        is_completed = cuts.is_completed[path, stage]
        lasted_s = float(cuts.episodes.duration_s[path, stage]) if is_completed else cuts.end_s[path] - begun_s
        if stage + 1 < config.horizon and lasted_s > 0.0:
            attempt_s = max(0.0, lasted_s - 1.0)
            expected.append((path, attempt_s, is_completed and attempt_s < 6.0 - 1e-4, GRIP[target]))
    path, attempt_s, is_held, grip = (np.array(column) for column in zip(*expected, strict=True))
    np.testing.assert_array_equal(tried.path, path)
    np.testing.assert_array_equal(tried.is_held, is_held)
    np.testing.assert_allclose(tried.watched_s, attempt_s, atol=1e-4)
    np.testing.assert_allclose(tried.grip, grip, atol=1e-6)
    assert (tried.watched_s[~tried.is_held] == 6.0).any()
    assert tried.is_held.any()


@pytest.mark.parametrize("cut_share", [0.0, 0.6])
def test_misses_are_watched_until_they_end_where_they_end_before_the_limit(cut_share):
    cuts, logs = recorded(60, cut_share, config=FITTED)
    tried = watched(logs, FITTED)
    assert not (tried.is_held & tried.is_missed).any()
    seen = tried.path[tried.is_missed], tried.watched_s[tried.is_missed]
    states, action = cuts.episodes.states, np.asarray(cuts.episodes.action)
    succeeded = np.asarray(states.attempt_succeeded)
    path, stage = np.nonzero(cuts.is_completed[:, :-1] & (action[:, :-1] > 0))
    # Whether the attempt of a stage held stands in the state after it, which a path keeps after its own end.
    is_miss = ~succeeded[path, stage + 1, stage]
    duration_s = np.asarray(cuts.episodes.duration_s, dtype=float)[path, stage] - FITTED.transport_s
    np.testing.assert_array_equal(seen[0], path[is_miss])
    np.testing.assert_allclose(seen[1], duration_s[is_miss], atol=1e-4)
    assert (seen[1] < 0.9 * FITTED.grasping.limit_s).any()


def test_a_miss_that_ends_next_to_the_limit_is_at_the_limit():
    _, logs = recorded(60)
    stages = logs.stages.assign(elapsed_s=logs.stages["elapsed_s"] * 0.995)
    rounded = watched(Logs(stages, logs.paths, logs.objects), WorldConfig())
    assert rounded.is_missed.any()
    assert (rounded.watched_s[rounded.is_missed] == 6.0).all()


def test_the_first_paths_tell_what_a_log_of_them_tells():
    _, logs = recorded(40, 0.5)
    some, alone = watched(logs, WorldConfig()).first(15), watched(logs.select(logs.path_ids[:15]), WorldConfig())
    for one, other in zip(some, alone, strict=True):
        np.testing.assert_array_equal(one, other)


def test_a_log_without_grips_has_grips_of_0():
    _, logs = recorded(5)
    assert "grip" not in logs.objects.columns
    assert not watched(logs, WorldConfig()).grip.any()
