"""Policies of teams in folders: back to the last bit, checked, and refused where one robot's is needed."""

import json
from dataclasses import fields, replace

import numpy as np
import pytest
from policy_folders import edit, edit_arrays, told

from halfseen.errors import ArgumentError, PolicyError
from halfseen.learning import CensoredQLearner
from halfseen.policies import decider_of
from halfseen.policies.folder import read_policy, write_policy
from halfseen.policies.folder.files import ARRAYS, DIGESTS, RECORD
from halfseen.policies.folder.kinds import kind_named
from halfseen.policies.folder.team_kind import FEATURES_VERSION
from halfseen.tables.grasp.grasp_table import GraspTable
from halfseen.tables.policy import decisions
from halfseen.tables.team_features import team_features
from halfseen.world import Robots, TableState, UniformPolicy, Verb, Workspace
from halfseen.world.actions import VERB_NAMES
from halfseen.world.logs import states_of
from picked import leaves_of
from played_teams import logged, played, team_of

PROBE = [4.754635, 7.395396, 8.429349, 8.142767, 8.766275, 7.220511, 8.646355, 5.867889]


@pytest.fixture(scope="module")
def logs():
    return logged(played(team_of(2, horizon=3), 60, seed=2), 0.4)


@pytest.fixture(scope="module")
def learner(logs):
    return CensoredQLearner.for_team(2, horizon=3, reg=0.1).fit(logs)


@pytest.fixture
def written(logs, learner, tmp_path):
    write_policy(learner, logs, tmp_path / "policy")
    return tmp_path / "policy"


def q_values(policy, logs):
    return policy.q_values(states_of(logs, 6))


def test_it_comes_back_to_the_last_bit(written, logs, learner):
    again = read_policy(written)
    assert (again.num_robots, again.horizon, again.policy.num_robots, again.is_table) == (2, 6, 2, False)
    assert q_values(again.policy, logs).tobytes() == q_values(learner.policy_, logs).tobytes()
    assert again.record["reg"]["columns"] == ["all actions"]
    assert set(again.ranges(3)) == {"num_objects", "occlusion", "log_odds", "num_attempts"}


def test_the_same_learner_writes_the_same_bytes(written, logs, learner, tmp_path):
    write_policy(learner, logs, tmp_path / "again")
    for name in (RECORD, ARRAYS, DIGESTS):
        assert (written / name).read_bytes() == (tmp_path / "again" / name).read_bytes()


def back(policy):
    """A policy through what a folder holds of it."""
    kind = kind_named("team")
    record = {"kind": "team", "schema": kind.schema(policy, []), "versions": {}}
    return kind.policy_of(json.loads(json.dumps(record)), kind.arrays_of(policy))


def test_every_field_comes_back_also_where_others_are_given_or_none_is(logs, learner):
    some = np.ones((6, len(VERB_NAMES)), dtype=bool)
    some[2, 1:] = False
    full = replace(
        learner.policy_,
        grasp=GraspTable(np.full((3, 2, 2), 0.4, dtype=np.float32), np.float32(0.5)),
        is_seen=some,
    )
    bare = replace(learner.policy_, is_seen=None, margin=None, behaviour=None)
    for policy in (full, bare):
        again = back(policy)
        assert again.num_robots == 2
        for field in fields(policy):
            ours, theirs = (leaves_of(getattr(one, field.name)) for one in (policy, again))
            assert len(ours) == len(theirs), field.name
            for one, other in zip(ours, theirs, strict=True):
                np.testing.assert_array_equal(one, other)


def test_who_does_not_say_for_how_many_robots_is_not_written(learner):
    with pytest.raises(ArgumentError, match="num_robots is None; learn with"):
        back(replace(learner.policy_, num_robots=None))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda r: r.update(version=2), "version 2 is not the 1 that halfseen"),
        (lambda r: r["schema"].pop("num_robots"), "num_robots is None and not a whole number"),
        (lambda r: r["schema"].update(num_robots="two"), "num_robots is 'two' and not a whole number"),
        (lambda r: r["schema"].update(num_robots=True), "num_robots is True and not a whole number"),
        (lambda r: r["schema"].update(num_robots=0), "num_robots is 0, and horizon 6"),
        (lambda r: r["schema"].update(num_robots=4), "num_robots is 4, and horizon 6"),
        (lambda r: r["schema"].update(horizon=8), "asks for float32 of shape [8, 1, "),
        (
            lambda r: r["schema"]["features"].update(version=0),
            "the policy looks at features {'of': 'team', 'version': 0",
        ),
        (lambda r: r["schema"].update(actions=["FINISH"]), "the policy looks at features"),
        (lambda r: r["schema"].update(seen=[["WASH"]]), "seen is"),
        (lambda r: r["schema"]["seen"][0].append("PUSH"), "seen is"),
        (lambda r: r.update(seen=[{}]), "seen does not give the range of num_objects"),
        (lambda r: r.update(kind="table"), "the policy looks at features"),
        (lambda r: r["schema"]["alone"].pop(), "it tells of each of 2 robots"),
        (lambda r: r["schema"]["alone"][0].update(horizon=4), "asks for float32 of shape [4, "),
        (lambda r: r["schema"]["alone"][1].update(features={}), "the policy looks at features {}"),
    ],
)
def test_a_record_that_does_not_fit_is_refused(written, change, message):
    edit(written, change)
    assert message in told(written)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a: a.pop("coefficients"), "'coefficients' is missing"),
        (lambda a: a.update(coefficients=a["coefficients"].astype(np.float64)), "is float64"),
        (lambda a: a.update(coefficients=a["coefficients"][:, :, 1:]), "of shape [6, 1, "),
        (lambda a: a["coefficients"].__setitem__((1, 0, 3), np.nan), "'coefficients' holds nan at [1, 0, 3]"),
        (lambda a: a["alone.0.margin"].__setitem__((2, 0, 0, 2), np.inf), "'margin' holds inf at [2, 0, 0, 2]"),
        (lambda a: a.update({"alone.0.margin": a["alone.0.margin"][..., 1:]}), "array 'margin' is float32 of shape"),
        (
            lambda a: a.update({"alone.1.behaviour": a["alone.1.behaviour"][:, 1:]}),
            "array 'behaviour' is float32 of shape",
        ),
        (lambda a: a.update(more=np.zeros(2, dtype=np.float32)), "'more' is none that a policy has"),
        (lambda a: a.pop("alone.1.coefficients"), "array 'coefficients' is missing"),
        (lambda a: a.update({"alone.2.coefficients": a["coefficients"]}), "belongs to no robot"),
        (lambda a: a.update(caution=np.float32([1.0, 2.0])), "caution is [1.0, 2.0]"),
        (lambda a: a.update(caution=np.array(-1.0, np.float32)), "caution is -1.0"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(written, change, message):
    edit_arrays(written, change)
    assert message in told(written)


def test_nobody_asks_it_for_one_robot(written):
    with pytest.raises(PolicyError, match=r"the policy decides for a team of 2 robots, which looks at what each"):
        decider_of(read_policy(written))


def test_features_of_teams_are_those_of_their_version():
    """Where this fails, features have changed: raise FEATURES_VERSION, and put the new numbers here."""
    robots = Robots(
        is_busy=np.array([False, True]),
        is_parked=np.zeros(2, dtype=bool),
        verb=np.array([0, int(Verb.WASH)]),
        target=np.array([0, 2]),
        since_s=np.float32([0.0, 1.25]),
        decisions_to_go=np.array([2, 1]),
    )
    state = TableState(
        hides=np.float32([[0.0, 0.3, 0.9], [0.0, 0.0, 0.0], [0.2, 0.1, 0.0]]),
        is_object=np.ones(3, dtype=bool),
        is_on_table=np.ones(3, dtype=bool),
        grip=np.zeros(3, dtype=np.float32),
        log_odds=np.float32([1.5, -0.2, 2.5]),
        seen=np.zeros(3, dtype=np.float32),
        lifts=np.array([0, 1, 0]),
        attempt_object=np.array([1, 0, -1, -1]),
        attempt_occlusion=np.float32([0.0, 0.93, 0.0, 0.0]),
        attempt_succeeded=np.array([True, False, False, False]),
        steps_to_go=np.asarray(2),
        robots=robots,
        workspace=Workspace(np.array([[True, True, False], [False, True, True]]), np.eye(3, dtype=bool)),
        decider=np.asarray(0),
    )
    features = team_features(state).astype(np.float64)
    assert FEATURES_VERSION == 1
    np.testing.assert_allclose(features @ np.cos(np.arange(features.shape[1])), PROBE, rtol=1e-4)


def test_what_is_improved_upon_comes_back(written, logs, learner):
    again, states = read_policy(written).policy, states_of(logs, 6)
    assert (len(again.base.policies), float(again.caution)) == (2, float(learner.policy_.caution))
    np.testing.assert_array_equal(decisions(again, states), decisions(learner.policy_, states))
    np.testing.assert_array_equal(decisions(again.base, states), decisions(learner.policy_.base, states))


def test_a_base_of_code_is_not_written(logs, learner, tmp_path):
    of_code = replace(learner.policy_, base=UniformPolicy())
    with pytest.raises(ArgumentError, match="base is a UniformPolicy, whose code a folder cannot hold"):
        kind_named("team").arrays_of(of_code)
