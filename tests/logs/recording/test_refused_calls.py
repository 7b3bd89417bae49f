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


def begins(**given):
    return lambda trajectory: begin(trajectory, **given)


def steps(*elapsed_s, **given):
    return lambda trajectory: step(trajectory, *elapsed_s, **given)


def sees(**covariates):
    return begins(covariates=covariates)


def cups(*objects):
    return begins(objects=objects or None, object="cup")


def robot(number, target=None):
    return lambda trajectory: of_robot(trajectory, number, target)


def calls(name, *given, **named):
    return lambda trajectory: getattr(trajectory, name)(*given, **named)


def drops_out(number, elapsed_s, cause="battery"):
    return calls("drop_out", number, cause, elapsed_s=elapsed_s)


def completes(elapsed_s):
    return calls("complete_stage", 0.0, elapsed_s=elapsed_s)


ALONE = {
    "reward is nan": [steps(reward=NAN)],
    "reward is 'one'": [steps(reward="one")],
    "reward is None": [steps(reward=None)],
    "reward is a whole number of 1329 bits": [steps(2.0, reward=10**400)],
    "elapsed_s 0.5 is before the 1.0": [steps(0.5)],
    "elapsed_s 1.0 is still the 1.0": [steps(1.0)],
    "elapsed_s is inf": [steps(np.inf)],
    "elapsed_s is missing": [steps()],
    "is a date, or not in seconds": [steps(1.7e9)],
    "stage 1 is completed already": [completes(2.0)],
    "stage 2: it is in progress": [begins(), begins()],
    "stage 2 is in progress; complete it before finish": [begins(), calls("finish")],
    "as if units were mixed": [calls("finish", elapsed_s=1000.0)],
    "cause '' is not a cause": [calls("cut", "")],
    "it began without an action": [steps(2.0, action=None)],
    "object or probability is given without action": [begins(action=None, probability=0.5)],
    "probability is given, unlike": [begins(probability=0.5)],
    "action 1 is a number": [begins(action=1)],
    "action True is not a name": [begins(action=True)],
    "it has objects, though": [begins(objects=[{"object": 1}])],
    "objects is empty": [begins(objects=[])],
    "covariates are a list": [begins(covariates=[1.0])],
    "covariate x is nan": [sees(x=np.float32("nan"))],
    "covariate x is inf": [sees(x=np.inf)],
    "covariate x is None": [sees(x=None)],
    "covariate x is a text": [sees(x="far")],
    "covariate x is not a flat list": [sees(x=np.zeros((2, 2)))],
    "covariate x is a whole number of": [sees(x=10**400)],
    "covariate x is {'y'": [sees(x={"y": "z" * 10_000})],
    "covariate x is 9223372036854775808": [sees(x=2**63)],
    "covariate x is missing": [sees()],
    "covariate y was not given": [sees(x=1.0, y=1.0)],
    **{
        f"{name!r} is a reserved column of the log": [sees(**{"x": 1.0, name: 1.0})]
        for name in ("reward", "robot", " Cause", "0_reward")
    },
    r"begin_stage\(\) with its robot first": [begins(), calls("drop_out", 0, "battery")],
}
"""Of a trajectory whose first stage was completed at 1 s: the message, and the calls, of which the last is refused."""

OBJECTS = {
    "object 'cup': it is listed twice": [cups(CUP, CUP)],
    "has no name": [cups({"occlusion": 0.5})],
    "object 1 is a number, but earlier ones are text": [cups(CUP | {"object": 1})],
    "object 'cup': covariate occlusion is missing": [cups({"object": "cup"})],
    "it has no objects, though": [cups()],
    "object 'cup' of the action is not among the objects": [cups(CUP | {"object": "mug"})],
    "hidden_by is a text": [cups(CUP | {"hidden_by": "mug"})],
    "hidden_by is a list of texts, before it was a list of numbers": [
        cups(CUP | {"hidden_by": [0.5, 1]}),
        completes(2.0),
        cups(CUP | {"hidden_by": ["mug"]}),
    ],
}
"""Of a trajectory with a cup."""

ROBOTS = {
    r"stage 2: elapsed_s 0\.5 is before the 1\.0 of the event before": [robot(1), completes(0.5)],
    "stage 2: robot is missing, unlike in stages before": [robot(None, 1)],
    "robot 'left' is a text, but earlier ones are number": [robot("left", 1)],
    "stage 2: robot 1 starts on object 0, on which robot 0 has worked since stage 1; fix robot or object": [
        robot(1, 0),
        completes(2.0),
        robot(0, 2),
    ],
    "robot 0 has already dropped out": [drops_out(0, 1.5), drops_out(0, 1.7)],
    r"stage 2: elapsed_s 1\.2 is before the 1\.5 of the event before": [
        robot(1, 1),
        drops_out(np.int64(0), 1.5),
        completes(1.2),
    ],
    r"stage 3: robot 0 decides at 2\.0 s, yet dropped out at 1\.5 s": [
        robot(1, 1),
        drops_out(0, 1.5),
        completes(2.0),
        robot(0, 2),
    ],
    **{f"robot {number!r} is not a robot's number": [drops_out(number, 2.0)] for number in (-1, True, "left", 0.5)},
    "is not a cause": [drops_out(1, 2.0, cause="")],
}
"""Of a trajectory whose robot 0 is at object 0 and decided that by 1 s."""

WORLDS = {"alone": (ALONE, {}), "objects": (OBJECTS, {"objects": [CUP], "object": "cup"}), "robots": (ROBOTS, THREE)}


@pytest.mark.slow
@pytest.mark.parametrize("world", WORLDS)
def test_what_no_log_takes_is_refused_in_one_line_and_harms_nothing(recorder, tmp_path, world):
    troubles, given = WORLDS[world]
    for name, (trouble, of_trajectory) in enumerate(troubles.items(), start=1):
        trajectory = recorder.begin_trajectory()
        step(trajectory, 1.0, **given)
        with refused(rf"^trajectory {name}\b.*{trouble}", LogError) as caught:
            for call in of_trajectory:
                call(trajectory)
        assert len(str(caught.value)) < 250
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
    for message, call in {
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
        with refused(message, LogError):
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


def test_what_else_is_wrong_is_reported_by_whoever_asked_to_be_asked(tmp_path):
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
    for options, message in (
        *(({"part_bytes": size}, f"part_bytes is {size}; give a whole number of bytes") for size in (0, -1)),
        ({"fsync": "often"}, "fsync is 'often'; give one of 'never', 'trajectory', 'stage', 'event'"),
        *(({"reward_unit": unit}, "reward_unit is") for unit in ("", "two\nlines", "x" * 25)),
    ):
        with refused(message):
            LogRecorder(tmp_path / "new", **options)
    Logs(**small_tables()).write(tmp_path / "logs")
    (tmp_path / "file").touch()
    for name, message in (("logs", "record into another folder"), ("file", "cannot be written")):
        with refused(message, ArgumentError):
            LogRecorder(tmp_path / name)
    other_version = journal_line(HEADER | {"version": 9}, 0)[0]
    for content, message in (
        (b"milk\neggs\n", "all its lines fail their checksum"),
        (other_version, r"line 1:.*read it with the halfseen that wrote it"),
    ):
        (tmp_path / JOURNAL).write_bytes(content)
        for take in (read_logs, LogRecorder):
            with refused(message, LogError):
                take(tmp_path)
        assert (tmp_path / JOURNAL).read_bytes() == content
    assert not (tmp_path / "new").exists()
