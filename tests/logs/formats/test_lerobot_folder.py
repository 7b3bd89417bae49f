import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from foreign import assert_is, episodes, expected, last_of, write_lerobot

from halfseen.errors import ArgumentError, HalfseenError, HalfseenWarning, LogError
from halfseen.logs.formats import StepRules, read_lerobot

STATE = ["observation.state_0", "observation.state_1"]
CUT, FINISHED = ("cut", "truncated"), ("finished", None)


def frames(found, fps):
    """Ends of the frames of each episode."""
    return [[(k + 1) / fps for k in range(len(each["actions"]))] for each in found]


@pytest.mark.parametrize("fps", [10, 29.97, 0.5])
@pytest.mark.parametrize("is_text", [False, True])
def test_episodes_are_paths_and_frames_are_stages(tmp_path, fps, is_text):
    found = episodes(is_text=is_text)
    write_lerobot(tmp_path, found, fps=fps, extra={"next.done": last_of(found, [True, False, True])})
    logs = read_lerobot(tmp_path)
    assert_is(logs, expected(found, [FINISHED, CUT, FINISHED], frames(found, fps), STATE, has_last=False), rtol=1e-12)


@pytest.mark.parametrize(
    ("columns", "rules", "endings"),
    [
        (["next.success"], StepRules(), [FINISHED, CUT, CUT]),
        (["next.done"], StepRules(), [CUT, FINISHED, CUT]),
        (["next.success", "next.done"], StepRules(), [FINISHED, FINISHED, CUT]),
        (["next.success", "next.done"], StepRules(done="next.success"), [FINISHED, CUT, CUT]),
        (["next.done"], StepRules(truncated="finished"), [FINISHED, FINISHED, FINISHED]),
        (["ok"], StepRules(done="ok"), [CUT, CUT, FINISHED]),
    ],
)
def test_each_ending_is_told_by_a_feature(tmp_path, columns, rules, endings):
    found = episodes()
    flags = {"next.success": [True, False, False], "next.done": [False, True, False], "ok": [False, False, True]}
    write_lerobot(tmp_path, found, extra={name: last_of(found, flags[name]) for name in columns})
    assert_is(read_lerobot(tmp_path, rules), expected(found, endings, frames(found, 10), STATE, has_last=False), 1e-12)


@pytest.mark.parametrize(
    ("rules", "ending", "told"),
    [(StepRules(), CUT, r"each was cut \(truncated\)"), (StepRules(truncated="finished"), FINISHED, "each finished")],
)
def test_what_nobody_says_of_endings_is_told(tmp_path, rules, ending, told):
    found = episodes()
    write_lerobot(tmp_path, found)
    with pytest.warns(HalfseenWarning, match=rf"neither next\.done nor next\.success says .*{told}"):
        logs = read_lerobot(tmp_path, rules)
    assert_is(logs, expected(found, [ending] * 3, frames(found, 10), STATE, has_last=False), 1e-12)


def test_pictures_and_what_came_of_a_step_are_passed_over_and_told_and_tasks_are_words(tmp_path):
    found = episodes()
    done = last_of(found, [True] * 3)
    extra = {
        "next.done": done,
        "task_index": [1, 1, 1, 0, 1, 1, 1, 1],
        "observation.image": [b"png"] * 8,
        "effort": list(range(8)),
        "observation.lit": [True, False] * 4,
    }
    pictures = {"observation.image": {"dtype": "image"}, "observation.video": {"dtype": "video"}}
    write_lerobot(tmp_path, found, extra=extra, features=pictures, tasks=["grasp", "place"])
    with pytest.warns(
        HalfseenWarning, match=r"left out are observation\.image \(pictures\), effort, observation\.video"
    ):
        logs = read_lerobot(tmp_path)
    assert sorted(logs.stage_covariates) == ["observation.lit", *STATE, "task"]
    assert logs.stages["task"].tolist() == ["place"] * 3 + ["grasp"] + ["place"] * 4
    assert logs.stages["observation.lit"].tolist() == [True, False] * 4


def test_other_columns_are_named_and_a_clock_goes_its_own_way(tmp_path):
    found = episodes(lengths=(3, 2))
    times = [5.0, 5.5, 7.0, 1.0, 1.25]
    extra = {
        "next.done": last_of(found, [True, False]),
        "subtask": ["a", "b", "a", "b", "b"],
        "next.success": [False, False, True, False, False],
        "t": times,
    }
    write_lerobot(tmp_path, found, extra=extra)
    with pytest.warns(HalfseenWarning, match="left out are action, next.reward"):
        logs = read_lerobot(tmp_path, StepRules(action="subtask", reward="next.success", clock="t"))
    assert logs.stages["action"].tolist() == extra["subtask"]
    assert logs.stages["reward"].tolist()[:4] == [0.0, 0.0, 1.0, 0.0]
    np.testing.assert_allclose(logs.elapsed_s(), [[0.5, 2.0, 2.1], [0.25, np.nan, np.nan]])
    np.testing.assert_allclose(logs.end_s, [2.1, 0.35])
    paced = read_quietly(tmp_path, StepRules(step_s=2.0))
    assert paced.end_s.tolist() == [6.0, 4.0]


def read_quietly(folder, rules=None):
    import warnings

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HalfseenWarning)
        return read_lerobot(folder, rules)


def refused(folder, told, rules=None, kind=HalfseenError):
    with pytest.raises(kind, match=told) as caught:
        read_quietly(folder, rules)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("change", "rules", "told"),
    [
        ({"extra": {"action": [[0.5, 0.1]] * 8}}, None, r"action holds .* discretise it"),
        ({"extra": {"action": [0.5] * 8}}, None, r"action holds float64 .* finitely many"),
        ({}, StepRules(action="push"), r"no 'push' for the action among observation\.state"),
        ({"extra": {"next.reward": ["a"] * 8}}, None, r"next\.reward holds object .* not a number"),
        ({"extra": {"next.reward": [[0.0, 1.0]] * 8}}, None, r"next\.reward holds .* not a number"),
        ({"extra": {"next.reward": [float("nan")] * 8}}, None, r"path 0, stage 1: .*its reward is nan"),
        ({"extra": {"observation.state": [[0.1]] * 7 + [[0.1, 0.2]]}}, None, r"row 7: observation\.state has 2 values"),
        ({"extra": {"observation.state": [[0.1]] * 7 + [None]}}, None, r"row 7: observation\.state has null"),
        ({"extra": {"observation.state": [0.1] * 7 + [None]}}, None, r"stage 4: covariate observation\.state is null"),
        ({"extra": {"next.done": [2] * 8}}, None, r"row 0: next\.done is 2, neither true nor false"),
        ({"extra": {"ok": [True] * 8}}, StepRules(done="ok"), r"episode 0: step 1 of 3 ends it"),
        ({"extra": {"episode_index": [0, 0, 1, 0, 2, 2, 2, 2]}}, None, r"frames of episode 0 do not stand together"),
        ({"lengths": [3, 1, 5]}, None, r"episode 2: meta/episodes counts 5 frames, and data has 4"),
        ({"lengths": [3, 1, 4, 2]}, None, r"episode 3: meta/episodes counts 2 frames, and data has 0"),
        ({"info": {"total_frames": 9}}, None, r"total_frames is 9, and data has 8"),
        ({"info": {"codebase_version": "v2.1"}}, None, r"codebase_version is 'v2\.1', and v3 is read"),
        ({"info": {"fps": 0}}, None, r"fps is 0, no number of frames"),
        ({"info": {"features": [1]}}, None, r"features does not describe"),
        ({"stamps": [0.0, 0.1, 0.9] + [0.0] * 5}, None, r"frame 2 has the timestamp 0\.9 s, .* it is 0\.2 s"),
        ({"extra": {"task_index": [7] * 8}, "tasks": ["a"]}, None, r"there is no task 7"),
        ({}, StepRules(clock="t"), r"no 't' for the clock"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told_in_one_line(tmp_path, change, rules, told):
    write_lerobot(tmp_path, episodes(), **change)
    refused(tmp_path, told, rules)


def test_a_dataset_that_was_copied_in_part_is_told(tmp_path):
    write_lerobot(tmp_path, episodes())
    file = tmp_path / "data" / "chunk-000" / "file-001.parquet"
    content = file.read_bytes()
    file.write_bytes(content[: len(content) // 2])
    refused(tmp_path, r"file-001\.parquet: it is no whole table")
    pq.write_table(pa.table({"other": [1]}), file)
    refused(tmp_path, r"file-001\.parquet")
    file.unlink()
    refused(tmp_path, "episode 2: meta/episodes counts 4 frames, and data has 0")
    (tmp_path / "meta" / "episodes" / "chunk-000" / "file-000.parquet").unlink()
    refused(tmp_path, r"there is no chunk-\*/file-\*\.parquet", kind=LogError)
    (tmp_path / "meta" / "info.json").write_text(json.dumps([]))
    refused(tmp_path, "codebase_version is null")
    (tmp_path / "meta" / "info.json").unlink()
    refused(tmp_path, "info.json: it cannot be read")


def test_rules_that_contradict_one_another_are_refused():
    for wrong in ({"step_s": 0.0}, {"step_s": float("nan")}, {"step_s": 1.0, "clock": "t"}, {"truncated": "maybe"}):
        with pytest.raises(ArgumentError):
            StepRules(**wrong)
