"""What no log takes is refused at the call, in one line, and harms nothing; whatever is taken is read back."""

import numpy as np
import pytest
from recordings import THREE, begin, of_robot, step

from halfseen.errors import ArgumentError, LogError
from halfseen.logs import LogRecorder, Logs, read_logs
from halfseen.logs.journal import HEADER, JOURNAL, journal_line
from refusals import refused
from valid_logs import small_tables

NAN, INF = float("nan"), float("inf")
CUP = {"object": "cup", "occlusion": np.float32(0.5), "hidden_by": np.array([])}
TEXTS = {"NUL": "a\0", "is not Unicode text": "\ud800"}
"""Texts that files do not tell apart."""


def cups(trajectory, *, objects, acted_on="cup", **given):
    begin(trajectory, objects=objects, object=acted_on, **given)


ALONE = {
    "reward is nan": lambda trajectory: step(trajectory, reward=NAN),
    "reward is 'one'": lambda trajectory: step(trajectory, reward="one"),
    "reward is None": lambda trajectory: step(trajectory, reward=None),
    "reward is a whole number of 1329 bits": lambda trajectory: step(trajectory, 2.0, reward=10**400),
    "elapsed_s 0.5 is before the 1.0": lambda trajectory: step(trajectory, 0.5),
    "elapsed_s 1.0 is still the 1.0": lambda trajectory: step(trajectory, 1.0),
    "elapsed_s is inf": lambda trajectory: step(trajectory, np.inf),
    "elapsed_s is missing": lambda trajectory: step(trajectory),
    "is a date, or not in seconds": lambda trajectory: step(trajectory, 1.7e9),
    "stage 1 is completed already": lambda trajectory: trajectory.complete_stage(0.0, elapsed_s=2.0),
    "stage 2: it is in progress": lambda trajectory: (begin(trajectory), begin(trajectory)),
    "stage 2 is in progress; complete it before finish": lambda trajectory: (begin(trajectory), trajectory.finish()),
    "as if units were mixed": lambda trajectory: trajectory.finish(elapsed_s=1000.0),
    "cause '' is not a cause": lambda trajectory: trajectory.cut(""),
    "it began without an action": lambda trajectory: step(trajectory, 2.0, action=None),
    "object or probability is given without action": lambda trajectory: begin(trajectory, action=None, probability=0.5),
    "probability is given, unlike": lambda trajectory: begin(trajectory, probability=0.5),
    "action 1 is a number": lambda trajectory: begin(trajectory, action=1),
    "action True is not a name": lambda trajectory: begin(trajectory, action=True),
    "it has objects, though": lambda trajectory: begin(trajectory, objects=[{"object": 1}]),
    "objects is empty": lambda trajectory: begin(trajectory, objects=[]),
    "covariates are a list": lambda trajectory: begin(trajectory, covariates=[1.0]),
    "covariate x is nan": lambda trajectory: begin(trajectory, covariates={"x": np.float32("nan")}),
    "covariate x is inf": lambda trajectory: begin(trajectory, covariates={"x": np.inf}),
    "covariate x is None": lambda trajectory: begin(trajectory, covariates={"x": None}),
    "covariate x is a text": lambda trajectory: begin(trajectory, covariates={"x": "far"}),
    "covariate x is not a flat list": lambda trajectory: begin(trajectory, covariates={"x": np.zeros((2, 2))}),
    "covariate x is a whole number of": lambda trajectory: begin(trajectory, covariates={"x": 10**400}),
    "covariate x is {'y'": lambda trajectory: begin(trajectory, covariates={"x": {"y": "z" * 10_000}}),
    "covariate x is 9223372036854775808": lambda trajectory: begin(trajectory, covariates={"x": 2**63}),
    "covariate x is missing": lambda trajectory: begin(trajectory, covariates={}),
    "covariate y was not given": lambda trajectory: begin(trajectory, covariates={"x": 1.0, "y": 1.0}),
    "'reward' is a reserved column of the log": lambda trajectory: begin(
        trajectory, covariates={"x": 1.0, "reward": 1.0}
    ),
    "'robot' is a reserved column of the log": lambda trajectory: begin(trajectory, covariates={"x": 0.0, "robot": 1}),
    "' Cause' is a reserved column of the log": lambda trajectory: begin(
        trajectory, covariates={"x": 1.0, " Cause": 1.0}
    ),
    "'0_reward' is a reserved column of the log": lambda trajectory: begin(
        trajectory, covariates={"x": 1.0, "0_reward": 1.0}
    ),
    r"begin_stage\(\) with its robot first": lambda trajectory: (begin(trajectory), trajectory.drop_out(0, "battery")),
}
"""Of a trajectory whose first stage was completed at 1 s."""

OBJECTS = {
    "object 'cup': it is listed twice": lambda trajectory: cups(trajectory, objects=[CUP, CUP]),
    "has no name": lambda trajectory: cups(trajectory, objects=[{"occlusion": 0.5}]),
    "object 1 is a number, but earlier ones are text": lambda trajectory: cups(
        trajectory, objects=[CUP | {"object": 1}]
    ),
    "object 'cup': covariate occlusion is missing": lambda trajectory: cups(trajectory, objects=[{"object": "cup"}]),
    "it has no objects, though": lambda trajectory: cups(trajectory, objects=None),
    "object 'cup' of the action is not among the objects": lambda trajectory: cups(
        trajectory, objects=[CUP | {"object": "mug"}]
    ),
    "hidden_by is a text": lambda trajectory: cups(trajectory, objects=[CUP | {"hidden_by": "mug"}]),
    "hidden_by is a list of texts, before it was a list of numbers": lambda trajectory: (
        cups(trajectory, objects=[CUP | {"hidden_by": [0.5, 1]}]),
        trajectory.complete_stage(1.0, elapsed_s=2.0),
        cups(trajectory, objects=[CUP | {"hidden_by": ["mug"]}]),
    ),
}
"""Of a trajectory with a cup."""

ROBOTS = {
    r"stage 2: elapsed_s 0\.5 is before the 1\.0 of the event before": lambda trajectory: (
        of_robot(trajectory, 1),
        trajectory.complete_stage(0.0, elapsed_s=0.5),
    ),
    "stage 2: robot is missing, unlike in stages before": lambda trajectory: of_robot(trajectory, None, 1),
    "robot 'left' is a text, but earlier ones are number": lambda trajectory: of_robot(trajectory, "left", 1),
    (
        "stage 2: robot 1 starts on object 0, on which robot 0 has worked since stage 1; fix robot or object"
    ): lambda trajectory: (
        of_robot(trajectory, 1, 0),
        trajectory.complete_stage(0.0, elapsed_s=2.0),
        of_robot(trajectory, 0, 2),
    ),
    "robot 0 has already dropped out": lambda trajectory: [
        trajectory.drop_out(0, "battery", elapsed_s=s) for s in (1.5, 1.7)
    ],
    r"stage 2: elapsed_s 1\.2 is before the 1\.5 of the event before": lambda trajectory: (
        of_robot(trajectory, 1, 1),
        trajectory.drop_out(np.int64(0), "battery", elapsed_s=1.5),
        trajectory.complete_stage(0.0, elapsed_s=1.2),
    ),
    r"stage 3: robot 0 decides at 2\.0 s, yet dropped out at 1\.5 s": lambda trajectory: (
        of_robot(trajectory, 1, 1),
        trajectory.drop_out(0, "battery", elapsed_s=1.5),
        trajectory.complete_stage(0.0, elapsed_s=2.0),
        of_robot(trajectory, 0, 2),
    ),
    **{
        f"robot {robot!r} is not a robot's number": lambda trajectory, robot=robot: trajectory.drop_out(
            robot, "battery", elapsed_s=2.0
        )
        for robot in (-1, True, "left", 0.5)
    },
    "is not a cause": lambda trajectory: trajectory.drop_out(1, "", elapsed_s=2.0),
}
"""Of a trajectory whose robot 0 is at object 0 and decided that by 1 s."""

WORLDS = {"alone": (ALONE, {}), "objects": (OBJECTS, {"objects": [CUP], "object": "cup"}), "robots": (ROBOTS, THREE)}


@pytest.mark.parametrize("world", WORLDS)
def test_what_no_log_takes_is_refused_in_one_line_and_harms_nothing(recorder, tmp_path, world):
    troubles, given = WORLDS[world]
    for name, (trouble, call) in enumerate(troubles.items(), start=1):
        trajectory = recorder.begin_trajectory()
        step(trajectory, 1.0, **given)
        with refused(rf"^trajectory {name}\b.*{trouble}", LogError) as told:
            call(trajectory)
        assert len(str(told.value)) < 250
        if not trajectory.is_in_stage:  # so that a cut takes nothing back
            begin(trajectory, **given | ({"robot": 1, "object": None} if "robot" in given else {}))
        trajectory.cut("operator", elapsed_s=3.0)
    logs = read_logs(tmp_path / "logs")
    assert logs.elapsed_s()[:, 0].tolist() == [1.0] * len(troubles)
    assert logs.trajectories["cause"].tolist() == ["operator"] * len(troubles)
    if world == "objects":
        assert [entry.tolist() for entry in logs.objects["hidden_by"]][:1] == [[]]


def test_trajectories_that_no_log_takes_are_refused(recorder, tmp_path):
    recorder.begin_trajectory().cut("operator")
    with refused("no stage is recorded yet", LogError):
        read_logs(tmp_path / "logs")
    for name in ("Object", "0_out_s", "1_out_cause"):
        with refused(f"'{name}' is a reserved column of the log", LogError):
            recorder.begin_trajectory(**{name: 1.0})
    trajectory = recorder.begin_trajectory("a")
    for told, call in {
        "it has no stage": trajectory.finish,
        "no robot has decided yet": lambda: trajectory.drop_out(0, "battery"),
        "trajectory 'a': it is in progress": recorder.begin_trajectory,
        r"elapsed_s 0\.0 is still the 0\.0 of the event before": lambda: step(trajectory, 0.0),
        r"trajectory 'a', stage 1: elapsed_s 1e-12 is less than the 1e-09 s": lambda: trajectory.complete_stage(
            0.0, elapsed_s=1e-12
        ),
        "trajectory 'a': it has ended": lambda: (
            trajectory.complete_stage(0.0, elapsed_s=1e-9),
            trajectory.finish(),
            trajectory.cut("operator"),
        ),
        "trajectory 7 is a number, but earlier ones are text": lambda: recorder.begin_trajectory(7),
    }.items():
        with refused(told, LogError):
            call()
    trajectory = recorder.begin_trajectory()
    assert trajectory.name == "2"
    step(trajectory, 1.0)
    trajectory.still_running(elapsed_s=1000.0)
    with refused("as if units were mixed", LogError):
        trajectory.finish()
    trajectory.finish(elapsed_s=1001.0)
    assert sorted(read_logs(tmp_path / "logs").end_s.tolist()) == [1e-9, 1001.0]
    recorder.close()
    with refused("the recorder is closed", LogError):
        step(recorder.begin_trajectory())


@pytest.mark.parametrize("trouble", TEXTS)
def test_text_that_files_do_not_tell_apart_is_refused_wherever_it_is_given(recorder, tmp_path, trouble):
    text = TEXTS[trouble]
    for name, columns in ((text, {}), (None, {text: 1}), (None, {"scene": text})):
        with refused(trouble, LogError):
            recorder.begin_trajectory(name, **columns)
    trajectory = recorder.begin_trajectory()
    for seen in (
        *({"covariates": covariates} for covariates in ({text: 1}, {"x": text}, {"x": [text]})),
        {"action": text},
        *({"objects": [one]} for one in ({"object": text}, {"object": 1, text: 1})),
        {"objects": [{"object": "a"}], "object": text},
    ):
        with refused(trouble, LogError):
            begin(trajectory, **seen)
    begin(trajectory, covariates={"": 1}, action="")
    with refused(trouble, LogError):
        trajectory.cut(text)
    trajectory.cut("operator")
    assert read_logs(tmp_path / "logs").stages[""].tolist() == [1]


@pytest.mark.parametrize(("first", "second"), [(2**53 + 1, 0.5), (0.5, 2**53 + 1), ([2**60], [0.5]), ([0.5], [2**60])])
def test_whole_numbers_beyond_fractions_do_not_share_a_column_with_fractions(tmp_path, first, second):
    def put(trajectory, x, y, elapsed_s):
        step(trajectory, elapsed_s, covariates={"x": x}, objects=[{"object": 1, "y": y}], object=1)

    with LogRecorder(tmp_path) as recorder:
        trajectory = recorder.begin_trajectory()
        put(trajectory, first, first, 1.0)
        for x, y in ((second, first), (first, second)):
            with refused(r"trajectory 1, stage 2.*beyond 2\^53 and a fraction.*as text", LogError):
                put(trajectory, x, y, 2.0)
        trajectory.finish()
    # And a recorder that goes on with the folder knows.
    with LogRecorder(tmp_path) as recorder, refused("beyond", LogError):
        put(recorder.begin_trajectory(), second, first, 1.0)


def test_what_else_is_wrong_is_told_by_whoever_asked_to_be_asked(tmp_path):
    seen = []

    def check(logs):
        seen.append(logs)
        if logs.stages["action"].eq("DANCE").any():
            raise LogError("nobody dances here")

    with LogRecorder(tmp_path, check=check) as recorder:
        trajectory = recorder.begin_trajectory("monday", speed=2.0)
        step(trajectory, 2.0, probability=0.5)
        with refused("nobody dances here", LogError):
            begin(trajectory, action="DANCE", probability=0.5)
        begin(trajectory, covariates={"x": 0.25}, action="B", probability=0.25)
        trajectory.cut("operator", elapsed_s=3.0)
    assert [len(each.stages) for each in seen] == [1, 2, 2]
    assert seen[-1].stages.equals(read_logs(tmp_path).stages)
    assert seen[-1].trajectories["speed"].tolist() == [2.0]


def test_what_is_asked_for_must_be_there_and_what_is_there_is_left_alone(tmp_path):
    for options, told in (
        *(({"part_bytes": size}, f"part_bytes is {size}; give a whole number of bytes") for size in (0, -1)),
        ({"fsync": "often"}, "fsync is 'often'; give one of 'never', 'trajectory', 'stage', 'event'"),
        *(({"reward_unit": unit}, "reward_unit is") for unit in ("", "two\nlines", "x" * 25)),
    ):
        with refused(told):
            LogRecorder(tmp_path / "new", **options)
    Logs(**small_tables()).write(tmp_path / "logs")
    (tmp_path / "file").touch()
    for name, told in (("logs", "record into another folder"), ("file", "cannot be written")):
        with refused(told, ArgumentError):
            LogRecorder(tmp_path / name)
    other_version = journal_line(HEADER | {"version": 9}, 0)[0]
    for content, told in (
        (b"milk\neggs\n", "all its lines fail their checksum"),
        (other_version, r"line 1:.*read it with the halfseen that wrote it"),
    ):
        (tmp_path / JOURNAL).write_bytes(content)
        for take in (read_logs, LogRecorder):
            with refused(told, LogError):
                take(tmp_path)
        assert (tmp_path / JOURNAL).read_bytes() == content
    assert not (tmp_path / "new").exists()
