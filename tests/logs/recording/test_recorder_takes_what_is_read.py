"""Whatever a recorder takes, the reader reads back, and what it would not is refused at the call."""

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from halfseen.errors import LogError
from halfseen.logs import LogRecorder, read_logs

WILD_TEXT = st.text(st.characters(exclude_categories=()), max_size=3) | st.sampled_from(
    ["", "\0", "a\0", "\ud800", "0_reward", "1_out_s", "0_out_cause", " Path", "x", "y", "NaN", "null"]
)
WHOLE = st.integers(-(2**65), 2**65) | st.sampled_from(
    [2**53, 2**53 + 1, -(2**53) - 1, 2**63 - 1, -(2**63), 10**400, 0]
)
WILD_NUMBER = WHOLE | st.floats() | st.booleans()
WILD_VALUE = WILD_NUMBER | WILD_TEXT | st.none() | st.lists(WILD_NUMBER | WILD_TEXT, max_size=3)
TAME = st.sampled_from([0.5, 1, 2**53 + 1])
VALUE = TAME | TAME | TAME | WILD_VALUE
NAME = st.just("A") | st.just("A") | st.just("A") | WHOLE | WILD_TEXT
ELAPSED_S = st.none() | st.sampled_from([0.0, 1e-12, 1e-9, 1e-6, 1e-3, 1.0, 1e3, 1e9]) | st.floats(0.0, 10.0)
X = st.fixed_dictionaries({"x": VALUE})
COVARIATES = X | X | X | st.dictionaries(WILD_TEXT, WILD_VALUE)
OBJECT = st.fixed_dictionaries({"object": NAME, "z": VALUE})

BEGIN_PLAINLY = st.tuples(st.just("begin_stage"), st.tuples(X, st.none(), NAME, st.none()), st.just({}))
CALLS = st.one_of(
    BEGIN_PLAINLY,
    BEGIN_PLAINLY,
    BEGIN_PLAINLY,
    st.tuples(st.just("begin_path"), st.tuples(st.none() | NAME), st.dictionaries(WILD_TEXT, WILD_VALUE, max_size=2)),
    st.tuples(
        st.just("begin_stage"),
        st.tuples(COVARIATES, st.none() | st.lists(OBJECT, max_size=2), NAME, st.none() | NAME),
        st.fixed_dictionaries({}, optional={"probability": st.floats(0.0, 1.0), "robot": st.integers(0, 2)}),
    ),
    st.tuples(
        st.just("complete_stage"),
        st.tuples(st.floats(-9, 9) | WILD_NUMBER),
        st.fixed_dictionaries({"elapsed_s": ELAPSED_S}, optional={"own_rewards": st.lists(st.floats(), max_size=2)}),
    ),
    st.tuples(
        st.just("drop_out"), st.tuples(st.integers(0, 2), WILD_TEXT), st.fixed_dictionaries({"elapsed_s": ELAPSED_S})
    ),
    st.tuples(st.just("still_running"), st.just(()), st.fixed_dictionaries({"elapsed_s": ELAPSED_S})),
    st.tuples(st.just("finish"), st.just(()), st.fixed_dictionaries({"elapsed_s": ELAPSED_S})),
    st.tuples(st.just("cut"), st.tuples(WILD_TEXT), st.fixed_dictionaries({"elapsed_s": ELAPSED_S})),
)
"""One call of any kind with arguments of any kind: few of them are taken."""


def same(back, given):
    """Whether a value came back: whole numbers exactly, and lists as arrays."""
    if isinstance(given, list):
        return len(back) == len(given) and all(same(b, g) for b, g in zip(back, given, strict=True))
    return bool(back == given) and isinstance(back, bool | np.bool_) == isinstance(given, bool)


def check_calls(folder, calls):
    stages = {}
    with LogRecorder(folder) as recorder:
        for call, given, named in calls:
            path = recorder.path
            try:
                if call == "begin_path":
                    recorder.begin_path(*given, **named)
                elif path is not None:
                    getattr(path, call)(*given, **named)
                    if call == "begin_stage":
                        stages.setdefault(path.name, []).append((given, named))
            except LogError as error:
                assert len(str(error).splitlines()) == 1  # noqa: PT017
    if not stages:
        return 0
    logs = read_logs(folder)
    for number, name in enumerate(logs.path_ids):
        rows = logs.stages[logs.stages["path"] == name]
        assert logs.path_ids.tolist()[number] in stages
        for (_, row), ((covariates, _, action, acted_on), named) in zip(rows.iterrows(), stages[name], strict=False):
            for column, value in covariates.items():
                assert same(logs.stages.at[row.name, column], value)
            for column, value in (("action", action), ("object", acted_on)):
                assert value is None or same(logs.stages.at[row.name, column], value)
            assert named.get("probability") is None or math.isclose(row["probability"], named["probability"])
    return len(stages)


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(calls=st.lists(CALLS, min_size=4, max_size=12))
def test_whatever_is_taken_is_read_back(tmp_path_factory, calls):
    check_calls(tmp_path_factory.mktemp("logs") / "logs", [("begin_path", (None,), {}), *calls])


@pytest.mark.slow
@settings(max_examples=1500, deadline=None, suppress_health_check=list(HealthCheck))
@given(calls=st.lists(CALLS, min_size=4, max_size=20))
def test_whatever_of_much_is_taken_is_read_back(tmp_path_factory, calls):
    check_calls(tmp_path_factory.mktemp("logs") / "logs", [("begin_path", (None,), {}), *calls])


PLAIN = st.sampled_from([1, 2.5, 2**53 + 1, [1], [2.5], [2**60], [], "a", True])


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(values=st.lists(st.tuples(PLAIN, PLAIN, PLAIN), min_size=2, max_size=5))
def test_columns_of_numbers_of_all_sizes_are_read_back_or_refused(tmp_path_factory, values):
    folder = tmp_path_factory.mktemp("logs") / "logs"
    taken = []
    with LogRecorder(folder) as recorder:
        for x, y, scene in values:
            try:
                path = recorder.begin_path(**({} if scene == "a" else {"scene": scene}))
                path.begin_stage({"x": x}, [{"object": 1, "y": y}], "A", 1)
                taken.append((x, y, None if scene == "a" else scene))
                path.complete_stage(0.0, elapsed_s=1.0)
                path.finish()
            except LogError as error:
                assert "one type" in str(error) or "as text" in str(error)  # noqa: PT017
                if not recorder.path.is_ended:
                    recorder.path.cut("operator")
    if not taken:
        return
    logs = read_logs(folder)
    scenes = logs.paths["scene"].tolist() if "scene" in logs.paths else [None] * len(taken)
    assert all(same(back, x) for back, (x, _, _) in zip(logs.stages["x"], taken, strict=True))
    assert all(same(back, y) for back, (_, y, _) in zip(logs.objects["y"], taken, strict=True))
    assert all(scene is None or same(back, scene) for back, (_, _, scene) in zip(scenes, taken, strict=True))


def recorded(recorder, *stages, **columns):
    """Record a path of stages, each with what begin_stage is given."""
    path = recorder.begin_path(**columns)
    for number, (covariates, objects, action, acted_on) in enumerate(stages, 1):
        path.begin_stage(covariates, objects, action, acted_on)
        path.complete_stage(0.0, elapsed_s=float(number))
    return path


@pytest.mark.parametrize(("first", "second"), [(2**53 + 1, 0.5), (0.5, 2**53 + 1), ([2**60], [0.5]), ([0.5], [2**60])])
def test_whole_numbers_beyond_fractions_do_not_share_a_column_with_fractions(tmp_path, first, second):
    with LogRecorder(tmp_path) as recorder:
        path = recorded(recorder, ({"x": first}, [{"object": 1, "y": first}], "A", 1))
        for covariates, objects in (
            ({"x": second}, [{"object": 1, "y": first}]),
            ({"x": first}, [{"object": 1, "y": second}]),
        ):
            with pytest.raises(LogError, match=r"path 1, stage 2.*beyond 2\^53 and a fraction.*as text"):
                path.begin_stage(covariates, objects, "A", 1)
        path.finish()
    # And a recorder that goes on with the folder knows.
    with LogRecorder(tmp_path) as recorder, pytest.raises(LogError, match="beyond"):
        recorded(recorder, ({"x": second}, [{"object": 1, "y": first}], "A", 1))


def test_whole_numbers_beyond_fractions_are_read_exactly_beside_nulls(tmp_path):
    with LogRecorder(tmp_path / "logs") as recorder:
        recorded(recorder, ({}, [{"object": 2**53 + 1}], "A", 2**53 + 1), ({}, [{"object": 3}], "A", None)).finish()
        recorded(recorder, ({}, [{"object": 2**53}], "A", 2**53), began_ns=1_700_000_000_000_000_001).finish()
    logs = read_logs(tmp_path / "logs")
    assert logs.stages["object"].tolist()[::2] == [2**53 + 1, 2**53]
    assert logs.paths["began_ns"].tolist()[1] == 1_700_000_000_000_000_001
    logs.write(tmp_path / "parquet")
    assert read_logs(tmp_path / "parquet").paths["began_ns"].tolist()[1] == 1_700_000_000_000_000_001


TEXTS = {"NUL": "a\0", "is no Unicode text": "\ud800"}


@pytest.mark.parametrize("trouble", TEXTS)
def test_text_that_files_do_not_tell_apart_is_refused_wherever_it_is_given(tmp_path, trouble):
    text = TEXTS[trouble]
    with LogRecorder(tmp_path) as recorder:
        for name, columns in ((text, {}), (None, {text: 1}), (None, {"scene": text})):
            with pytest.raises(LogError, match=trouble):
                recorder.begin_path(name, **columns)
        path = recorder.begin_path()
        for given in (
            {"covariates": {text: 1}, "action": "A"},
            {"covariates": {"x": text}, "action": "A"},
            {"covariates": {"x": [text]}, "action": "A"},
            {"action": text},
            {"objects": [{"object": text}], "action": "A"},
            {"objects": [{"object": 1, text: 1}], "action": "A"},
            {"objects": [{"object": "a"}], "action": "A", "object": text},
        ):
            with pytest.raises(LogError, match=trouble):
                path.begin_stage(**given)
        path.begin_stage({"": 1}, action="")
        with pytest.raises(LogError, match=trouble):
            path.cut(text)
        path.cut("operator")
    assert read_logs(tmp_path).stages[""].tolist() == [1]


def test_a_column_that_tells_of_one_robot_is_no_covariate(tmp_path):
    with LogRecorder(tmp_path) as recorder:
        for name in ("0_out_s", "1_out_cause"):
            with pytest.raises(LogError, match="is a name of the log's own"):
                recorder.begin_path(**{name: 1.0})
        with pytest.raises(LogError, match="'0_reward' is a name of the log's own"):
            recorder.begin_path().begin_stage({"0_reward": 1.0}, action="A")


def test_a_clock_below_what_clocks_tell_apart_is_refused(tmp_path):
    with LogRecorder(tmp_path) as recorder:
        path = recorder.begin_path()
        path.begin_stage({}, action="A")
        with pytest.raises(LogError, match=r"path 1, stage 1: elapsed_s 1e-12 is less than the 1e-09 s"):
            path.complete_stage(0.0, elapsed_s=1e-12)
        path.complete_stage(0.0, elapsed_s=1e-9)
        path.finish()
    assert read_logs(tmp_path).end_s.tolist() == [1e-9]


def test_an_end_without_a_clock_that_looks_like_another_unit_is_refused(tmp_path):
    with LogRecorder(tmp_path) as recorder:
        path = recorded(recorder, ({}, None, "A", None))
        path.still_running(elapsed_s=1000.0)
        with pytest.raises(LogError, match="as if units were mixed"):
            path.finish()
        path.finish(elapsed_s=1001.0)
    assert read_logs(tmp_path).end_s.tolist() == [1001.0]


def test_numbers_of_any_size_are_refused_in_a_short_line(tmp_path):
    with LogRecorder(tmp_path) as recorder:
        path = recorder.begin_path()
        for given in ({"x": 10**400}, {"x": {"y": "z" * 10_000}}, {"x": 2**63}):
            with pytest.raises(LogError, match=r"path 1, stage 1: covariate x") as told:
                path.begin_stage(given, action="A")
            assert len(str(told.value)) < 250
        path.begin_stage({"x": 1}, action="A")
        with pytest.raises(LogError, match="reward is a whole number of 1329 bits"):
            path.complete_stage(10**400)
        with pytest.raises(LogError, match="stage 1: it is in progress"):
            path.begin_stage({"x": 1}, action="A")
        path.cut("operator")
