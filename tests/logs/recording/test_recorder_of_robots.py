"""What several robots do at once is recorded in one clock, and what nobody would read is refused when it is told."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recordings import begin

from halfseen.errors import LogError
from halfseen.logs import LogRecorder, Logs, read_logs


@pytest.fixture
def recorder(tmp_path):
    with LogRecorder(tmp_path / "logs") as recorder:
        yield recorder


def decide(path, robot, target=None):
    action = "WAIT" if target is None else "PICK"
    begin(path, objects=[{"object": k} for k in range(3)], action=action, object=target, robot=robot)


def do(path, robot, target, elapsed_s, reward=0.0):
    decide(path, robot, target)
    path.complete_stage(reward, elapsed_s=elapsed_s)


def test_the_clock_may_stand_even_at_the_beginning_and_one_that_stays_at_0_has_an_end(recorder, tmp_path):
    path = recorder.begin_path()
    for robot, target, elapsed_s in ((0, 0, 0.0), (1, 1, 2.0), (0, 2, 2.0), (1, None, 3.0)):
        do(path, robot, target, elapsed_s)
    path.finish(elapsed_s=3.0)
    path = recorder.begin_path()
    do(path, 0, None, 0.0)
    path.finish(elapsed_s=1000.0)
    logs = read_logs(tmp_path / "logs")
    assert logs.stages["elapsed_s"].tolist() == [0.0, 2.0, 2.0, 3.0, 0.0]
    assert logs.stages["robot"].tolist() == [0, 1, 0, 1, 0]
    assert logs.end_s.tolist() == [3.0, 1000.0]


def test_a_folder_of_several_robots_is_gone_on_with(tmp_path):
    for number in (1, 2):
        with LogRecorder(tmp_path / "logs") as recorder:
            path = recorder.begin_path()
            if number == 2:
                with pytest.raises(LogError, match="path 2, stage 1: robot is missing, unlike in stages before"):
                    decide(path, None, 0)
            do(path, number, 0, 1.0)
            path.finish()
    assert read_logs(tmp_path / "logs").stages["robot"].tolist() == [1, 2]


def test_two_at_one_object_leave_no_trace_and_the_other_goes_on(recorder, tmp_path):
    path = recorder.begin_path()
    do(path, 0, 1, 1.0)
    do(path, 1, 1, 2.0)
    with pytest.raises(LogError, match="path 1, stage 2: robot 1 begins with object 1"):
        decide(path, 0, 2)
    do(path, 1, 2, 3.0)
    path.finish()
    assert read_logs(tmp_path / "logs").stages["robot"].tolist() == [0, 1, 1]


def test_who_drops_out_is_gone_and_the_others_take_what_it_was_at(recorder, tmp_path):
    path = recorder.begin_path()
    do(path, 0, 0, 1.0)
    decide(path, 1, 1)
    path.drop_out(np.int64(0), "battery", elapsed_s=1.5)
    path.complete_stage(0.0, elapsed_s=2.0)
    do(path, 1, 0, 3.0)
    path.finish()
    path = recorder.begin_path()
    decide(path, 0, 0)
    with pytest.raises(LogError, match=r"0_out_s 0\.0 lies outside the path"):
        path.drop_out(0, "battery", elapsed_s=0.0)
    path.complete_stage(0.0, elapsed_s=1.0)
    path.finish()
    ends = read_logs(tmp_path / "logs").paths
    assert ends[["0_out_s", "0_out_cause"]].values.tolist()[0] == [1.5, "battery"]
    assert ends["0_out_s"].isna().tolist() == [False, True]


def test_a_cut_between_stages_takes_back_all_that_was_completed_just_then(recorder, tmp_path):
    path = recorder.begin_path()
    do(path, 0, 0, 1.0, reward=5.0)
    do(path, 1, 1, 2.0)
    do(path, 0, 2, 2.0)
    decide(path, 1)
    path.drop_out(0, "battery", elapsed_s=2.0)
    path.complete_stage(0.0, elapsed_s=2.0)
    path.cut("operator", elapsed_s=2.5)
    logs = read_logs(tmp_path / "logs")
    assert logs.end_s.tolist() == [np.nextafter(2.0, 0.0)]
    assert logs.stages["reward"].tolist()[:1] == [5.0]
    assert logs.stages["elapsed_s"].isna().tolist() == [False, True]
    assert logs.objects["stage"].max() == 2
    assert "0_out_s" not in logs.paths


def test_on_its_own_clock_a_drop_out_has_its_time(tmp_path, monkeypatch):
    now_s = [50.0]
    monkeypatch.setattr("halfseen.logs.journal.clock.time.monotonic", lambda: now_s[0])
    with LogRecorder(tmp_path / "logs") as recorder:
        path = recorder.begin_path()
        decide(path, 0, 0)
        now_s[0] += 2.0
        path.drop_out(1, "e-stop")
        now_s[0] += 1.0
        path.complete_stage(1.0)
        path.finish()
    logs = read_logs(tmp_path / "logs")
    assert logs.paths[["1_out_s", "end_s"]].values.tolist() == [[2.0, pytest.approx(3.0)]]


DECISIONS = st.lists(
    st.tuples(st.integers(0, 2), st.sampled_from([None, 0, 1, 2]), st.sampled_from([0.0, 1.0, 2.0])), max_size=9
)


def logs_of(decisions, ending):
    """As `Logs` takes them; the last stage of a path that is cut is not completed."""
    num, clock = len(decisions), np.cumsum([length for *_, length in decisions]).tolist()
    elapsed_s = [*clock[:-1], None] if ending == "cut" else clock
    stages = {"path": [1] * num, "stage": np.arange(1, num + 1), "x": [1.0] * num, "robot": [r for r, *_ in decisions]}
    stages |= {"elapsed_s": elapsed_s, "reward": [None if each is None else 0.0 for each in elapsed_s]}
    stages |= {"action": ["WAIT" if target is None else "PICK" for _, target, _ in decisions]}
    stages |= {"object": [target for _, target, _ in decisions]}
    rows = [(1, stage + 1, k) for stage in range(num) for k in range(3)]
    objects = dict(zip(("path", "stage", "object"), zip(*rows, strict=True), strict=True))
    return Logs(stages, {"path": [1], "end_s": [clock[-1] + 1.0], "ending": [ending]}, objects)


@settings(max_examples=20)
@given(DECISIONS)
def test_a_stage_is_refused_where_the_log_with_it_would_not_be_read(tmp_path_factory, decisions):
    folder, taken = tmp_path_factory.mktemp("robots") / "logs", []
    with LogRecorder(folder) as recorder:
        path = recorder.begin_path(1)
        for robot, target, length in decisions:
            try:
                logs_of([*taken, (robot, target, length)], "cut")
            except LogError as told:
                with pytest.raises(LogError, match=re.escape(str(told))):
                    decide(path, robot, target)
                continue
            taken.append((robot, target, length))
            do(path, robot, target, sum(each for *_, each in taken))
        if not taken:
            path.cut("operator")
            return
        path.finish(elapsed_s=sum(each for *_, each in taken) + 1.0)
    found, wanted = read_logs(folder), logs_of(taken, "finished")
    for name in ("robot", "elapsed_s", "action"):
        assert found.stages[name].tolist() == wanted.stages[name].tolist()
    assert found.stages["object"].isna().tolist() == wanted.stages["object"].isna().tolist()
    assert found.end_s.tolist() == wanted.end_s.tolist()
