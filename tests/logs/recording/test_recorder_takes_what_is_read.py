"""Whatever a recorder takes, the reader reads back, and what it would not is refused at the call."""

import math

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from recordings import step

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
    st.tuples(
        st.sampled_from(["still_running", "finish"]), st.just(()), st.fixed_dictionaries({"elapsed_s": ELAPSED_S})
    ),
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


@pytest.mark.parametrize("most", [60, pytest.param(1500, marks=pytest.mark.slow)])
def test_whatever_is_taken_is_read_back(tmp_path_factory, most):
    @settings(max_examples=most, deadline=None, suppress_health_check=list(HealthCheck))
    @given(calls=st.lists(CALLS, min_size=4, max_size=12 if most == 60 else 20))
    def check(calls):
        check_calls(tmp_path_factory.mktemp("logs") / "logs", [("begin_path", (None,), {}), *calls])

    check()


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


def test_whole_numbers_beyond_fractions_are_read_exactly_beside_nulls(tmp_path):
    with LogRecorder(tmp_path / "logs") as recorder:
        path = recorder.begin_path()
        step(path, 1.0, objects=[{"object": 2**53 + 1}], object=2**53 + 1)
        step(path, 2.0, objects=[{"object": 3}])
        path.finish()
        path = recorder.begin_path(began_ns=1_700_000_000_000_000_001)
        step(path, 1.0, objects=[{"object": 2**53}], object=2**53)
        path.finish()
    logs = read_logs(tmp_path / "logs")
    assert logs.stages["object"].tolist()[::2] == [2**53 + 1, 2**53]
    logs.write(tmp_path / "parquet")
    for read in (logs, read_logs(tmp_path / "parquet")):
        assert read.paths["began_ns"].tolist()[1] == 1_700_000_000_000_000_001
