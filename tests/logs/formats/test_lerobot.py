"""Datasets of LeRobot as logs."""

import json
import warnings
from functools import partial
from itertools import product

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from foreign import CUT, FINISHED, as_version_2, assert_is, episodes, expected, last_of, times_of, write_lerobot
from halfseen.errors import HalfseenWarning
from halfseen.logs.formats import StepRules, read_lerobot
from refusals import refused

STATE = ["observation.state_0", "observation.state_1"]
YES, NO, NAN = True, False, float("nan")


def read_quietly(folder, rules=None):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HalfseenWarning)
        return read_lerobot(folder, rules)


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
def test_each_ending_is_reported_by_a_feature(tmp_path, columns, rules, endings):
    found = episodes()
    flags = {"next.success": [YES, NO, NO], "next.done": [NO, YES, NO], "ok": [NO, NO, YES]}
    write_lerobot(tmp_path, found, extra={name: last_of(found, flags[name]) for name in columns})
    assert_is(
        read_lerobot(tmp_path, rules), expected(found, endings, times_of(found, 0.1), STATE, has_last=False), 1e-12
    )


@pytest.mark.parametrize(
    ("rules", "ending", "message"),
    [(StepRules(), CUT, r"each was cut \(truncated\)"), (StepRules(truncated="finished"), FINISHED, "each finished")],
)
def test_what_nobody_says_of_endings_is_reported(tmp_path, rules, ending, message):
    found = episodes()
    write_lerobot(tmp_path, found)
    with pytest.warns(HalfseenWarning, match=rf"none of next\.done, .* says how .*{message}"):
        logs = read_lerobot(tmp_path, rules)
    assert_is(logs, expected(found, [ending] * 3, times_of(found, 0.1), STATE, has_last=False), 1e-12)


def test_pictures_and_what_came_of_a_step_are_passed_over_and_reported_and_tasks_are_words(tmp_path):
    found = episodes()
    extra = {"next.terminated": last_of(found, [True] * 3), "task_index": [1, 1, 1, 0, 1, 1, 1, 1]}
    extra |= {"observation.image": [b"png"] * 8, "effort": list(range(8)), "observation.lit": [True, False] * 4}
    pictures = {"observation.image": {"dtype": "image"}, "observation.video": {"dtype": "video"}}
    write_lerobot(tmp_path, found, extra=extra, features=pictures, tasks=["grasp", "place"])
    message = r"left out are observation\.image \(pictures\), effort, observation\.video"
    with pytest.warns(HalfseenWarning, match=message):
        logs = read_lerobot(tmp_path)
    assert sorted(logs.stage_covariates) == ["observation.lit", *STATE, "task"]
    assert logs.stages["task"].tolist() == ["place"] * 3 + ["grasp"] + ["place"] * 4
    assert logs.stages["observation.lit"].tolist() == [True, False] * 4


def test_version_2_is_the_same_log(tmp_path):
    found = episodes(lengths=(3, 1, 4))
    extra = {"next.done": last_of(found, [YES, NO, YES]), "next.truncated": last_of(found, [NO, YES, YES])}
    extra |= {"task_index": [1, 1, 1, 0, 1, 1, 1, 1]}
    for folder in (tmp_path / "new", tmp_path / "old"):
        folder.mkdir()
        write_lerobot(folder, found, extra=extra, tasks=["grasp", "place"])
    old = read_lerobot(as_version_2(tmp_path / "old"))
    assert_is(old, expected(found, [FINISHED, CUT, CUT], times_of(found, 0.1), STATE, has_last=False), 1e-12)
    new = read_lerobot(tmp_path / "new")
    assert old.stages.equals(new.stages)
    assert old.trajectories.equals(new.trajectories)
    noted, first = tmp_path / "old" / "meta" / "episodes.jsonl", tmp_path / "old" / "data" / "chunk-000"
    lines = noted.read_text()
    noted.write_text(lines.replace('"length":3', '"length":"3"'))
    with refused(r"episodes\.jsonl: it is not a complete table \(Expected `int`, got `str`"):
        read_lerobot(tmp_path / "old")
    noted.write_text(lines.splitlines()[0])
    with refused("episode 1: meta/episodes counts 0 frames, but data has 1"):
        read_lerobot(tmp_path / "old")
    noted.write_text(lines)
    (first / "episode_000001.parquet").unlink()
    with refused("episode 1: meta/episodes counts 1 frames, but data has 0"):
        read_lerobot(tmp_path / "old")
    noted.unlink()
    with refused(r"episodes\.jsonl: it is missing; copy the whole dataset again"):
        read_lerobot(tmp_path / "old")


def test_other_columns_are_named_and_a_clock_goes_its_own_way(tmp_path):
    found = episodes(lengths=(3, 2))
    extra = {"next.done": last_of(found, [True, False]), "next.success": [NO, NO, YES, NO, NO]}
    extra |= {"subtask": ["a", "b", "a", "b", "b"], "t": [5.0, 5.5, 7.0, 1.0, 1.25]}
    write_lerobot(tmp_path, found, extra=extra)
    with pytest.warns(HalfseenWarning, match="left out are action, next.reward"):
        logs = read_lerobot(tmp_path, StepRules(action="subtask", reward="next.success", clock="t"))
    assert logs.stages["action"].tolist() == extra["subtask"]
    assert logs.stages["reward"].tolist()[:4] == [0.0, 0.0, 1.0, 0.0]
    np.testing.assert_allclose(logs.elapsed_s(), [[0.5, 2.0, 2.1], [0.25, np.nan, np.nan]])
    np.testing.assert_allclose(logs.end_s, [2.1, 0.35])
    assert read_quietly(tmp_path, StepRules(step_s=2.0)).end_s.tolist() == [6.0, 4.0]


# Endings, by the flags of the last frame in all combinations.

UNKNOWN = ("cut", "unknown")
FLAGS = list(product([False, True], repeat=2))
"""Of the last frame: terminated (or what says so), truncated. As in Gymnasium, what terminated has no future."""
BY_GYMNASIUM = dict(zip(FLAGS, [UNKNOWN, CUT, FINISHED, FINISHED], strict=True))
OF_LEROBOT = dict(zip(FLAGS, [UNKNOWN, CUT, FINISHED, CUT], strict=True))
"""LeRobot's `next.done` is terminated or truncated."""
TRUNCATED = pytest.mark.parametrize("truncated", ["cut", "finished"])


def endings_of(logs):
    return [
        (ending, cause)
        for ending, cause in logs.trajectories[["ending", "cause"]].astype(object).replace({np.nan: None}).to_numpy()
    ]


def wanted(table, truncated):
    """What each combination is, where what was truncated finished, or was cut."""
    return [FINISHED if table[flags] == CUT and truncated == "finished" else table[flags] for flags in FLAGS]


@TRUNCATED
@pytest.mark.parametrize(
    ("own", "table"),
    [("next.done", OF_LEROBOT), ("next.terminated", BY_GYMNASIUM), ("next.success", BY_GYMNASIUM)],
)
@pytest.mark.parametrize("is_named", [False, True])
def test_each_combination_of_lerobot_is_an_ending(tmp_path, own, table, truncated, is_named):
    found = episodes(lengths=(3, 1, 2, 4))
    flags = {own: [one for one, _ in FLAGS], "next.truncated": [two for _, two in FLAGS]}
    write_lerobot(tmp_path, found, extra={name: last_of(found, each) for name, each in flags.items()})
    logs = read_lerobot(tmp_path, StepRules(truncated=truncated, done=own if is_named else None))
    assert endings_of(logs) == wanted(table, truncated)
    # The frame in which an episode was cut has no outcome; a finished one is whole.
    assert logs.stages["reward"].isna().sum() == sum(ending == "cut" for ending, _ in endings_of(logs))


@TRUNCATED
def test_what_terminated_says_goes_before_done(tmp_path, truncated):
    found = episodes(lengths=(3, 1, 2, 4))
    terminated = [True, False, True, False]
    flags = {"next.done": [True] * 4, "next.terminated": terminated, "next.truncated": [False, True, True, False]}
    write_lerobot(tmp_path, found, extra={name: last_of(found, each) for name, each in flags.items()})
    ending = CUT if truncated == "cut" else FINISHED
    assert endings_of(read_lerobot(tmp_path, StepRules(truncated=truncated))) == [FINISHED, ending, FINISHED, UNKNOWN]


def test_done_alone_may_be_a_truncation_and_truncated_alone_no_end(tmp_path):
    found = episodes()
    write_lerobot(tmp_path / "done", found, extra={"next.done": last_of(found, [True] * 3)})
    with pytest.warns(
        HalfseenWarning,
        match=r"every episode ends with next\.done, which LeRobot also sets for "
        "truncated",
    ):
        assert endings_of(read_lerobot(tmp_path / "done")) == [FINISHED] * 3
    write_lerobot(tmp_path / "cut", found, extra={"next.truncated": last_of(found, [True, False, True])})
    assert endings_of(read_lerobot(tmp_path / "cut")) == [CUT, UNKNOWN, CUT]


@pytest.mark.parametrize("flag", ["next.done", "next.terminated", "next.truncated"])
def test_an_episode_that_ends_before_its_last_frame_is_refused(tmp_path, flag):
    found = episodes()
    write_lerobot(tmp_path, found, extra={flag: [False] * 4 + [True] + [False] * 3})
    with refused(r"episode 2: step 1 of 4 ends it; make two episodes of it"):
        read_lerobot(tmp_path)


# What is wrong.


def lerobot_with(folder, **other):
    return partial(read_quietly, write_lerobot(folder, episodes(), **other))


def with_columns(folder, **columns):
    return lerobot_with(folder, extra={name.replace("__", "."): values for name, values in columns.items()})


WRONG = {
    with_columns: [
        ({"action": [[0.5, 0.1]] * 8}, r"action holds .* discretise it"),
        ({"action": [0.5] * 8}, r"action holds float64 .* finitely many"),
        ({"next__reward": ["a"] * 8}, r"row 0: next\.reward is 'a', not a number"),
        ({"next__reward": [[0.0, 1.0]] * 8}, r"next\.reward holds .* not a number"),
        ({"next__reward": [NAN] * 8}, r"trajectory 0, stage 1: .*its reward is nan"),
        ({"observation__state": [[0.1]] * 7 + [[0.1, 0.2]]}, r"row 7: observation\.state has 2 values"),
        ({"observation__state": [[0.1]] * 7 + [None]}, r"row 7: observation\.state has null"),
        ({"observation__state": [0.1] * 7 + [None]}, r"stage 4: covariate observation\.state is null"),
        ({"next__done": [2] * 8}, r"row 0: next\.done is 2, neither true nor false"),
        ({"ok": [True] * 8}, r"episode 0: step 1 of 3 ends it", StepRules(done="ok")),
        ({"episode_index": [0, 0, 1, 0, 2, 2, 2, 2]}, r"frames of episode 0 are not adjacent"),
    ],
    lerobot_with: [
        ({}, r"no 'push' for the action among observation\.state", StepRules(action="push")),
        ({}, r"no 't' for the clock", StepRules(clock="t")),
        ({"lengths": [3, 1, 5]}, r"episode 2: meta/episodes counts 5 frames, but data has 4"),
        ({"lengths": [3, 1, 4, 2]}, r"episode 3: meta/episodes counts 2 frames, but data has 0"),
        ({"info": {"total_frames": 9}}, r"total_frames is 9, but data has 8"),
        ({"info": {"codebase_version": "v1.6"}}, r"codebase_version is 'v1\.6', but only v2 and v3 are read"),
        ({"info": {"fps": 0}}, r"info\.json: it cannot be read .* `\$\.fps`"),
        ({"info": {"features": [1]}}, r"info\.json: it cannot be read .* `\$\.features`"),
        ({"stamps": [0.0, 0.1, 0.9] + [0.0] * 5}, r"frame 2 has the timestamp 0\.9 s, .* it is 0\.2 s"),
        ({"extra": {"task_index": [7] * 8}, "tasks": ["a"]}, r"a frame has task 7, which is not listed"),
    ],
}  # fmt: skip
"""By what writes and reads: what is other, what is said of it, and rules."""


@pytest.mark.parametrize(("make", "case"), [(make, case) for make, cases in WRONG.items() for case in cases])
def test_what_is_wrong_is_reported_in_one_line(tmp_path, make, case):
    other, result, *rules = case
    read = make(tmp_path, **other)
    with refused(result):
        read(*rules)


@pytest.mark.parametrize("values", [[b"0"], [[0]], [{"a": 0}], [0.0], [True], [None]], ids=str)
@pytest.mark.parametrize("file", ["data", "meta/tasks.parquet", "meta/episodes"])
def test_numbers_of_tasks_and_episodes_are_whole_numbers(tmp_path, file, values):
    write_lerobot(tmp_path, episodes(), extra={"task_index": [0] * 8}, tasks=["a"])
    column = "episode_index" if file == "meta/episodes" else "task_index"
    for each in [tmp_path / file] if file.endswith("parquet") else (tmp_path / file).rglob("*.parquet"):
        table = pq.read_table(each)
        other = pa.array(values * table.num_rows, pa.int64() if values == [None] else None)
        pq.write_table(table.set_column(table.column_names.index(column), column, other), each)
    with refused(rf"{file}: {column} holds \S.*or null, not whole numbers; copy the dataset again"):
        read_quietly(tmp_path)


def test_frames_out_of_order_are_refused(tmp_path):
    found = episodes()
    rows = {"frame_index": [1, 0, 2, 0, 0, 1, 2, 3], "next.success": last_of(found, [YES, YES, YES])}
    write_lerobot(tmp_path, found, extra=rows)
    with refused(r"row \d+: frame_index is 0 after 1 in one episode; put the rows in order"):
        read_lerobot(tmp_path, StepRules(step_s=1.0))


def test_an_episode_without_frames_is_none(tmp_path):
    found = episodes()
    write_lerobot(tmp_path, found, lengths=[3, 1, 4, 0], extra={"next.success": last_of(found, [YES] * 3)})
    assert read_lerobot(tmp_path).num_trajectories == 3


def test_a_dataset_that_was_copied_in_part_is_reported(tmp_path):
    write_lerobot(tmp_path, episodes())
    file, info = tmp_path / "data" / "chunk-000" / "file-001.parquet", tmp_path / "meta" / "info.json"
    content, counted = file.read_bytes(), tmp_path / "meta" / "episodes" / "chunk-000" / "file-000.parquet"
    for harm, message in (
        (lambda: file.write_bytes(content[: len(content) // 2]), r"file-001\.parquet: it is not a complete table"),
        (lambda: pq.write_table(pa.table({"other": [1]}), file), r"file-001\.parquet"),
        (file.unlink, "episode 2: meta/episodes counts 4 frames, but data has 0"),
        (counted.unlink, r"there is no chunk-\*/file-\*\.parquet"),
        (lambda: info.write_text(json.dumps([])), "info.json: it cannot be read"),
        (info.unlink, "info.json: it cannot be read"),
    ):
        harm()
        with refused(message):
            read_quietly(tmp_path)
