"""A whole world fitted to a log: what is known stays, what is not is fitted, whatever the true laws are."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from fitted_laws import FITTED
from halfseen.errors import LogError
from halfseen.logs import Logs
from halfseen.planners import POMDPPolicy
from halfseen.tables import fit_world
from halfseen.tables.evidence import evidence_of
from halfseen.tables.laws import fitted_to
from halfseen.world import (
    AssumedGrasping,
    AssumedSeeing,
    KnownGrasping,
    KnownSeeing,
    Scene,
    TableWorld,
    UniformPolicy,
    WorldConfig,
    random,
)
from halfseen.world.rollout import evaluate
from halfseen.world.state import pad_scenes

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


@pytest.mark.parametrize("config", [WorldConfig(), FITTED])
def test_the_true_laws_are_not_looked_at(config):
    logs, limit_s = logs_of(config, 30), config.grasping.limit_s
    assumed = replace(config, grasping=AssumedGrasping(2.0, 3.0, 0.1, limit_s), seeing=AssumedSeeing(0.6, 0.1, 3.0))
    other = replace(config, grasping=replace(FITTED.grasping, log_odds=-1.0, limit_s=limit_s), seeing=FITTED.seeing)
    assert fit_world(logs, config) == fit_world(logs, assumed) == fit_world(logs, other)


def test_a_log_tells_its_share_of_dirty_objects_though_nobody_wrote_it_down():
    logs = logs_of(WorldConfig(dirty_share=0.3), episodes=300)
    untold = Logs(logs.stages, logs.trajectories.drop(columns="dirty_share"), logs.objects)
    assert fit_world(logs, WorldConfig()).dirty_share == pytest.approx(0.3, abs=1e-6)
    assert fit_world(untold, WorldConfig()).dirty_share == pytest.approx(0.3, abs=0.03)


@pytest.mark.parametrize("known", [WorldConfig(), FITTED])
def test_fits_to_the_first_trajectories_are_fits_to_a_log_of_them(known):
    logs = logs_of(known, 30)
    some = fitted_to(evidence_of(logs, known).first(15), known)
    assert some == fit_world(logs.select(logs.trajectory_ids[:15]), known)


def test_a_log_without_objects_is_refused():
    logs = logs_of(WorldConfig(), episodes=5)
    with pytest.raises(LogError, match="objects"):
        fit_world(Logs(logs.stages, logs.trajectories.drop(columns="dirty_share")), WorldConfig())
