"""What several robots do at once is recorded in one clock, and what nobody would read is refused when it is told."""

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from halfseen.errors import LogError
from halfseen.logs import LogRecorder, Logs, read_logs


@pytest.fixture
def recorder(tmp_path):
    with LogRecorder(tmp_path / "logs") as recorder:
        yield recorder


def begin(path, robot, target=None, **other):
    path.begin_stage(
        {"x": 0.0},
        [{"object": k} for k in range(3)],
        "WAIT" if target is None else "PICK",
        target,
        **other,
        robot=robot,
    )


def do(path, robot, target, elapsed_s, reward=0.0):
    begin(path, robot, target)
    path.complete_stage(reward, elapsed_s=elapsed_s)


def test_the_clock_of_several_robots_may_stand_and_never_falls(recorder, tmp_path):
    path = recorder.begin_path()
    do(path, 0, 0, 0.0)
    do(path, 1, 1, 2.0)
    do(path, 0, 2, 2.0)
    begin(path, 1)
    with pytest.raises(LogError, match=r"stage 4: elapsed_s 1\.5 is before the 2\.0 of the event before"):
        path.complete_stage(0.0, elapsed_s=1.5)
    path.complete_stage(1.0, elapsed_s=3.0)
    path.finish(elapsed_s=3.0)
    logs = read_logs(tmp_path / "logs")
    assert logs.stages["elapsed_s"].tolist() == [0.0, 2.0, 2.0, 3.0]
    assert logs.stages["robot"].tolist() == [0, 1, 0, 1]


def test_that_of_one_robot_still_rises(recorder):
    path = recorder.begin_path()
    begin(path, None)
    with pytest.raises(LogError, match=r"elapsed_s 0\.0 is still the 0\.0 of the event before"):
        path.complete_stage(0.0, elapsed_s=0.0)


def test_a_path_whose_only_clock_stands_at_0_has_an_end(recorder, tmp_path):
    path = recorder.begin_path()
    do(path, 0, None, 0.0)
    path.finish(elapsed_s=1000.0)
    assert read_logs(tmp_path / "logs").end_s.tolist() == [1000.0]


def test_robot_is_given_always_or_never(recorder):
    path = recorder.begin_path()
    do(path, 0, 0, 1.0)
    with pytest.raises(LogError, match="stage 2: robot is missing, unlike in stages before"):
        begin(path, None, 1)
    with pytest.raises(LogError, match="robot 'left' is a text, those before are number"):
        begin(path, "left", 1)
    with pytest.raises(LogError, match="'robot' is a name of the log's own"):
        path.begin_stage({"x": 0.0, "robot": 1}, action="PICK")


def test_a_folder_of_several_robots_is_gone_on_with(tmp_path):
    for number in (1, 2):
        with LogRecorder(tmp_path / "logs") as recorder:
            path = recorder.begin_path()
            if number == 2:
                with pytest.raises(LogError, match="path 2, stage 1: robot is missing, unlike in stages before"):
                    begin(path, None, 0)
            do(path, number, 0, 1.0)
            path.finish()
    assert read_logs(tmp_path / "logs").stages["robot"].tolist() == [1, 2]


def test_two_at_one_object_are_refused_as_soon_as_it_is_told(recorder, tmp_path):
    path = recorder.begin_path()
    do(path, 0, 1, 1.0)
    do(path, 1, 1, 2.0)
    told = r"path 1, stage 2: robot 1 begins with object 1, which robot 0 is at since stage 1; mend robot or object"
    with pytest.raises(LogError, match=told):
        begin(path, 0, 2)
    # It leaves no trace, and the other robot goes on.
    do(path, 1, 2, 3.0)
    path.finish()
    assert read_logs(tmp_path / "logs").stages["robot"].tolist() == [0, 1, 1]


def test_who_drops_out_is_gone_and_the_others_go_on(recorder, tmp_path):
    path = recorder.begin_path()
    do(path, 0, 0, 1.0)
    begin(path, 1, 1)
    path.drop_out(np.int64(0), "battery", elapsed_s=1.5)
    with pytest.raises(LogError, match="robot 0 has dropped out before"):
        path.drop_out(0, "battery", elapsed_s=1.7)
    with pytest.raises(LogError, match=r"stage 2: elapsed_s 1\.2 is before the 1\.5 of the event before"):
        path.complete_stage(0.0, elapsed_s=1.2)
    path.complete_stage(0.0, elapsed_s=2.0)
    with pytest.raises(LogError, match=r"stage 3: robot 0 decides at 2\.0 s, yet dropped out at 1\.5 s"):
        begin(path, 0, 2)
    # What it was at was put back.
    do(path, 1, 0, 3.0)
    path.finish()
    ends = read_logs(tmp_path / "logs").paths
    assert ends[["0_out_s", "0_out_cause"]].values.tolist() == [[1.5, "battery"]]


def test_drop_outs_that_no_log_takes_are_refused(recorder, tmp_path):
    path = recorder.begin_path()
    with pytest.raises(LogError, match="no robot has decided yet"):
        path.drop_out(0, "battery")
    begin(path, 0, 0)
    for robot in (-1, True, "left", 0.5):
        with pytest.raises(LogError, match="is no number of one"):
            path.drop_out(robot, "battery", elapsed_s=1.0)
    with pytest.raises(LogError, match="is no cause"):
        path.drop_out(1, "", elapsed_s=1.0)
    with pytest.raises(LogError, match=r"0_out_s 0\.0 lies outside the path"):
        path.drop_out(0, "battery", elapsed_s=0.0)
    path.complete_stage(0.0, elapsed_s=1.0)
    path.finish()
    assert "0_out_s" not in read_logs(tmp_path / "logs").paths


def test_a_drop_out_of_one_robots_log_is_refused(recorder):
    path = recorder.begin_path()
    begin(path, None, 0)
    with pytest.raises(LogError, match="begin_stage\\(\\) with its robot first"):
        path.drop_out(0, "battery")


def test_a_cut_between_stages_takes_back_all_that_was_completed_just_then(recorder, tmp_path):
    path = recorder.begin_path()
    do(path, 0, 0, 1.0, reward=5.0)
    do(path, 1, 1, 2.0)
    do(path, 0, 2, 2.0)
    begin(path, 1)
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
        begin(path, 0, 0)
        now_s[0] += 2.0
        path.drop_out(1, "e-stop")
        now_s[0] += 1.0
        path.complete_stage(1.0)
        path.finish()
    logs = read_logs(tmp_path / "logs")
    assert logs.paths[["1_out_s", "end_s"]].values.tolist() == [[2.0, pytest.approx(3.0)]]


def test_what_else_is_wrong_is_told_by_whoever_asked_to_be_asked(tmp_path):
    seen = []

    def check(logs):
        seen.append(logs)
        if logs.stages["action"].eq("DANCE").any():
            raise LogError("nobody dances here")

    with LogRecorder(tmp_path / "logs", check=check) as recorder:
        path = recorder.begin_path("monday", speed=2.0)
        path.begin_stage({"x": 0.5}, action="A", probability=0.5)
        path.complete_stage(1.0, elapsed_s=2.0)
        with pytest.raises(LogError, match="nobody dances here"):
            path.begin_stage({"x": 0.5}, action="DANCE", probability=0.5)
        path.begin_stage({"x": 0.25}, action="B", probability=0.25)
        path.cut("operator", elapsed_s=3.0)
    assert [len(each.stages) for each in seen] == [1, 2, 2]
    last, whole = seen[-1], read_logs(tmp_path / "logs")
    assert last.stages.equals(whole.stages)
    assert last.paths["speed"].tolist() == [2.0]


DECISIONS = st.lists(
    st.tuples(st.integers(0, 2), st.sampled_from([None, 0, 1, 2]), st.sampled_from([0.0, 1.0, 2.0])), max_size=9
)


def tables_of(decisions, ending):
    """As `Logs` takes them; the last stage of a path that is cut is not completed."""
    num, clock = len(decisions), np.cumsum([length for *_, length in decisions])
    is_cut = ending == "cut"
    stages = {"path": [1] * num, "stage": np.arange(1, num + 1), "x": [0.0] * num, "robot": [r for r, *_ in decisions]}
    stages |= {"elapsed_s": [None if is_cut and k + 1 == num else each for k, each in enumerate(clock.tolist())]}
    stages |= {"reward": [None if each is None else 0.0 for each in stages["elapsed_s"]]}
    stages |= {"action": ["WAIT" if target is None else "PICK" for _, target, _ in decisions]}
    stages |= {"object": [target for _, target, _ in decisions]}
    paths = {"path": [1], "end_s": [float(clock[-1]) + 1.0], "ending": [ending]}
    rows = [(1, stage + 1, k) for stage in range(num) for k in range(3)]
    return stages, paths, dict(zip(("path", "stage", "object"), zip(*rows, strict=True), strict=True))


def refusal_of(decisions):
    """What whoever reads a log of these decisions, cut in the last, says against it."""
    try:
        Logs(*tables_of(decisions, "cut"))
    except LogError as error:
        return str(error)
    return None


@settings(max_examples=20)
@given(DECISIONS)
def test_a_stage_is_refused_where_the_log_with_it_would_not_be_read(tmp_path_factory, decisions):
    folder, taken = tmp_path_factory.mktemp("robots") / "logs", []
    with LogRecorder(folder) as recorder:
        path = recorder.begin_path(1)
        for robot, target, length in decisions:
            told = refusal_of([*taken, (robot, target, length)])
            if told is not None:
                with pytest.raises(LogError, match=re.escape(told)):
                    begin(path, robot, target)
                continue
            taken.append((robot, target, length))
            do(path, robot, target, sum(each for *_, each in taken))
        if not taken:
            path.cut("operator")
            return
        path.finish(elapsed_s=sum(each for *_, each in taken) + 1.0)
    found, wanted = read_logs(folder), Logs(*tables_of(taken, "finished"))
    for name in ("robot", "elapsed_s", "action"):
        assert found.stages[name].tolist() == wanted.stages[name].tolist()
    assert found.stages["object"].isna().tolist() == wanted.stages["object"].isna().tolist()
    assert found.end_s.tolist() == wanted.end_s.tolist()
