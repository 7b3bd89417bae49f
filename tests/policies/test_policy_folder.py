"""Folders of policies: what comes back, to the last bit."""

import json
from copy import copy
from dataclasses import fields, replace

import numpy as np
import pandas as pd
import pytest
from policy_folders import FILES, FLAT, LEARNERS, TABLES, record

from fitted_laws import FITTED
from halfseen.arrays import mapped
from halfseen.errors import PolicyError
from halfseen.learning import KernelQ
from halfseen.logs import Logs, read_logs
from halfseen.policies import decider_of
from halfseen.policies.folder import log_digest, read_policy, write_policy
from halfseen.policies.folder.stored import kind_named
from halfseen.policies.folder.table_kinds import TEAM_VERSION
from halfseen.policies.ranges import margin
from halfseen.tables import BetaGrasp
from halfseen.tables.assisted import Mending, RulePolicy
from halfseen.tables.features import FEATURES_VERSION, table_features, team_features
from halfseen.tables.grasp_table import GraspTable
from halfseen.tables.policy import decisions
from halfseen.tables.present import first_state
from halfseen.world import Robots, Scene, TableState, Verb, Workspace
from halfseen.world.actions import VERB_NAMES
from halfseen.world.logs import states_of
from picked import leaves_of
from refusals import refused_type

HIDES = np.array([[0.0, 0.3, 0.9], [0.0, 0.0, 0.0], [0.2, 0.1, 0.0]])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("q_function", "stages", "pessimism"),
    [("linear", "separate", 0.0), ("linear", "pooled", 2.0), ("smooth", "trend", 2.0), ("kernel", "separate", 2.0)],
)
def test_a_policy_of_named_actions_comes_back_to_the_last_bit(logs, tmp_path, q_function, stages, pessimism):
    learner = FLAT(q_function=q_function, stages=stages, pessimism=pessimism).fit(logs["flat"])
    # Only of many actions does a learner let it count what the log does.
    learner.policy_ = replace(learner.policy_, behaviour_weight=0.3 * pessimism)
    write_policy(learner, logs["flat"], tmp_path / "policy")
    again = read_policy(tmp_path / "policy")
    assert (again.is_table, again.horizon) == (False, 2)
    asked = pd.DataFrame(np.random.default_rng(1).normal(size=(203, 2)), columns=["x1", "x2"])
    for stage in (1, 2):
        for rows in (asked, asked[:1]):
            assert again.policy.q_values(rows, stage).tobytes() == learner.q_values(rows, stage).tobytes()
            assert again.policy.scores(rows, stage).tobytes() == learner.policy_.scores(rows, stage).tobytes()
            assert list(again.policy.decide(rows, stage)) == list(learner.decide(rows, stage))


@pytest.mark.parametrize(
    "parameters", [{}, {"grasp": BetaGrasp()}, {"q_function": KernelQ(12)}], ids=["linear", "grasp", "kernel"]
)
def test_a_policy_of_tables_comes_back_to_the_last_bit(logs, tmp_path, parameters):
    learner, rng = TABLES(**parameters).fit(logs["tables"]), np.random.default_rng(0)
    write_policy(learner, logs["tables"], tmp_path / "policy")
    again = read_policy(tmp_path / "policy")
    assert (again.is_table, again.horizon) == (True, 3)
    state = first_state(Scene(HIDES), horizon=3, dirty_share=0.6).state
    states = replace(
        mapped(lambda leaf: np.broadcast_to(leaf, (50, *leaf.shape)), state),
        log_odds=rng.normal(size=(50, 3)).astype(np.float32),
        steps_to_go=rng.integers(1, 4, size=50).astype(np.int32),
    )
    q = learner.policy_.q_values(states)
    assert again.policy.q_values(states).tobytes() == q.tobytes()
    assert len(set(q.argmax(axis=1))) > 1


@pytest.mark.slow
def test_a_policy_that_looks_at_text_comes_back_with_its_categories(kept, logs, fitted):
    stored, stages = read_policy(kept / "text"), logs["text"].stages
    assert stored.policy.categories == {"colour": ("blue", "green", "red")}
    for stage in (1, 2):
        rows = stages[stages["stage"] == stage]
        assert stored.policy.q_values(rows, stage).tobytes() == fitted["text"].q_values(rows, stage).tobytes()
        assert stored.ranges(stage)["colour"] == rows["colour"].value_counts().to_dict()
        assert stored.ranges(stage)["is_heavy"] == (0.0, 1.0)


def test_a_policy_of_a_team_comes_back_with_what_it_improves_upon_and_decides_for_no_single_robot(kept, logs, fitted):
    again, policy, states = read_policy(kept / "team"), fitted["team"].policy_, states_of(logs["team"], 6)
    assert (again.num_robots, again.horizon, again.policy.num_robots, again.is_table) == (2, 6, 2, False)
    assert again.policy.q_values(states).tobytes() == policy.q_values(states).tobytes()
    assert again.record["reg"]["columns"] == ["all actions"]
    assert set(again.ranges(3)) == {"num_objects", "occlusion", "log_odds", "num_attempts"}
    assert (len(again.policy.base.policies), float(again.policy.caution)) == (2, float(policy.caution))
    for one, other in ((again.policy, policy), (again.policy.base, policy.base)):
        np.testing.assert_array_equal(decisions(one, states), decisions(other, states))
    with pytest.raises(PolicyError, match=r"the policy decides for a team of 2 robots, and needs to know what each"):
        decider_of(again)


def test_the_log_of_another_learner_is_refused_and_nothing_is_written(logs, fitted, tmp_path):
    part = logs["flat"].select(logs["flat"].trajectory_ids[:-1])
    for learner, log, message in (
        (fitted["flat"], part, "give it the log that it was fitted to"),
        (fitted["flat"], "logs", "logs is a str; give Logs"),
        (fitted["flat"].policy_, logs["flat"], "a DiscretePolicy is no learner; give one that was fitted"),
    ):
        with refused_type(message):
            write_policy(learner, log, tmp_path / "policy")
    assert not (tmp_path / "policy").exists()


def through_a_folder(policy):
    """A policy of a team through what a folder holds of it."""
    kind = kind_named("team")
    specification = {"kind": "team", "schema": kind.schema(policy), "versions": {}}
    return kind.policy_of(json.loads(json.dumps(specification)), kind.arrays_of(policy))


def test_every_field_of_a_team_comes_back_also_where_others_are_given_or_none_is(fitted):
    policy, some = fitted["team"].policy_, np.ones((6, len(VERB_NAMES)), dtype=bool)
    some[2, 1:] = False
    grasp = GraspTable(np.full((3, 2, 2), 0.4, dtype=np.float32), np.float32(0.5))
    for given in ({"grasp": grasp, "is_seen": some}, dict.fromkeys(("is_seen", "margin", "behaviour"))):
        before = replace(policy, **given)
        again = through_a_folder(before)
        assert again.num_robots == 2
        for field in fields(before):
            ours, theirs = (leaves_of(getattr(one, field.name)) for one in (before, again))
            for one, other in zip(ours, theirs, strict=True):
                np.testing.assert_array_equal(one, other)


@pytest.mark.parametrize("kind", ["text", "team"])
def test_the_same_learner_writes_the_same_bytes(kept, logs, fitted, tmp_path, kind):
    again = LEARNERS[kind][1]().fit(logs[kind]) if kind == "text" else fitted[kind]
    write_policy(again, logs[kind], tmp_path / "again")
    assert all((kept / kind / name).read_bytes() == (tmp_path / "again" / name).read_bytes() for name in FILES)


def test_a_folder_from_before_there_were_categories_verdicts_and_least_rewards_is_read(copied, fitted, logs):
    folder = copied("flat")
    record(lambda r: (r["schema"].pop("categories"), r.pop("verdict"), r.pop("warnings")))(folder)
    stored = read_policy(folder)
    assert (stored.policy.categories, stored.verdict, stored.doubts) == ({}, None, ())
    stages = logs["flat"].stages
    assert stored.policy.q_values(stages, 1).tobytes() == fitted["flat"].q_values(stages, 1).tobytes()
    folder = copied("tables")
    least, stages = read_policy(folder).least_rewards, logs["tables"].stages
    assert least == {verb: stages["reward"][stages["action"] == verb].min() for verb in ("WASH", "LIFT", "FINISH")}
    record(lambda r: r["schema"].pop("least_rewards"))(folder)
    assert read_policy(folder).least_rewards == {}


def test_the_record_says_what_was_learned_from_and_the_ranges_of_each_stage_or_of_all(kept, logs, fitted, tmp_path):
    stored, learner, log = read_policy(kept / "flat"), fitted["flat"], logs["flat"]
    of = stored.record
    assert of["schema"]["possible"] == [["A", "B"], ["A", "C"]]
    assert (of["log"]["num_trajectories"], of["log"]["sha256"]) == (40, log_digest(log))
    assert of["learner"]["censoring"] == "kaplan-meier"
    assert of["reg"]["values"] == learner.q_functions_.reg.tolist()
    weights = of["diagnostics"]["weights"]
    assert weights["effective_sample_size"] == learner.diagnostics_.effective_sample_size
    assert len(of["diagnostics"]["weights_by_stage"]) == 2
    every = log.stages["x1"]
    second = every[log.stages["stage"] == 2]
    assert stored.ranges(2) == {"x1": (second.min(), second.max()), "x2": (0.0, 2.0)}
    assert stored.margins(2)["x1"] == (margin(-second.to_numpy(), 2), margin(second.to_numpy(), 2))
    write_policy(FLAT(stages="pooled").fit(log), log, tmp_path / "pooled")
    assert read_policy(tmp_path / "pooled").ranges(2)["x1"] == (every.min(), every.max())


def test_a_log_has_one_digest_wherever_it_lies(logs, tmp_path):
    tables = logs["tables"]
    tables.write(tmp_path / "logs")
    assert log_digest(read_logs(tmp_path / "logs")) == log_digest(tables)
    moved = tables.objects.copy()
    moved.at[3, "hidden_by"] = [0.11, 0.0] if moved.at[3, "object"] else [0.0, 0.41]
    for other in (tables.select(tables.trajectory_ids[1:]), Logs(tables.stages, tables.trajectories, moved)):
        assert log_digest(other) != log_digest(tables)


def test_a_verdict_is_kept_and_where_nothing_speaks_for_the_policy_it_is_a_doubt(logs, fitted, tmp_path):
    doubts = {}
    for word in ("better", "not better", "inconclusive"):
        verdict = {"verdict": word, "reason": "it earns between -1 and 1 more", "sentence": "Inconclusive: …."}
        write_policy(fitted["flat"], logs["flat"], tmp_path / word, verdict=verdict)
        again = read_policy(tmp_path / word)
        assert again.verdict == verdict
        doubts[word] = again.doubts[:-1]
    doubt = "no evidence that this policy beats the rule that made the logs: it earns between -1 and 1 more"
    assert doubts == {"better": (), "not better": (doubt,), "inconclusive": (doubt,)}


def test_features_are_those_of_their_version():
    """Where this fails, features have changed: raise FEATURES_VERSION, and put the new numbers here."""
    alone = TableState(
        hides=HIDES,
        is_object=np.ones(3, dtype=bool),
        is_on_table=np.ones(3, dtype=bool),
        grip=np.zeros(3),
        log_odds=np.array([1.5, -0.2, 2.5]),
        seen=np.zeros(3),
        lifts=np.array([0, 1, 0]),
        attempt_object=np.array([1, 0, -1, -1]),
        attempt_occlusion=np.array([0.0, 0.93, 0.0, 0.0]),
        attempt_succeeded=np.array([True, False, False, False]),
        steps_to_go=np.asarray(2),
    )
    robots = Robots(
        is_busy=np.array([False, True]),
        is_parked=np.zeros(2, dtype=bool),
        verb=np.array([0, int(Verb.WASH)]),
        target=np.array([0, 2]),
        since_s=np.float32([0.0, 1.25]),
        decisions_to_go=np.array([2, 1]),
    )
    workspace = Workspace(np.array([[True, True, False], [False, True, True]]), np.eye(3, dtype=bool))
    single = mapped(lambda leaf: leaf.astype(np.float32) if leaf.dtype == np.float64 else leaf, alone)
    of_team = replace(single, robots=robots, workspace=workspace, decider=np.asarray(0))
    assert (FEATURES_VERSION, TEAM_VERSION) == (1, 1)
    for features, probe in (
        (table_features(alone), [2.191882, 6.020726, 5.286517, 5.92044, 6.093954, 7.434375, 6.474695]),
        (
            team_features(of_team),
            [4.754635, 7.395396, 8.429349, 8.142767, 8.766275, 7.220511, 8.646355, 5.867889],
        ),
    ):
        np.testing.assert_allclose(features.astype(float) @ np.cos(np.arange(features.shape[1])), probe, rtol=1e-4)


def of_laws(policy):
    """What else a folder may hold: log-odds recomputed, a rule, with a grasp model or without."""
    mending = Mending(
        np.float32([-2.0, 0.1, 3.0]),
        np.float32([-1.0, 0.0, 1.5]),
        np.float32(np.log(policy.config.dirty_share / (1.0 - policy.config.dirty_share))),
    )
    table = GraspTable(np.linspace(0.1, 0.9, 12, dtype=np.float32).reshape(3, 2, 2), np.float32(0.5))
    return {
        "model": policy,
        "mended": replace(policy, mending=mending),
        "look alone": replace(policy, excess=None),
        "never lifts": replace(policy, is_seen=np.array([True, True, False])),
        "rule": RulePolicy(policy.config, mending),
        "rule of the log": RulePolicy(policy.config, None, table),
        "other laws": replace(policy, mending=None, config=replace(FITTED, horizon=3)),
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["model", "mended", "look alone", "never lifts", "rule", "rule of the log", "other laws"]
)
def test_a_policy_of_laws_comes_back_and_decides_the_same(logs, fitted, tmp_path, name):
    learner = copy(fitted["laws"])
    learner.policy_ = policy = of_laws(learner.policy_)[name]
    write_policy(learner, logs["laws"], tmp_path / "policy")
    again = read_policy(tmp_path / "policy")
    assert (again.is_table, again.horizon, again.q_error) == (True, 3, None)
    assert type(again.policy) is type(policy)
    assert again.policy.config == policy.config
    states = states_of(logs["laws"], 3)
    assert again.policy.q_values(states).tobytes() == policy.q_values(states).tobytes()
    state = first_state(Scene(HIDES), horizon=3, dirty_share=0.6)
    assert decider_of(again).decide(state).reason
