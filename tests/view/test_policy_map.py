import numpy as np
import pandas as pd
import pytest

from halfseen.evaluation.targets import task_of
from halfseen.figures import inline_svg
from halfseen.learning import CensoredQLearner
from halfseen.logs import Logs
from halfseen.view.log_figures import action_colours
from halfseen.view.policy_figures import draw_map, draw_table_map
from halfseen.view.policy_map import FEWEST_NEAR, NEAR, policy_maps, supported, table_map
from halfseen.world import ActionSpace
from small_logs import table_log
from small_report import ACTIONS, COVARIATES, hostile_log


@pytest.fixture(scope="module")
def logs():
    return hostile_log(num_trajectories=80)


@pytest.fixture(scope="module")
def policy(logs):
    return CensoredQLearner.of_paper(2, ACTIONS, COVARIATES, reg=0.1).fit(logs).policy_


def test_a_map_is_what_the_policy_decides_with_the_rest_in_the_middle(policy, logs):
    first, _ = policy_maps(policy, logs, COVARIATES)
    states = logs.stages[logs.stages["stage"] == 1]
    for row, column in ((0, 0), (40, 70), (89, 3)):
        at = {COVARIATES[0]: [first.across[column]], COVARIATES[1]: [first.up[row]]}
        assert first.taken[row, column] == policy.decide(pd.DataFrame(at), 1)[0]
    assert first.across[[0, -1]] == pytest.approx(np.quantile(states[COVARIATES[0]], [0.01, 0.99]))
    assert len(first.dots) == len(states)
    assert first.done.tolist() == states["action"].tolist()
    assert first.middle == {}


@pytest.mark.parametrize("num_covariates", [1, 2])
def test_support_is_enough_states_nearby_by_a_loop(num_covariates):
    rng = np.random.default_rng(0)
    states = (rng.normal(size=(60, 2)) * [1.0, 100.0])[:, :num_covariates]
    across, up = np.linspace(-3.0, 3.0, 12), np.linspace(-300.0, 300.0, 9)
    places = [[x, y][:num_covariates] for y in (up if num_covariates == 2 else [0.0]) for x in across]
    scaled, near = states / states.std(axis=0), np.array(places) / states.std(axis=0)
    by_loop = [sum(np.linalg.norm(place - one) <= NEAR for one in scaled) >= FEWEST_NEAR for place in near]
    asked = across, up if num_covariates == 2 else None
    assert supported(*asked, states).ravel().tolist() == by_loop
    assert 0 < sum(by_loop) < len(places)
    assert not supported(*asked, states[: FEWEST_NEAR - 1]).any()


def test_one_covariate_is_a_strip_and_none_is_nothing(logs):
    one = CensoredQLearner.of_paper(2, ACTIONS, COVARIATES[:1], reg=0.1).fit(logs).policy_
    maps = policy_maps(one, logs, COVARIATES[:1])
    assert maps[0].up is None
    assert maps[0].taken.shape[0] == 1
    svg = inline_svg(lambda: draw_map(maps[0], action_colours(ACTIONS)), "f", "t")
    assert "the policy" in svg
    assert policy_maps(one, logs, []) == []


def test_a_drawn_map_names_its_covariates_and_hatches(policy, logs):
    first = policy_maps(policy, logs, COVARIATES)[0]
    svg = inline_svg(lambda: draw_map(first, action_colours(ACTIONS)), "f", "t")
    assert "y_$2$" in svg
    assert "x&lt;1&gt;" in svg
    assert ("<pattern" in svg) == (not first.is_supported.all())
    assert len(svg) < 100_000


def test_objects_of_a_log_are_counted_by_what_the_policy_would_do_to_them(monkeypatch):
    monkeypatch.setattr("halfseen.view.policy_map.FEWEST_OBJECTS", 1)
    logs = table_log(num_trajectories=60)
    policy = CensoredQLearner.for_table(3, reg=0.1).fit(logs).policy_
    task = task_of(policy, logs)
    told = table_map(policy, task, logs)
    taken = task.target_probabilities(policy, logs, 3)
    num = {"WASH": 0, "LIFT": 0}
    ids = list(logs.trajectory_ids)
    for trajectory, stage in zip(logs.stages["trajectory"], logs.stages["stage"], strict=True):
        chances = taken[ids.index(trajectory), stage - 1]
        name = ActionSpace.of_size(len(chances)).names[int(np.argmax(chances))].split()[0]
        num[name] = num.get(name, 0) + 1
    on_table = (logs.objects["location"] == "TABLE").sum()
    assert told.num_objects.sum() == on_table
    for verb, share in told.share.items():
        assert np.nansum(share * told.num_objects) == pytest.approx(num[verb])
        assert verb in inline_svg(lambda verb=verb: draw_table_map(told, verb), "f", "t")
    bare = Logs(logs.stages, logs.trajectories, logs.objects.drop(columns="log_odds"))
    assert table_map(policy, task, bare) is None
