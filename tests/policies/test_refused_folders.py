"""Folders of policies that another program changed, or that could not be written, are refused in one line."""

import contextlib
import json
from copy import copy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from policy_folders import (
    FILES,
    FLAT,
    arrays,
    content,
    number,
    of_colours,
    of_ranges,
    of_record,
    of_schema,
    record,
    refusal,
    sign,
)

from halfseen.errors import ArgumentError, PolicyError
from halfseen.policies.folder import read_policy, write_policy
from halfseen.policies.folder.files import ARRAYS, RECORD
from halfseen.policies.folder.stored import kind_named
from halfseen.world import UniformPolicy


@pytest.mark.slow
@pytest.mark.parametrize("name", FILES)
def test_any_byte_changed_or_cut_off_is_noticed(written, name):
    whole, rng = (written / name).read_bytes(), np.random.default_rng(0)
    for position in {0, len(whole) - 1, *rng.integers(0, len(whole), 50).tolist()}:
        changed = bytearray(whole)
        changed[position] ^= 1 << int(rng.integers(8))
        (written / name).write_bytes(changed)
        assert "it was changed after it was written" in refusal(written)
    for keep in (0, 10):
        (written / name).write_bytes(whole[:keep])
        assert "it was changed after it was written" in refusal(written)
    (written / name).unlink()
    assert f"{written / name}: it is missing" in refusal(written)
    (written / name).write_bytes(whole)
    read_policy(written)


def test_no_folder_and_a_folder_of_something_else_are_refused(tmp_path):
    (tmp_path / "file").write_text("x")
    for name in ("none", "file"):
        assert "no such folder" in refusal(tmp_path / name)
    assert "policy.json: it is missing" in refusal(tmp_path)


def of_alone(robot, **changed):
    return record(lambda r: r["schema"]["alone"][robot].update(changed))


def of_features(**changed):
    return record(lambda r: r["schema"]["features"].update(changed))


def of_laws(**changed):
    return record(lambda r: r["schema"]["laws"].update(changed))


def of_seeing(**changed):
    return record(lambda r: r["schema"]["laws"]["seeing"].update(changed))


def array(name, change):
    return arrays(lambda a: a.update({name: change(a.get(name))}))


REFUSED = {
    "flat": [
        (of_record(version=1), "version 1 is not the 2 that halfseen"),
        (of_record(format="pickle"), "does not describe a policy"),
        (of_record(kind="tree"), "kind is 'tree'; it must be one of flat, table, table-laws, team, team-laws"),
        (record(lambda r: r.pop("seen")), "seen is None: Object missing required field"),
        (of_ranges(x1=[2.0, 1.0]), "ends before it begins"),
        (
            record(lambda r: r["seen"][0]["ranges"].pop("x1")),
            "seen does not give the range of x1, x2 in the log, but of x2",
        ),
        (of_ranges(x1=[np.nan, 1.0]), "NaN is not a JSON number"),
        (record(lambda r: r.pop("schema")), "schema is None"),
        (of_schema(horizon=True), "horizon is True"),
        (of_schema(horizon=3), "possible is"),
        (of_schema(covariates=["x1"]), "'coefficients' is float64 of shape [2, 3, 3]"),
        (of_schema(covariates=["x1", "x1"]), "names must differ"),
        (of_schema(actions=["A", "B", 0.5]), "actions[2] is 0.5: Expected `int | str`, got `float`"),
        (record(lambda r: r["schema"]["possible"][1].append("D")), "possible is"),
        (of_record(kind="table"), "looks at features None"),
        (of_record(stages_left=[0.5]), "stages_left[0] is 0.5: Expected `float` >= 1.0"),
        (of_record(stages_left=["2"]), "stages_left[0] is '2': Expected `float`, got `str`"),
        (of_record(reward_spread=-1.0), "reward_spread is -1.0"),
        (of_record(reward_spread="wide"), "reward_spread is 'wide': Expected `float`"),
        (of_record(verdict={"verdict": "better"}), "verdict.reason is None: Object missing required field"),
        (of_record(verdict="better"), "verdict is 'better': Expected `object | null`"),
        (of_record(warnings=[3]), "warnings[0] is 3: Expected `str`"),
        *((content(RECORD, text), RECORD) for text in (b"", b"[1]", b"{", b"\xff", b"[" * 100_000)),
        (content(ARRAYS, b"\x80\x04." + bytes(40)), "it is not a safetensors file"),
        (number("coefficients", (1, 2, 0), np.nan), "'coefficients' holds nan at [1, 2, 0]"),
        (number("coefficients", (1, 2, 0), np.inf), "'coefficients' holds inf at [1, 2, 0]"),
        (arrays(lambda a: a.pop("coefficients")), "'coefficients' is missing"),
        (array("coefficients", lambda a: a.astype(np.float32)), "is float32"),
        (array("coefficients", lambda a: a[:1]), "of shape [1, 3, 3]"),
        (array("more", lambda _: np.zeros(2)), "'more' is unknown"),
        (array("grasp.chances", lambda _: np.zeros((3, 2, 2))), "'grasp.chances' is unknown"),
        (array("kernel.centre", lambda _: np.zeros(2)), "'kernel.projection' is missing"),
        (array("behaviour", lambda _: np.zeros((3, 2))), "the schema needs float64 of shape [3, 3]"),
    ],
    "text": [
        (of_schema(categories={"size": ["L", "S"]}), "categories are of size; each must be of a covariate"),
        (of_schema(categories=["colour"]), "categories is ['colour']: Expected `object`, got `array`"),
        (of_colours("red", "red"), "colour is ['red', 'red']"),
        (of_colours(1, 2, 3), "categories is {'colour': [1, 2, 3]}: Expected `str`, got `int`"),
        (of_colours("red", "blue"), "array 'coefficients' is float64 of shape"),
        (of_ranges(colour={"red": 0}), "seen[0]: colour is {'red': 0}; a count is below 1"),
    ],
    "tables": [
        (of_features(version=0), "the policy looks at features"),
        (of_schema(least_rewards={"PUSH": -1.0}), "least_rewards is {'PUSH': -1.0}"),
        *((of_schema(seen=seen), "seen") for seen in ("WASH", [["WASH"]], [[]] * 3, [["PUSH"]] * 3)),
        *((of_schema(seen=seen), "seen[") for seen in ([[["WASH"]]] * 3, [["WASH"], "LIFT", ["LIFT"]])),
    ],
    "laws": [
        (of_features(version=0), "the policy looks at features"),
        (of_schema(basis="hope"), "basis is 'hope'; it must be model or rule"),
        (of_schema(seen=["PUSH"]), "seen is ['PUSH']; it must list verbs of FINISH, WASH, LIFT"),
        (of_schema(horizon=4), "horizon is 4, but 3 in the laws"),
        (record(lambda r: r["schema"].pop("laws")), "laws is None: Object missing required field"),
        (of_laws(transport_s="1"), "transport_s is '1': Expected `float`, got `str`"),
        (of_laws(horizon=0.5), "laws.horizon is 0.5: Expected `int`, got `float`"),
        (of_laws(seeing=None), "laws.seeing is None: Expected `object`, got `null`"),
        (
            of_seeing(family="magic"),
            "laws.seeing.family is 'magic'; it must be one of independent, persistent",
        ),
        (of_seeing(more=1.0), "Object contains unknown field `more`"),
        (of_seeing(floor=[0.5]), "laws.seeing.floor is [0.5]: Expected `float`, got `array`"),
        (of_schema(dirty_share=1.0), "dirty_share is 1.0"),
        (arrays(lambda a: a.pop("excess.low")), "array 'excess.low' is missing"),
        (array("excess.high", lambda a: a[:1]), "needs float32 of shape [3, 2]"),
        (number("excess.coefficients", (1, 0, 3), np.nan), "'excess.coefficients' holds nan at [1, 0, 3]"),
        (array("mending.recorded", lambda _: np.float32([0.0, 1.0])), "array 'mending."),
        (
            arrays(lambda a: a.update({f"mending.{name}": np.float32([1.0, 0.0]) for name in ("recorded", "mended")})),
            "mending.recorded and mending.mended must rise",
        ),
        (of_schema(basis="rule"), "array 'excess.coefficients' is unknown"),
    ],
    "team": [
        (of_record(version=1), "version 1 is not the 2 that halfseen"),
        (record(lambda r: r["schema"].pop("num_robots")), "num_robots is None: Object missing required field"),
        (of_schema(num_robots="two"), "num_robots is 'two': Expected `int`, got `str`"),
        (of_schema(num_robots=True), "num_robots is True: Expected `int`, got `bool`"),
        (of_schema(num_robots=0), "num_robots is 0, and horizon 6"),
        (of_schema(num_robots=4), "num_robots is 4, and horizon 6"),
        (
            record(lambda r: (r["schema"].update(horizon=8), r["schema"].pop("seen"))),
            "needs float32 of shape [8, 1, ",
        ),
        (of_features(version=0), "the policy looks at features {'of': 'team', 'version': 0"),
        (of_schema(actions=["FINISH"]), "the policy looks at features"),
        (of_schema(seen=[["WASH"]]), "seen is"),
        (record(lambda r: r["schema"]["seen"][0].append("PUSH")), "seen is"),
        (of_record(seen=[{}]), "seen[0].stages is None: Object missing required field"),
        (of_record(kind="table"), "the policy looks at features"),
        (record(lambda r: r["schema"]["alone"].pop()), "it must describe each of 2 robots"),
        (of_alone(0, horizon=4), "it must list verbs for each number of steps to go"),
        (of_alone(1, features={}), "the policy looks at features {}"),
        (arrays(lambda a: a.pop("coefficients")), "'coefficients' is missing"),
        (array("coefficients", lambda a: a.astype(np.float64)), "is float64"),
        (array("coefficients", lambda a: a[:, :, 1:]), "of shape [6, 1, "),
        (number("coefficients", (1, 0, 3), np.nan), "'coefficients' holds nan at [1, 0, 3]"),
        (number("alone.0.margin", (2, 0, 0, 2), np.inf), "'margin' holds inf at [2, 0, 0, 2]"),
        (array("alone.0.margin", lambda a: a[..., 1:]), "array 'margin' is float32 of shape"),
        (array("alone.1.behaviour", lambda a: a[:, 1:]), "array 'behaviour' is float32 of shape"),
        (array("more", lambda _: np.zeros(2, dtype=np.float32)), "'more' is unknown"),
        (arrays(lambda a: a.pop("alone.1.coefficients")), "array 'coefficients' is missing"),
        (array("alone.2.coefficients", lambda _: np.zeros((6, 1, 9), np.float32)), "belongs to no robot"),
        (array("caution", lambda _: np.float32([1.0, 2.0])), "caution is [1.0, 2.0]"),
        (array("caution", lambda _: np.array(-1.0, np.float32)), "caution is -1.0"),
    ],
}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "edit", "message"), [(kind, *case) for kind, cases in REFUSED.items() for case in cases]
)
def test_what_does_not_fit_is_refused(copied, kind, edit, message):
    folder = copied(kind)
    edit(folder)
    assert message in refusal(folder)


def places(of, at=()):
    """Places in a record, as the keys that lead to them: of a list, in which all are alike, the first and the last."""
    keys = of if isinstance(of, dict) else {0, len(of) - 1} if isinstance(of, list) and of else ()
    return [place for key in keys for place in [(*at, key), *places(of[key], (*at, key))]]


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["flat", "laws"])
def test_nonsense_anywhere_in_the_schema_is_refused_or_harmless(copied, kind):
    """No other error than a PolicyError comes of it, whatever stands where."""
    written = copied(kind)
    whole = (written / RECORD).read_text()
    wanted = [
        place for place in places(json.loads(whole)) if place[0] not in ("learner", "diagnostics", "log", "versions")
    ]
    for place in wanted:
        for nonsense in (None, -1, "x", [None], 10**400):
            parent = of = json.loads(whole)
            for key in place[:-1]:
                parent = parent[key]
            parent[place[-1]] = nonsense
            sign(written, RECORD, json.dumps(of).encode())
            with contextlib.suppress(PolicyError):
                read_policy(written).ranges(2)


def test_what_is_there_is_replaced_only_when_asked_and_only_a_policy(written, logs, fitted, tmp_path):
    flat, before = logs["flat"], (written / RECORD).read_bytes()
    with pytest.raises(ArgumentError, match="it already exists"):
        write_policy(fitted["flat"], flat, written)
    assert (written / RECORD).read_bytes() == before
    write_policy(FLAT(random_state=5).fit(flat), flat, written, overwrite=True)
    assert read_policy(written).record["seed"] == 5
    (tmp_path / "mine").mkdir()
    with pytest.raises(ArgumentError, match="it holds no policy"):
        write_policy(fitted["flat"], flat, tmp_path / "mine", overwrite=True)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine", "policy"]
    # A folder is replaced as a whole.
    (written / "journal.jsonl").write_text("recorded")
    with pytest.raises(ArgumentError, match=r"it also holds a recorded log, journal\.jsonl, which would be lost"):
        write_policy(fitted["flat"], flat, written, overwrite=True)
    assert (written / "journal.jsonl").read_text() == "recorded"


def test_a_failure_on_the_way_leaves_what_was_there(written, logs, fitted, monkeypatch):
    before = (written / RECORD).read_bytes()
    monkeypatch.setattr("halfseen.policies.folder.files.FolderKind.digests", "no/such/folder")
    with pytest.raises(ArgumentError, match="cannot be written"):
        write_policy(fitted["flat"], logs["flat"], written, overwrite=True)
    assert (written / RECORD).read_bytes() == before
    assert [path.name for path in written.parent.iterdir()] == ["policy"]


def test_what_a_kill_between_two_renames_left_aside_is_reported_of(written, logs, fitted, monkeypatch):
    def killed(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr("pathlib.Path.rename", lambda path, to, rename=Path.rename: (rename(path, to), killed()))
    with pytest.raises(KeyboardInterrupt):
        write_policy(fitted["flat"], logs["flat"], written, overwrite=True)
    monkeypatch.undo()
    (aside,) = written.parent.iterdir()
    assert f"the previous folder is {aside}: rename it back" in refusal(written)
    aside.rename(written)
    read_policy(written)


def test_what_no_folder_can_hold_is_refused(logs, fitted, tmp_path):
    class Mine:
        def probability(self, state):
            return np.full(state.num_objects, 0.5)

    def write(kind, **changed):
        learner = copy(fitted[kind])
        learner.policy_ = replace(learner.policy_, **changed)
        write_policy(learner, logs[kind], tmp_path / "policy")

    with pytest.raises(ArgumentError, match="grasp is a Mine"):
        write("tables", grasp=Mine())
    with pytest.raises(PolicyError, match=r"it must be finite and at most 1e\+30"):
        write("flat", coefficients=fitted["flat"].policy_.coefficients * 1e38)
    with pytest.raises(PolicyError, match=r"it must be finite and at most 1e\+30"):
        write("tables", coefficients=fitted["tables"].policy_.coefficients * np.nan)
    with pytest.raises(ArgumentError, match="base is a UniformPolicy, whose code a folder cannot hold"):
        write("team", base=UniformPolicy())
    with pytest.raises(ArgumentError, match="num_robots is None; learn with"):
        kind_named("team").schema(replace(fitted["team"].policy_, num_robots=None))
    assert list(tmp_path.iterdir()) == []
