"""What attempts, looks and washing say, against the episodes of a log; and a whole world that is fitted to it."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from simulated_tables import CALIBRATED, recorded, scene

from fitted_laws import FITTED
from halfseen.errors import LogError
from halfseen.logs import Logs
from halfseen.planners import POMDPPolicy
from halfseen.tables import fit_world
from halfseen.tables.evidence import evidence_of
from halfseen.tables.law_grasping import choose_grasping
from halfseen.tables.laws import fitted_to
from halfseen.tables.recorder import seeing_of
from halfseen.world import (
    AssumedGrasping,
    AssumedSeeing,
    FittedGrasping,
    KnownGrasping,
    KnownSeeing,
    PersistentSeeing,
    Scene,
    TableWorld,
    UniformPolicy,
    WorldConfig,
    random,
)
from halfseen.world.rollout import evaluate
from halfseen.world.state import pad_scenes

GRIP = [0.5, -0.5, 0.0, 1.0, -1.0]


@pytest.mark.parametrize("cut_share", [0.0, 0.6])
def test_attempts_are_watched_until_they_held_or_were_cut_and_misses_until_the_limit(cut_share):
    cuts, logs = recorded(60, cut_share, table=scene(GRIP))
    tried, config = evidence_of(logs, WorldConfig()).tried, WorldConfig()
    expected = []
    for trajectory, stage in np.argwhere(cuts.is_begun & (np.asarray(cuts.episodes.action) > 0)):
        target = (int(cuts.episodes.action[trajectory, stage]) - 1) % 5
        begun_s = float(np.sum(np.asarray(cuts.episodes.duration_s, dtype=float)[trajectory, :stage]))
        is_completed = cuts.is_completed[trajectory, stage]
        lasted_s = (
            float(cuts.episodes.duration_s[trajectory, stage]) if is_completed else cuts.end_s[trajectory] - begun_s
        )
        if stage + 1 < config.horizon and lasted_s > 0.0:
            attempt_s = max(0.0, lasted_s - 1.0)
            expected.append((trajectory, attempt_s, is_completed and attempt_s < 6.0 - 1e-4, GRIP[target]))
    trajectory, attempt_s, is_held, grip = (np.array(column) for column in zip(*expected, strict=True))
    np.testing.assert_array_equal(tried.trajectory, trajectory)
    np.testing.assert_array_equal(tried.is_held, is_held)
    np.testing.assert_allclose(tried.watched_s, attempt_s, atol=1e-4)
    np.testing.assert_allclose(tried.grip, grip, atol=1e-6)
    assert (tried.watched_s[~tried.is_held] == 6.0).any()
    assert tried.is_held.any()


@pytest.mark.parametrize("cut_share", [0.0, 0.6])
def test_misses_are_watched_until_they_end_where_they_end_before_the_limit(cut_share):
    cuts, logs = recorded(60, cut_share, config=FITTED)
    tried = evidence_of(logs, FITTED).tried
    assert not (tried.is_held & tried.is_missed).any()
    seen = tried.trajectory[tried.is_missed], tried.watched_s[tried.is_missed]
    states, action = cuts.episodes.states, np.asarray(cuts.episodes.action)
    succeeded = np.asarray(states.attempt_succeeded)
    trajectory, stage = np.nonzero(cuts.is_completed[:, :-1] & (action[:, :-1] > 0))
    # Whether the attempt of a stage held stands in the state after it, which a trajectory keeps after its own end.
    is_miss = ~succeeded[trajectory, stage + 1, stage]
    duration_s = np.asarray(cuts.episodes.duration_s, dtype=float)[trajectory, stage] - FITTED.transport_s
    np.testing.assert_array_equal(seen[0], trajectory[is_miss])
    np.testing.assert_allclose(seen[1], duration_s[is_miss], atol=1e-4)
    assert (seen[1] < 0.9 * FITTED.grasping.limit_s).any()


def test_a_miss_that_ends_next_to_the_limit_is_at_the_limit():
    _, logs = recorded(60)
    stages = logs.stages.assign(elapsed_s=logs.stages["elapsed_s"] * 0.995)
    rounded = evidence_of(Logs(stages, logs.trajectories, logs.objects), WorldConfig()).tried
    assert rounded.is_missed.any()
    assert (rounded.watched_s[rounded.is_missed] == 6.0).all()


def test_the_first_trajectories_tell_what_a_log_of_them_tells():
    _, logs = recorded(40, 0.5)
    some = evidence_of(logs, WorldConfig()).first(15)
    alone = evidence_of(logs.select(logs.trajectory_ids[:15]), WorldConfig())
    for one, other in zip((*some.tried, *some.labels), (*alone.tried, *alone.labels), strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("cut_share", [0.0, 0.6])
def test_labels_move_the_log_odds_as_the_law_says_at_the_occlusion_of_the_look(cut_share):
    cuts, logs = recorded(60, cut_share)
    labels, config = evidence_of(logs, WorldConfig()).labels, WorldConfig()
    states = cuts.episodes.states
    is_on_table, log_odds = np.asarray(states.is_on_table), np.asarray(states.log_odds, dtype=float)
    moved = np.diff(log_odds, axis=1, prepend=np.log(1.5))
    trajectory, stage, target = np.nonzero(is_on_table & cuts.is_begun[:, :, None] & (np.abs(moved) > 1e-4))
    np.testing.assert_array_equal(labels.trajectory, trajectory)
    np.testing.assert_array_equal(labels.object, 5 * trajectory + target)
    accuracy = config.seeing.accuracy(labels.occlusion)
    expected = np.where(labels.says_dirty, 1.0, -1.0) * (np.log(accuracy) - np.log1p(-accuracy))
    np.testing.assert_allclose(moved[trajectory, stage, target], expected, atol=1e-4)
    assert (labels.occlusion == 0.0).any()
    # To this recorder each look is news, so that no views are counted; and no grip shows.
    assert not labels.is_persistent
    assert not labels.seen.any()
    assert not evidence_of(logs, WorldConfig()).tried.grip.any()


def test_washing_shows_what_an_object_was():
    cuts, logs = recorded(200, 0.3)
    labels = evidence_of(logs, WorldConfig()).labels
    is_dirty = np.asarray(cuts.episodes.hidden.is_dirty)[labels.trajectory, labels.object % 5]
    assert labels.was_dirty.any()
    assert labels.was_clean.any()
    assert not (labels.was_dirty & labels.was_clean).any()
    assert is_dirty[labels.was_dirty].all()
    assert not is_dirty[labels.was_clean].any()
    washed = np.unique(labels.object[labels.was_dirty | labels.was_clean])
    assert len(washed) == num_washed(cuts)


def num_washed(cuts):
    """Objects that a completed WASH before the last step of the horizon put into the dishwasher."""
    is_on_table = np.asarray(cuts.episodes.states.is_on_table)
    # The state after the trajectory's own end is a copy of its last one, so a table that was cleared shows it there.
    last = np.where(cuts.is_completed[:, :-1, None], is_on_table[:, :-1] & ~is_on_table[:, 1:], False)
    return int(last.sum())


@pytest.mark.parametrize("cut_share", [0.0, 0.6])
def test_labels_of_a_recorder_who_counts_views_say_what_the_law_says_of_them(cut_share):
    cuts, logs = recorded(60, cut_share, config=FITTED)
    labels, law = evidence_of(logs, FITTED).labels, FITTED.seeing
    assert labels.is_persistent
    # A look that shows nothing new is no label.
    num_looks = int((np.asarray(cuts.episodes.states.is_on_table) & cuts.is_begun[:, :, None]).sum())
    assert 0 < len(labels.trajectory) < 0.7 * num_looks
    np.testing.assert_allclose(
        labels.seen_after, law.after(labels.occlusion, labels.seen, labels.says_dirty, labels.is_held), atol=1e-6
    )
    assert labels.is_held.any()
    assert not labels.occlusion[labels.is_held].any()
    # What washing showed to be clean had its false alarms, and no more.
    if_dirty, if_clean = law.positive(labels.occlusion, labels.seen, labels.is_held)
    assert (if_dirty > 0.0).all()
    expected = np.where(
        np.asarray(cuts.episodes.hidden.is_dirty)[labels.trajectory, labels.object % 5], if_dirty, if_clean
    )
    excess = labels.says_dirty - expected
    assert abs(excess.sum()) < 3.0 * np.sqrt((expected * (1.0 - expected)).sum())


def test_a_look_that_finds_nothing_counts_though_the_recorder_learns_nothing_from_it():
    seeing = replace(FITTED.seeing, sensitivity=(0.0, 0.55, 0.6, 0.95), false_alarms=(0.0, 0.06, 0.1, 0.2))
    flat = replace(FITTED, seeing=seeing)
    _, logs = recorded(60, config=flat)
    labels = evidence_of(logs, flat).labels
    is_flat = labels.seen_after <= seeing.views[0]
    assert is_flat.any()
    assert not labels.says_dirty[is_flat].any()


@pytest.mark.parametrize("cut_share", [0.0, 0.5])
@pytest.mark.parametrize(
    ("config", "families"),
    [
        (WorldConfig(), (AssumedGrasping, AssumedSeeing)),
        (CALIBRATED, (FittedGrasping, PersistentSeeing)),
        (FITTED, (FittedGrasping, PersistentSeeing)),
    ],
)
def test_a_log_speaks_for_the_laws_that_made_it(config, families, cut_share):
    _, logs = recorded(100, cut_share, config=config)
    for begin in (0, 50):
        labels = evidence_of(logs.select(logs.trajectory_ids[begin : begin + 50]), config)
        assert isinstance(choose_grasping(labels.tried, config.grasping.limit_s), families[0])
        assert isinstance(seeing_of(labels.labels, labels.dirty_share).law, families[1])


HIDES = np.array([[0.0, 0.0, 0.0], [0.6, 0.0, 0.0], [0.0, 0.4, 0.0]])


@cache
def logs_of(config, episodes=60, cut_share=0.4):
    return TableWorld(config).simulate(Scene(HIDES), UniformPolicy(), episodes, seed=0, cut_share=cut_share)


@pytest.mark.parametrize("config", [WorldConfig(), FITTED])
def test_what_is_known_stays_and_the_laws_are_of_the_families_that_made_the_log(config):
    known = replace(config, reward_wash_dirty=4.0, transport_s=1.0, horizon=10)
    fitted = fit_world(logs_of(known, 30), known)
    assert fitted == fit_world(logs_of(known, 30), known), "the same log gives the same bits"
    as_known = replace(fitted, grasping=known.grasping, seeing=known.seeing)
    assert as_known == known
    assert fitted.grasping.limit_s == known.grasping.limit_s
    assert type(fitted.grasping) is type(known.grasping)
    assert type(fitted.seeing) is type(known.seeing)
    assert isinstance(fitted.grasping, KnownGrasping)
    assert isinstance(fitted.seeing, KnownSeeing)


@pytest.mark.slow
def test_planners_plan_with_laws_of_the_other_families():
    short = replace(FITTED, horizon=2)
    planner = POMDPPolicy(fit_world(logs_of(short), short), num_simulations=8)
    played = evaluate(short, pad_scenes([Scene(HIDES)]), planner, random.key_of(0), 4)
    assert np.isfinite(played.reward).all()


@pytest.mark.slow
def test_the_laws_are_those_of_the_world_where_it_takes_other_families():
    fitted = fit_world(logs_of(FITTED, episodes=1000), FITTED)
    for occlusion in (0.0, 0.5):
        np.testing.assert_allclose(
            np.exp(fitted.grasping.log_failure(occlusion, 0.0)),
            np.exp(FITTED.grasping.log_failure(occlusion, 0.0)),
            atol=0.04,
        )
        found, true = (law.seeing.positive(occlusion, 0.0) for law in (fitted, FITTED))
        np.testing.assert_allclose(found, true, atol=0.06)


@pytest.mark.slow
@pytest.mark.parametrize("config", [WorldConfig(), FITTED])
def test_the_true_laws_are_not_looked_at(config):
    logs, limit_s = logs_of(config, 30), config.grasping.limit_s
    assumed = replace(config, grasping=AssumedGrasping(2.0, 3.0, 0.1, limit_s), seeing=AssumedSeeing(0.6, 0.1, 3.0))
    other = replace(config, grasping=replace(FITTED.grasping, log_odds=-1.0, limit_s=limit_s), seeing=FITTED.seeing)
    assert fit_world(logs, config) == fit_world(logs, assumed) == fit_world(logs, other)


def test_a_log_tells_its_share_of_dirty_objects_though_nobody_wrote_it_down():
    logs = logs_of(WorldConfig(dirty_share=0.3), episodes=300)
    unknown = Logs(logs.stages, logs.trajectories.drop(columns="dirty_share"), logs.objects)
    assert fit_world(logs, WorldConfig()).dirty_share == pytest.approx(0.3, abs=1e-6)
    assert fit_world(unknown, WorldConfig()).dirty_share == pytest.approx(0.3, abs=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("known", [WorldConfig(), FITTED])
def test_fits_to_the_first_trajectories_are_fits_to_a_log_of_them(known):
    logs = logs_of(known, 30)
    some = fitted_to(evidence_of(logs, known).first(15), known)
    assert some == fit_world(logs.select(logs.trajectory_ids[:15]), known)


def test_a_log_without_objects_is_refused():
    logs = logs_of(WorldConfig(), episodes=5)
    with pytest.raises(LogError, match="objects"):
        fit_world(Logs(logs.stages, logs.trajectories.drop(columns="dirty_share")), WorldConfig())
