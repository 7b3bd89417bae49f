import contextlib
import json
from copy import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from policy_folders import edit, edit_arrays, sign, told

from halfseen.arrays import mapped
from halfseen.errors import ArgumentError, PolicyError
from halfseen.learning import CensoredQLearner, KernelQ
from halfseen.logs import Logs, read_logs
from halfseen.policies.folder import log_digest, read_policy, write_policy
from halfseen.policies.folder.files import ARRAYS, DIGESTS, RECORD
from halfseen.tables import BetaGrasp
from halfseen.tables.features import FEATURES_VERSION, table_features
from halfseen.tables.present import first_state
from halfseen.world import Scene
from halfseen.world.state import TableState
from small_logs import flat_log, table_log
from text_logs import COVARIATES, text_log

FILES = (RECORD, ARRAYS, DIGESTS)
ACTIONS = {1: ["A", "B"], 2: ["A", "C"]}
HIDES = np.array([[0.0, 0.3, 0.9], [0.0, 0.0, 0.0], [0.2, 0.1, 0.0]])
PROBE = [2.191882, 6.020726, 5.286517, 5.92044, 6.093954, 7.434375, 6.474695]


def flat_learner(**parameters):
    return CensoredQLearner.of_paper(2, ACTIONS, ["x1", "x2"], reg=0.1, **parameters)


@pytest.fixture(scope="module")
def flat():
    return flat_log()


@pytest.fixture(scope="module")
def tables():
    return table_log()


@pytest.fixture(scope="module")
def flat_fitted(flat):
    return flat_learner().fit(flat)


@pytest.fixture(scope="module")
def tables_fitted(tables):
    return CensoredQLearner.for_table(3, reg=0.1).fit(tables)


@pytest.fixture
def written(flat, flat_fitted, tmp_path):
    write_policy(flat_fitted, flat, tmp_path / "policy")
    return tmp_path / "policy"


@pytest.fixture
def of_tables(tables, tables_fitted, tmp_path):
    write_policy(tables_fitted, tables, tmp_path / "tables")
    return tmp_path / "tables"


@pytest.mark.parametrize(
    ("q_function", "stages", "pessimism"),
    [("linear", "separate", 0.0), ("linear", "pooled", 2.0), ("kernel", "separate", 2.0)],
)
def test_a_policy_of_named_actions_comes_back_to_the_last_bit(flat, tmp_path, q_function, stages, pessimism):
    learner = flat_learner(q_function=q_function, stages=stages, pessimism=pessimism).fit(flat)
    write_policy(learner, flat, tmp_path / "policy")
    again = read_policy(tmp_path / "policy")
    assert not again.is_table
    assert again.horizon == 2
    asked = pd.DataFrame(np.random.default_rng(1).normal(size=(203, 2)), columns=["x1", "x2"])
    for stage in (1, 2):
        for rows in (asked, asked[:1]):
            q = learner.q_values(rows, stage)
            assert again.policy.q_values(rows, stage).tobytes() == q.tobytes()
            assert again.policy.scores(rows, stage).tobytes() == learner.policy_.scores(rows, stage).tobytes()
            assert list(again.policy.decide(rows, stage)) == list(learner.decide(rows, stage))


@pytest.mark.parametrize(
    "parameters",
    [{}, {"grasp": BetaGrasp()}, {"q_function": KernelQ(12)}],
    ids=["linear", "grasp", "kernel"],
)
def test_a_policy_of_tables_comes_back_to_the_last_bit(tables, tmp_path, parameters):
    learner = CensoredQLearner.for_table(3, reg=0.1, **parameters).fit(tables)
    write_policy(learner, tables, tmp_path / "policy")
    again = read_policy(tmp_path / "policy")
    assert again.is_table
    assert again.horizon == 3
    rng = np.random.default_rng(0)
    state = first_state(Scene(HIDES), horizon=3, dirty_share=0.6).state
    states = mapped(lambda leaf: np.broadcast_to(leaf, (50, *leaf.shape)), state)
    states = replace(
        states,
        log_odds=np.asarray(rng.normal(size=(50, 3)), dtype=np.float32),
        steps_to_go=np.asarray(rng.integers(1, 4, size=50), dtype=np.int32),
    )
    q = learner.policy_.q_values(states)
    assert again.policy.q_values(states).tobytes() == q.tobytes()
    assert len(set(q.argmax(axis=1))) > 1


@pytest.fixture
def of_text(tmp_path):
    logs = text_log()
    write_policy(CensoredQLearner.of_paper(2, ["A", "B"], COVARIATES, reg=0.1).fit(logs), logs, tmp_path / "text")
    return tmp_path / "text"


def test_a_policy_that_looks_at_text_comes_back_with_its_categories_and_is_written_the_same_again(of_text, tmp_path):
    logs = text_log()
    learner = CensoredQLearner.of_paper(2, ["A", "B"], COVARIATES, reg=0.1).fit(logs)
    write_policy(learner, logs, tmp_path / "again")
    assert [(of_text / name).read_bytes() for name in FILES] == [
        (tmp_path / "again" / name).read_bytes() for name in FILES
    ]
    stored = read_policy(of_text)
    assert stored.policy.categories == {"colour": ("blue", "green", "red")}
    for stage in (1, 2):
        rows = logs.stages[logs.stages["stage"] == stage]
        assert stored.policy.q_values(rows, stage).tobytes() == learner.q_values(rows, stage).tobytes()
        assert stored.ranges(stage)["colour"] == rows["colour"].value_counts().to_dict()
        assert stored.ranges(stage)["is_heavy"] == (0.0, 1.0)


def test_a_folder_from_before_there_were_categories_and_verdicts_is_read(written, flat_fitted, flat):
    edit(written, lambda record: (record["schema"].pop("categories"), record.pop("verdict"), record.pop("warnings")))
    stored = read_policy(written)
    again = stored.policy
    assert (again.categories, stored.verdict, stored.doubts) == ({}, None, ())
    assert again.q_values(flat.stages, 1).tobytes() == flat_fitted.q_values(flat.stages, 1).tobytes()


def test_the_record_says_what_was_learned_from(written, flat, flat_fitted):
    record = read_policy(written).record
    assert record["schema"]["possible"] == [["A", "B"], ["A", "C"]]
    assert (record["log"]["num_paths"], record["log"]["sha256"]) == (40, log_digest(flat))
    assert record["learner"]["censoring"] == "kaplan-meier"
    assert record["reg"]["values"] == flat_fitted.q_functions_.reg.tolist()
    weights = record["diagnostics"]["weights"]
    assert weights["effective_sample_size"] == flat_fitted.diagnostics_.effective_sample_size
    assert len(record["diagnostics"]["weights_by_stage"]) == 2


def test_ranges_are_those_of_the_stage_or_of_all_where_it_shares_its_q(written, flat, tmp_path):
    second = flat.stages[flat.stages["stage"] == 2]["x1"]
    assert read_policy(written).ranges(2) == {"x1": (second.min(), second.max()), "x2": (0.0, 2.0)}
    pooled = flat_learner(stages="pooled").fit(flat)
    write_policy(pooled, flat, tmp_path / "pooled")
    every = flat.stages["x1"]
    assert read_policy(tmp_path / "pooled").ranges(2)["x1"] == (every.min(), every.max())


def test_a_log_has_one_digest_wherever_it_lies(tables, tmp_path):
    tables.write(tmp_path / "logs")
    assert log_digest(read_logs(tmp_path / "logs")) == log_digest(tables)
    assert log_digest(tables.select(tables.path_ids[1:])) != log_digest(tables)
    moved = tables.objects.copy()
    moved.at[3, "hidden_by"] = [0.11, 0.0] if moved.at[3, "object"] else [0.0, 0.41]
    assert log_digest(Logs(tables.stages, tables.paths, moved)) != log_digest(tables)


@pytest.mark.parametrize("name", FILES)
def test_any_byte_changed_is_noticed(written, name):
    whole = (written / name).read_bytes()
    rng = np.random.default_rng(0)
    for position in {0, len(whole) - 1, *rng.integers(0, len(whole), 50).tolist()}:
        changed = bytearray(whole)
        changed[position] ^= 1 << int(rng.integers(8))
        (written / name).write_bytes(changed)
        assert "it is not as it was written" in told(written)
    (written / name).write_bytes(whole)
    read_policy(written)


@pytest.mark.parametrize("name", FILES)
@pytest.mark.parametrize("keep", [None, 0, 10])
def test_a_half_written_folder_is_refused(written, name, keep):
    if keep is None:
        (written / name).unlink()
        assert f"{written / name}: it is missing" in told(written)
    else:
        (written / name).write_bytes((written / name).read_bytes()[:keep])
        assert "it is not as it was written" in told(written)


def of_schema(**changed):
    return lambda record: record["schema"].update(changed)


def of_record(**changed):
    return lambda record: record.update(changed)


def of_colours(colours):
    return lambda record: record["schema"]["categories"].update(colour=colours)


@pytest.mark.parametrize(
    ("folder", "change", "message"),
    [
        ("written", of_record(version=2), "version 2 is not the 1 that halfseen"),
        ("written", of_record(format="pickle"), "describes no policy"),
        ("written", of_record(kind="tree"), "kind is 'tree'"),
        ("written", lambda r: r.pop("seen"), "seen does not give the range of x1, x2"),
        ("written", lambda r: r["seen"][0]["ranges"].update(x1=[2.0, 1.0]), "ends before it begins"),
        ("written", lambda r: r["seen"][0]["ranges"].pop("x1"), "a range is missing"),
        ("written", lambda r: r["seen"][0].update(ranges={"x1": [np.nan, 1.0]}), "NaN is no number of JSON"),
        ("written", lambda r: r.pop("schema"), "schema is None"),
        ("written", of_schema(horizon=True), "horizon is True"),
        ("written", of_schema(horizon=3), "possible is"),
        ("written", of_schema(covariates=["x1"]), "'coefficients' is float64 of shape [2, 3, 3]"),
        ("written", of_schema(covariates=["x1", "x1"]), "each has a name of its own"),
        ("written", of_schema(actions=["A", "B", 0.5]), "each has a name of its own"),
        ("written", lambda r: r["schema"]["possible"][1].append("D"), "possible is"),
        ("written", of_record(kind="table"), "looks at features None"),
        ("written", of_record(stages_left=[0.5]), "stages_left is [0.5]"),
        ("written", of_record(stages_left=["2"]), "stages_left is ['2']"),
        ("written", of_record(reward_spread=-1.0), "reward_spread is -1.0"),
        ("written", of_record(reward_spread="wide"), "reward_spread is 'wide' and not a standard deviation"),
        ("written", of_record(verdict={"verdict": "better"}), "reason is None and not a text"),
        ("written", of_record(verdict="better"), "verdict is 'better' and not an object"),
        ("written", of_record(warnings=[3]), "warnings is [3]"),
        ("of_text", of_schema(categories={"size": ["L", "S"]}), "categories are of size; each is of a covariate"),
        ("of_text", of_schema(categories=["colour"]), "categories is ['colour'] and not an object"),
        ("of_text", of_colours(["red", "red"]), "colour is ['red', 'red']"),
        ("of_text", of_colours([1, 2, 3]), "colour is [1, 2, 3]"),
        ("of_text", of_colours(["red", "blue"]), "array 'coefficients' is float64 of shape"),
        ("of_text", lambda r: r["seen"][0]["ranges"].update(colour={"red": 0}), "the range of x, colour, is_heavy"),
        ("of_tables", lambda r: r["schema"]["features"].update(version=0), "the policy looks at features"),
        ("of_tables", of_schema(least_rewards={"PUSH": -1.0}), "least_rewards is {'PUSH': -1.0}"),
        ("of_tables", of_schema(seen="WASH"), "seen is"),
        ("of_tables", of_schema(seen=[["WASH"]]), "seen is"),
        ("of_tables", of_schema(seen=[[]] * 3), "seen is"),
        ("of_tables", of_schema(seen=[["PUSH"]] * 3), "seen is"),
        ("of_tables", of_schema(seen=[[["WASH"]]] * 3), "seen is"),
        ("of_tables", of_schema(seen=[["WASH"], "LIFT", ["LIFT"]]), "seen is"),
    ],
)
def test_a_record_that_does_not_fit_is_refused(request, folder, change, message):
    folder = request.getfixturevalue(folder)
    edit(folder, change)
    assert message in told(folder)


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        *((RECORD, text, RECORD) for text in (b"", b"[1]", b"{", b"\xff", b"[" * 100_000)),
        (ARRAYS, b"\x80\x04." + bytes(40), "it is no safetensors file"),
    ],
)
def test_a_file_that_is_none_of_its_kind_is_refused(written, name, content, message):
    (written / name).write_bytes(content)
    sign(written)
    assert message in told(written)


def test_no_folder_and_a_folder_of_something_else_are_refused(tmp_path):
    (tmp_path / "file").write_text("x")
    for name in ("none", "file"):
        assert "there is no such folder" in told(tmp_path / name)
    assert "policy.json: it is missing" in told(tmp_path)


VERDICT = {"verdict": "cannot be said", "reason": "it earns between -1 and 1 more", "sentence": "Cannot be said: …."}


def test_a_verdict_is_kept_and_where_nothing_speaks_for_the_policy_it_is_a_doubt(flat, flat_fitted, tmp_path):
    doubts = {}
    for verdict in ("better", "not better", "cannot be said"):
        write_policy(flat_fitted, flat, tmp_path / verdict, verdict=VERDICT | {"verdict": verdict})
        again = read_policy(tmp_path / verdict)
        assert again.verdict == VERDICT | {"verdict": verdict}
        doubts[verdict] = again.doubts[:-1]
    told = "no evidence that this policy beats the rule that made the logs: it earns between -1 and 1 more"
    assert doubts == {"better": (), "not better": (told,), "cannot be said": (told,)}


def test_what_verbs_paid_at_least_goes_with_a_policy_of_tables(tables, of_tables):
    told_of = read_policy(of_tables).least_rewards
    for verb, least in told_of.items():
        assert least == tables.stages["reward"][tables.stages["action"] == verb].min()
    assert set(told_of) == {"WASH", "LIFT", "FINISH"}
    edit(of_tables, lambda record: record["schema"].pop("least_rewards"))
    assert read_policy(of_tables).least_rewards == {}


def places(record, at=()):
    """Every place in a record, as the keys that lead to it."""
    keys = record if isinstance(record, dict) else range(len(record)) if isinstance(record, list) else ()
    return [place for key in keys for place in [(*at, key), *places(record[key], (*at, key))]]


def test_nonsense_anywhere_in_the_schema_is_refused_or_harmless(written):
    """No other error than a PolicyError comes of it, whatever stands where."""
    whole = json.loads((written / RECORD).read_text())
    wanted = [place for place in places(whole) if place[0] not in ("learner", "diagnostics", "log", "versions")]
    for place in wanted:
        for nonsense in (None, -1, "x", [None], 10**400):
            record = json.loads(json.dumps(whole))
            parent = record
            for key in place[:-1]:
                parent = parent[key]
            parent[place[-1]] = nonsense
            (written / RECORD).write_text(json.dumps(record))
            sign(written)
            with contextlib.suppress(PolicyError):
                read_policy(written).ranges(2)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda a: a["coefficients"].__setitem__((1, 2, 0), np.nan), "'coefficients' holds nan at [1, 2, 0]"),
        (lambda a: a["coefficients"].__setitem__((1, 2, 0), np.inf), "'coefficients' holds inf at [1, 2, 0]"),
        (lambda a: a.pop("coefficients"), "'coefficients' is missing"),
        (lambda a: a.update(coefficients=a["coefficients"].astype(np.float32)), "is float32"),
        (lambda a: a.update(coefficients=a["coefficients"][:1]), "of shape [1, 3, 3]"),
        (lambda a: a.update(more=np.zeros(2)), "'more' is none that a policy has"),
        (lambda a: a.update({"grasp.chances": np.zeros((3, 2, 2))}), "'grasp.chances' is none that a policy has"),
        (lambda a: a.update({"kernel.centre": np.zeros(2)}), "'kernel.projection' is missing"),
        (lambda a: a.update(behaviour=np.zeros((3, 2))), "the schema asks for float64 of shape [3, 3]"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(written, change, message):
    edit_arrays(written, change)
    assert message in told(written)


def test_features_of_tables_are_those_of_their_version():
    """Where this fails, features have changed: raise FEATURES_VERSION, and put the new numbers here."""
    state = TableState(
        hides=np.asarray(HIDES),
        is_object=np.ones(3, dtype=bool),
        is_on_table=np.array([True, True, True]),
        grip=np.zeros(3),
        log_odds=np.array([1.5, -0.2, 2.5]),
        seen=np.zeros(3),
        lifts=np.array([0, 1, 0]),
        attempt_object=np.array([1, 0, -1, -1]),
        attempt_occlusion=np.array([0.0, 0.93, 0.0, 0.0]),
        attempt_succeeded=np.array([True, False, False, False]),
        steps_to_go=np.asarray(2),
    )
    features = np.asarray(table_features(state), dtype=np.float64)
    assert FEATURES_VERSION == 1
    told = features @ np.cos(np.arange(features.shape[1]))
    np.testing.assert_allclose(told, PROBE, rtol=1e-4)


def test_what_is_there_is_replaced_only_when_asked_and_only_a_policy(written, flat, flat_fitted, tmp_path):
    before = (written / RECORD).read_bytes()
    with pytest.raises(ArgumentError, match="it is there already"):
        write_policy(flat_fitted, flat, written)
    assert (written / RECORD).read_bytes() == before
    other = flat_learner(random_state=5).fit(flat)
    write_policy(other, flat, written, overwrite=True)
    assert read_policy(written).record["seed"] == 5
    (tmp_path / "mine").mkdir()
    with pytest.raises(ArgumentError, match="it holds no policy"):
        write_policy(flat_fitted, flat, tmp_path / "mine", overwrite=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine", "policy"]


def test_a_failure_on_the_way_leaves_what_was_there(written, flat, flat_fitted, monkeypatch):
    before = (written / RECORD).read_bytes()
    monkeypatch.setattr("halfseen.policies.folder.files.Kind.digests", "no/such/folder")
    with pytest.raises(ArgumentError, match="cannot be written"):
        write_policy(flat_fitted, flat, written, overwrite=True)
    assert (written / RECORD).read_bytes() == before
    assert [path.name for path in written.parent.iterdir()] == ["policy"]


def test_what_a_kill_between_two_renames_left_aside_is_told_of(written, flat, flat_fitted, monkeypatch):
    def killed(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("pathlib.Path.rename", lambda path, to, rename=Path.rename: (rename(path, to), killed()))
    with pytest.raises(KeyboardInterrupt):
        write_policy(flat_fitted, flat, written, overwrite=True)
    monkeypatch.undo()
    (aside,) = written.parent.iterdir()
    assert f"what was there is {aside}: rename it back" in told(written)
    aside.rename(written)
    read_policy(written)


def test_what_no_folder_can_hold_is_refused(flat, flat_fitted, tables, tables_fitted, tmp_path):
    class Mine:
        def probability(self, state):
            return np.full(state.num_objects, 0.5)

    own = copy(tables_fitted)
    own.policy_ = replace(own.policy_, grasp=Mine())
    with pytest.raises(ArgumentError, match="grasp is a Mine"):
        write_policy(own, tables, tmp_path / "policy")
    for factor in (np.nan, 1e38):
        learner = copy(flat_fitted)
        learner.policy_ = replace(flat_fitted.policy_, coefficients=flat_fitted.policy_.coefficients * factor)
        with pytest.raises(PolicyError, match=r"it is finite, and 1e\+30 at most"):
            write_policy(learner, flat, tmp_path / "policy")
    assert list(tmp_path.iterdir()) == []
