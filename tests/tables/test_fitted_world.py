"""A whole world fitted to a log: what is known stays, what is not is fitted, whatever the true laws are."""

from dataclasses import replace

import numpy as np
import pytest

from fitted_laws import FITTED
from halfseen.errors import LogError
from halfseen.logs import Logs
from halfseen.tables import fit_world
from halfseen.tables.fitted_world import evidence_of, fitted_to
from halfseen.world import AssumedSeeing, Scene, TableWorld, UniformPolicy, WorldConfig

HIDES = np.array([[0.0, 0.0, 0.0], [0.6, 0.0, 0.0], [0.0, 0.4, 0.0]])


def logs_of(config, episodes=60, cut_share=0.4):
    return TableWorld(config).simulate(Scene(HIDES), UniformPolicy(), episodes, seed=0, cut_share=cut_share)


@pytest.mark.parametrize("config", [WorldConfig(), FITTED])
def test_what_is_known_stays_and_the_laws_are_ones_to_plan_with(config):
    known = replace(config, reward_wash_dirty=4.0, transport_s=1.0, horizon=10)
    fitted = fit_world(logs_of(known), known)
    as_known = replace(fitted, grasping=known.grasping, seeing=known.seeing)
    assert as_known == known
    assert fitted.grasping.limit_s == known.grasping.limit_s
    assert 0.5 <= fitted.seeing.accuracy(1.0) <= fitted.seeing.accuracy(0.0) < 1.0


def test_the_true_laws_are_not_looked_at():
    logs, known = logs_of(WorldConfig()), WorldConfig()
    other = replace(known, grasping=replace(known.grasping, log_time=3.0), seeing=AssumedSeeing(0.6, 0.1, 3.0))
    assert fit_world(logs, known) == fit_world(logs, other)


def test_a_log_tells_its_share_of_dirty_objects_though_nobody_wrote_it_down():
    logs = logs_of(WorldConfig(dirty_share=0.3), episodes=300)
    untold = Logs(logs.stages, logs.paths.drop(columns="dirty_share"), logs.objects)
    assert fit_world(logs, WorldConfig()).dirty_share == pytest.approx(0.3, abs=1e-6)
    assert fit_world(untold, WorldConfig()).dirty_share == pytest.approx(0.3, abs=0.03)


def test_fits_to_the_first_paths_are_fits_to_a_log_of_them():
    logs, known = logs_of(WorldConfig()), WorldConfig()
    some = fitted_to(evidence_of(logs, known).first(20), known)
    assert some == fit_world(logs.select(logs.path_ids[:20]), known)


def test_the_same_log_gives_the_same_bits():
    assert fit_world(logs_of(WorldConfig()), WorldConfig()) == fit_world(logs_of(WorldConfig()), WorldConfig())


def test_a_log_without_objects_is_refused():
    logs = logs_of(WorldConfig(), episodes=5)
    with pytest.raises(LogError, match="objects"):
        fit_world(Logs(logs.stages, logs.paths.drop(columns="dirty_share")), WorldConfig())
