"""Episodes of steps in the forms of others: tables of RLDS, arrays of D4RL, datasets of LeRobot."""

from itertools import pairwise

import h5py
import numpy as np
import pyarrow as pa
import pyarrow.feather
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from foreign import (
    CUT,
    FINISHED,
    arrays,
    assert_is,
    episodes,
    expected,
    last_of,
    rows_of,
    times_of,
    write_arrays,
    write_lerobot,
    write_rows,
)
from halfseen.errors import ArgumentError, HalfseenError, HalfseenWarning
from halfseen.logs.formats import StepRules, read_lerobot, read_step_arrays, read_steps
from refusals import refused

IN_ROWS = ["observation_0", "observation_1"]
IN_ARRAYS = ["observations_0", "observations_1"]
STATE = ["observation.state_0", "observation.state_1"]
SECONDS = StepRules(step_s=1.0)
YES, NO, NAN = True, False, float("nan")


# Several episodes of one step that terminate are rightly doubted, and drawn now and then.
@pytest.mark.filterwarnings("ignore:.*each counts as an episode of one step")
@given(
    st.lists(st.tuples(st.integers(1, 5), st.booleans()), min_size=1, max_size=5),
    st.integers(0, 2**32 - 1),
    st.booleans(),
    st.sampled_from(["parquet", "csv", "feather", "arrow"]),
    st.sampled_from([10, 29.97, 0.5]),
)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=15)
def test_each_form_is_the_same_log(tmp_path_factory, ended, seed, is_text, kind, fps):
    folder = tmp_path_factory.mktemp("steps")
    found = episodes(seed, [length for length, _ in ended], is_text=is_text)
    terminal = [is_terminal for _, is_terminal in ended]
    endings, rules = [FINISHED if is_terminal else CUT for is_terminal in terminal], StepRules(step_s=0.25)

    file = write_rows(folder / "rows", rows_of(found, terminal), kind)
    names = [f"e{number}" for number in range(len(found))]
    assert_is(read_steps(file, rules), expected(found, endings, times_of(found, 0.25), IN_ROWS, names=names))

    ends = [[number for number, is_over in enumerate(terminal) if is_over is wanted] for wanted in (True, False)]
    file = write_arrays(folder / "steps.hdf5", arrays(found, *ends))
    assert_is(read_step_arrays(file, rules), expected(found, endings, times_of(found, 0.25), IN_ARRAYS))

    write_lerobot(folder, found, fps=fps, extra={"next.terminated": last_of(found, terminal)})
    wanted = expected(found, endings, times_of(found, 1 / fps), STATE, has_last=False)
    assert_is(read_lerobot(folder), wanted, rtol=1e-12)


# Tables of RLDS.


def test_several_files_follow_one_another_and_must_be_of_one_table(tmp_path):
    found = episodes()
    rows = rows_of(found, [True, False, True])
    files = [write_rows(tmp_path / "a", rows[:5]), write_rows(tmp_path / "b", rows[5:])]
    with pytest.warns(HalfseenWarning, match="every step counts as 1 s"):
        logs = read_steps(files)
    names = ["e0", "e1", "e2"]
    assert_is(logs, expected(found, [FINISHED, CUT, FINISHED], times_of(found), IN_ROWS, names=names))
    other = write_rows(tmp_path / "c", [{**row, "note": 1} for row in rows])
    with pytest.raises(HalfseenError, match=r"c\.parquet: its columns differ from those of .*a\.parquet \(note\)"):
        read_steps([files[0], other])


STEP = {"is_last": [NO, YES], "is_terminal": [NO, YES], "observation.c": [1, None], "reward": [1, 0]}


@pytest.mark.parametrize(
    ("first", "second", "column", "wanted"),
    [
        ({}, {"observation.c": [0.5, 1.5]}, "observation.c", [1.0, 0.5]),
        ({"observation.c": [None, None]}, {"observation.c": ["red", "red"]}, "observation.c", [None, "red"]),
        ({"reward": np.float32([0.5, 0])}, {"reward": [0.25, 0.0]}, "reward", [0.5, 0.25]),
        ({"observation.c": [None, NO]}, {"observation.c": [YES, NO]}, "observation.c", [None, YES]),
        ({"action": [b"\xc3\xb6ffne", None]}, {"action": [b"x", None]}, "action", ["\u00f6ffne", "x"]),
        ({"action": [YES, None]}, {"action": [NO, None]}, "action", [1, 0]),
    ],
)
def test_files_may_have_other_types_that_hold_the_same(tmp_path, first, second, column, wanted):
    files = []
    for name, of in (("a", first), ("b", second)):
        files.append(tmp_path / f"{name}.parquet")
        pq.write_table(pa.table({"episode_id": [name] * 2, "action": ["x", None]} | STEP | of), files[-1])
    found = read_steps(files, SECONDS, missing="keep").stages[column]
    assert found.astype(object).where(found.notna(), None).tolist() == wanted


DATES = pa.array([0, 1_500_000, 5_000_000, 7_250_000], pa.timestamp("us", "Europe/Berlin"))


@pytest.mark.parametrize(
    "clock", [DATES, DATES.cast(pa.timestamp("ns")), DATES.cast(pa.int64()).cast(pa.duration("us"))]
)
def test_dates_and_durations_are_clocks(tmp_path, clock):
    columns = {name: values * 2 for name, values in STEP.items()} | {"action": ["x", None] * 2, "t": clock}
    pq.write_table(pa.table({"episode_id": [*"aabb"], **columns}), tmp_path / "a.parquet")
    logs = read_steps(tmp_path / "a.parquet", StepRules(clock="t"), missing="keep")
    assert logs.end_s.tolist() == [1.5, 2.25]


def test_files_of_no_common_type_are_refused(tmp_path):
    rows = rows_of(episodes(), [YES] * 3)
    files = [write_rows(tmp_path / "a", rows[:4]), write_rows(tmp_path / "b", [{**rows[4], "action": "pick"}])]
    with refused(r"a\.parquet and 1 more: .*action has incompatible types: int64 vs string; write each column"):
        read_steps(files, SECONDS)


def test_without_names_episodes_begin_where_is_first_says_so(tmp_path):
    found = episodes()
    rows = [{key: value for key, value in row.items() if key != "episode_id"} for row in rows_of(found, [True] * 3)]
    logs = read_steps(write_rows(tmp_path / "steps", rows), SECONDS)
    assert_is(logs, expected(found, [FINISHED] * 3, times_of(found), IN_ROWS))


@pytest.mark.parametrize(("truncated", "ending"), [("cut", CUT), ("finished", FINISHED)])
def test_a_last_row_that_is_no_last_one_broke_off(tmp_path, truncated, ending):
    found = episodes(lengths=(2, 3))
    file = write_rows(tmp_path / "steps", rows_of(found, [False, False], last=[True, False]))
    logs = read_steps(file, StepRules(step_s=1.0, truncated=truncated))
    assert logs.trajectories[["ending", "cause"]].to_numpy().tolist() == [list(ending), ["cut", "unknown"]]
    # Of what broke off the last row is a step that began: its action is known, and its reward is not.
    torn = logs.stages[logs.stages["trajectory"] == "e1"]
    np.testing.assert_array_equal(torn["elapsed_s"], [1.0, 2.0, 3.0, np.nan])
    assert torn["action"].tolist() == [*found[1]["actions"], found[1]["actions"][0]]
    assert logs.end_s.tolist()[1] == 4.0


def test_a_named_column_is_the_clock(tmp_path):
    found = episodes(lengths=(2, 2))
    clocks = [[10.0, 10.5, 12.0], [3.0, 4.0, 4.25]]
    file = write_rows(tmp_path / "steps", rows_of(found, [True, False], last=[True, False], clocks=clocks))
    logs = read_steps(file, StepRules(clock="t"))
    np.testing.assert_array_equal(logs.elapsed_s(), [[0.5, 2.0, np.nan], [1.0, 1.25, np.nan]])
    assert logs.end_s.tolist() == [2.0, 1.25]


def test_structs_are_taken_apart_and_the_rest_is_left_out_and_reported(tmp_path):
    found = episodes(lengths=(2,))
    rows = rows_of(found, [False])
    for k, row in enumerate(rows):
        x, y = row.pop("observation")
        row |= {"observation": {"arm": {"x": x, "q": [y, [2.0, 3.0][k % 2]]}, "lit": k == 1, "lamp": "on"}}
        row |= {"discount": 1.0, "reward": 5.0, "observation.image": [0] * 1001}
    with pytest.warns(HalfseenWarning) as caught:
        logs = read_steps(write_rows(tmp_path / "steps", rows), SECONDS)
    said = " ".join(str(each.message) for each in caught)
    for words in (
        "left out are discount: they were not known before the action",
        "1 rewards other than 0 are in rows that are is_last, which hold no action: they are not read",
        "observation.image (int64 of shape (1001,)): columns",
    ):
        assert words in said
    seen = {f"observation.{name}" for name in ("arm.q_0", "arm.q_1", "arm.x", "lamp", "lit")}
    assert set(logs.stage_covariates) == seen
    assert logs.stages["observation.arm.x"].tolist() == [row[0] for row in found[0]["observed"]]
    assert logs.stages["observation.arm.q_1"].tolist() == [2.0, 3.0, 2.0]
    assert logs.stages["observation.lit"].tolist() == [False, True, False]


@pytest.mark.parametrize("has_name", [True, False])
def test_steps_may_be_a_list_in_the_row_of_their_episode(tmp_path, has_name):
    found = episodes()
    rows = rows_of(found, [True, False, True])
    names = [row.pop("episode_id") for row in rows]
    lists = [[row for row, of in zip(rows, names, strict=True) if of == name] for name in ("e0", "e1", "e2")]
    columns = {"steps": lists} | ({"episode_id": ["e0", "e1", "e2"]} if has_name else {})
    pq.write_table(pa.table(columns), tmp_path / "steps.parquet")
    pyarrow.feather.write_feather(pa.table(columns), tmp_path / "steps.feather")
    wanted = expected(found, [FINISHED, CUT, FINISHED], times_of(found), IN_ROWS, names=columns.get("episode_id"))
    for kind in ("parquet", "feather"):
        assert_is(read_steps(tmp_path / f"steps.{kind}", SECONDS), wanted)


def test_an_episode_without_steps_is_left_out_and_reported(tmp_path):
    rows = rows_of(episodes(lengths=(2,)), [False])
    pq.write_table(pa.table({"steps": [rows, [], None]}), tmp_path / "steps.parquet")
    with pytest.warns(HalfseenWarning, match="left out: 2 of 3 episodes, without steps in 'steps'"):
        assert read_steps(tmp_path / "steps.parquet", SECONDS).num_trajectories == 1


@pytest.mark.filterwarnings("ignore:.*left out are discount")
def test_a_discount_of_0_at_the_last_action_is_a_terminal_step(tmp_path):
    """As dm_env has it; in the last row, which holds no action, EnvLogger writes 0 however the episode ended."""
    rows = rows_of(episodes(lengths=(2, 2)), [True, False])
    for row, discount in zip(rows, [1.0, 0.0, 0.0, 1.0, 1.0, 0.0], strict=True):
        row["discount"] = discount
    assert read_steps(write_rows(tmp_path / "a", rows), SECONDS).trajectories["ending"].tolist() == ["finished", "cut"]
    rows[4]["discount"] = 0.0
    with refused("episode 'e1': discount is 0 at its last action, .* yet its last row is not is_terminal; fix one"):
        read_steps(write_rows(tmp_path / "b", rows), SECONDS)
    for row in rows:  # it says nothing
        row["discount"] = 0.0
    assert read_steps(write_rows(tmp_path / "c", rows), SECONDS).trajectories["ending"].tolist() == ["finished", "cut"]


def test_rewards_of_which_the_first_are_missing_are_of_the_actions_before(tmp_path):
    rows = rows_of(episodes(lengths=(2, 3)), [True, False])
    for row in rows:
        row["reward"] = NAN if row["is_first"] else 1.0 - row["is_last"]
    with refused("the first reward of each episode, and no other, is missing, so each seems to be of the action bef"):
        read_steps(write_rows(tmp_path / "steps", rows), SECONDS)


@pytest.mark.parametrize("kind", [pa.string(), pa.dictionary(pa.int32(), pa.string())], ids=["text", "dictionary"])
def test_flags_may_be_words(tmp_path, kind):
    rows = rows_of(episodes(lengths=(2, 3)), [True, False])
    for row in rows:
        row |= {name: str(bool(row[name])) for name in ("is_first", "is_last", "is_terminal")}
    table = pa.Table.from_pylist(rows)
    for name in ("is_first", "is_last", "is_terminal"):
        table = table.set_column(table.column_names.index(name), name, pa.array(table[name].to_pylist(), kind))
    pq.write_table(table, tmp_path / "steps.parquet")
    assert read_steps(tmp_path / "steps.parquet", SECONDS).trajectories["ending"].tolist() == ["finished", "cut"]


@pytest.mark.parametrize("kind", [pa.list_(pa.float32(), 2), pa.large_list(pa.float64())], ids=["fixed", "large"])
def test_lists_of_any_kind_are_columns(tmp_path, kind):
    found = episodes(lengths=(2,))
    rows = rows_of(found, [False])
    lists = pa.array([row["observation"] for row in rows], kind)
    table = pa.Table.from_pylist(rows).drop_columns(["observation"]).append_column("observation", lists)
    pq.write_table(table, tmp_path / "steps.parquet")
    logs = read_steps(tmp_path / "steps.parquet", SECONDS)
    assert_is(logs, expected(found, [CUT], times_of(found), IN_ROWS, names=["e0"]), rtol=1e-6)


# Arrays of D4RL.


@pytest.mark.parametrize(
    ("has_next", "flags"), [(True, "timeouts"), (False, "truncations"), (True, "episode_terminals")]
)
@pytest.mark.parametrize(("truncated", "ending"), [("cut", CUT), ("finished", FINISHED)])
def test_each_ending_of_arrays_has_its_meaning(tmp_path, has_next, flags, truncated, ending):
    found = episodes(lengths=(3, 1, 2, 4))
    # The third both terminates and times out, and the last does neither.
    rows = arrays(found, terminated=[0, 2], timed_out=[1, 2], has_next=has_next)
    rows[flags] = rows.pop("timeouts") | (rows["terminals"] & (flags == "episode_terminals"))
    logs = read_step_arrays(write_arrays(tmp_path / "a.hdf5", rows), StepRules(step_s=0.5, truncated=truncated))
    endings = [FINISHED, ending, FINISHED, ("cut", "end-of-data")]
    assert_is(logs, expected(found, endings, times_of(found, 0.5), IN_ARRAYS, has_last=has_next))


def test_without_timeouts_that_is_reported(tmp_path):
    found = episodes()
    file = write_arrays(tmp_path / "a.hdf5", arrays(found, terminated=[0, 1, 2]) | {"timeouts": None})
    with pytest.warns(HalfseenWarning, match="no timeouts"), pytest.warns(HalfseenWarning, match="counts as 1 s"):
        logs = read_step_arrays(file)
    assert_is(logs, expected(found, [FINISHED] * 3, times_of(found), IN_ARRAYS))


def test_ends_that_observations_contradict_are_reported(tmp_path):
    found = episodes(0, (3, 2, 4, 2))
    lost = write_arrays(tmp_path / "lost.hdf5", arrays(found, terminated=(0, 2, 3)))
    with pytest.warns(HalfseenWarning, match=r"in row 4 next_observations are not the obs.* in 1 rows: mark the ends"):
        read_step_arrays(lost, SECONDS)
    for episode in found:
        episode["observed"] = (np.array(episode["observed"]) / 100 + [0.0, len(episode["actions"])]).tolist()
    rows = arrays(found, timed_out=(0, 1, 2, 3))
    for end in (2, 4, 8):
        rows["next_observations"][end] = rows["observations"][end + 1]
    with pytest.warns(HalfseenWarning, match="are the first observations of the next, as environments that reset"):
        read_step_arrays(write_arrays(tmp_path / "reset.hdf5", rows), SECONDS)


@pytest.mark.parametrize(("by", "word"), [(-1, "early"), (1, "late")])
def test_ends_that_are_marked_beside_a_jump_are_reported(tmp_path, by, word):
    rows = arrays(episodes(0, (4, 5, 4, 5, 4, 5)), timed_out=range(6), has_next=False)
    is_end = rows["timeouts"]
    rows["observations"] = [[k - at, k] for at, k in zip(np.cumsum([0, *is_end[:-1]]) * 9, range(27), strict=True)]
    read_step_arrays(write_arrays(tmp_path / "right.hdf5", rows), SECONDS)
    rows["timeouts"] = np.roll(is_end, by)
    with pytest.warns(
        HalfseenWarning, match=f"observations jump as if ends of episodes were marked one row too {word}"
    ):
        read_step_arrays(write_arrays(tmp_path / "shifted.hdf5", rows), SECONDS)


def test_a_row_in_which_an_environment_reset_itself_is_reported(tmp_path):
    found = episodes(0, (3, 2, 4, 2))
    for before, after in pairwise(found):
        after["observed"].insert(0, before["observed"][-1])
        after["actions"].insert(0, 0)
        after["rewards"].insert(0, 0.0)
    file = write_arrays(tmp_path / "a.hdf5", arrays(found, terminated=range(4)))
    with pytest.warns(HalfseenWarning, match="as vectors of Gymnasium do, drop the first row of each but the first"):
        read_step_arrays(file, SECONDS)


def test_a_flag_that_stays_true_is_reported(tmp_path):
    rows = arrays(episodes(0, (9,)), has_next=False) | {"terminals": np.arange(9) > 4}
    with pytest.warns(HalfseenWarning, match="terminals is true in row 6 and in the one above, as in 3 rows, and each"):
        read_step_arrays(write_arrays(tmp_path / "a.hdf5", rows), SECONDS)


def test_groups_of_observations_and_named_arrays_are_read(tmp_path):
    rows = arrays(episodes(lengths=(2,)), terminated=[0], has_next=False)
    rows |= {"observations": None, "actions": np.zeros((2, 3)), "infos/qpos": np.zeros((2, 9))}
    rows |= {"observations/arm/q": np.arange(4.0).reshape(2, 2), "observations/lit": [True, False]}
    rows |= {"infos/verb": ["pick", "stop"], "infos/t": [0.5, 2.0], "infos/gain": [3, 4]}
    file = write_arrays(tmp_path / "a.hdf5", rows)
    with pytest.warns(HalfseenWarning, match=r"left out are actions, rewards, infos/qpos: they were not known"):
        logs = read_step_arrays(file, StepRules(action="infos/verb", clock="infos/t", reward="infos/gain"))
    assert logs.stages[["action", "reward", "elapsed_s"]].values.tolist() == [["pick", 3.0, 0.5], ["stop", 4.0, 2.0]]
    assert logs.stages["observations/arm/q_1"].tolist() == [1.0, 3.0]
    assert sorted(logs.stage_covariates) == ["observations/arm/q_0", "observations/arm/q_1", "observations/lit"]


def raw(root, other):
    root.create_dataset("rewards", (8,), "f8", external=[("raw.bin", 0, 64)])


def virtual(root, other):
    layout = h5py.VirtualLayout((8,), "f8")
    layout[:] = h5py.VirtualSource(str(other), "rewards", (8,))
    root.create_virtual_dataset("rewards", layout)


def linked(link):
    return lambda root, other: root.__setitem__("rewards", link(other))


def circular(root, other):
    group = root.create_group("infos")
    group["a"], group["b"] = group, group


def large(root, other):
    root.create_dataset("rewards", (8, 10**9), "f8", chunks=(1, 10**6), compression="gzip")


@pytest.mark.parametrize(
    ("put", "message"),
    [
        (linked(lambda _: h5py.SoftLink("/actions")), "rewards is a link"),
        (linked(lambda other: h5py.ExternalLink(str(other), "/actions")), "rewards is a link"),
        (raw, "rewards is stored in another file"),
        (virtual, "rewards is stored in another file"),
        (circular, "it has too many groups"),
        (large, "unpacked, it has 64,000 MB"),
    ],
)
def test_nothing_outside_the_file_or_without_end_is_read(tmp_path, put, message):
    rows = arrays(episodes(), terminated=[0, 1, 2])
    other = write_arrays(tmp_path / "other.hdf5", rows)
    file = write_arrays(tmp_path / "a.hdf5", rows | {"rewards": None})
    with h5py.File(file, "a") as root:
        put(root, other)
    with pytest.raises(HalfseenError, match=message):
        read_step_arrays(file)


# What is wrong.


def rows_with(folder, **columns):
    """Rows of two episodes, of one step and of two, with other values in some columns; None drops one."""
    rows = rows_of(episodes(lengths=(1, 2)), [True, False])
    for name, values in columns.items():
        for k, row in enumerate(rows):
            row[name] = values and values[k]
            if values is None:
                del row[name]
    file = write_rows(folder / "steps", rows)
    return lambda rules: read_steps(file, rules)


def arrays_with(folder, **other):
    file = write_arrays(folder / "a.hdf5", arrays(episodes(), terminated=[0, 1, 2]) | other)
    return lambda rules: read_step_arrays(file, rules)


LARGE = [np.uint64(2**63)] * 2 + [np.uint64(1)] * 3
NOTHING = {name: np.zeros(0) for name in ("terminals", "actions", "rewards", "timeouts")}
WRONG = {
    rows_with: [
        ({"is_last": None}, r"no 'is_last' for the end of an episode among .*; add it"),
        ({"is_terminal": None}, r"no 'is_terminal' for the done"),
        ({"action": None}, r"no 'action' for the action among episode_id"),
        ({"is_first": None, "episode_id": None}, r"no 'is_first' for the beginning of an episode"),
        ({"action": [[0.1, 0.2]] * 5}, r"action holds float64 of shape \(2,\).*discretise"),
        ({"action": [0.5] * 5}, r"action holds float64"),
        ({"action": LARGE}, r"action is 9223372036854775808, beyond 64-bit integers"),
        ({"episode_id": LARGE}, r"'trajectory' holds .* 64-bit integers"),
        ({"action": [None, 1, 1, 1, 1]}, r"trajectory 'e0', stage 1: the stage is completed, yet its action is null"),
        ({"reward": [None, 1.0, 1.0, 1.0, 1.0]}, r"trajectory 'e0', stage 1: .*reward is nan"),
        ({"reward": [NAN] * 5}, r"trajectory 'e0', stage 1: .*reward is nan"),
        ({"is_last": [NO, YES, YES, NO, YES]}, r"episode 'e1': step 1 of 3 ends it; make two"),
        ({"is_terminal": [YES, YES, NO, NO, NO]}, r"episode 'e0': step 1 of 2 ends it"),
        ({"is_last": [NO] * 5}, r"episode 'e0': its last row terminates it and is not is_last"),
        ({"is_last": [NO, YES, None, NO, YES]}, r"row 2: is_last is null, neither true nor false; fix it"),
        ({"is_last": [*"ntnnt"]}, r"row 0: is_last is 'n', neither true nor false; fix it"),
        ({"is_first": [YES, NO, NO, NO, NO]}, r"row 2: is_first is False, yet episode_id is 'e1'"),
        ({"episode_id": None, "is_first": [NO, NO, YES, NO, NO]}, r"row 0: is_first is false"),
        ({"episode_id": [*"abaaa"], "is_first": [YES, YES, YES, NO, NO]}, r"'a' are not adjacent"),
        ({"episode_id": [None, *"bbbb"]}, r"episode_id holds object or null, not names"),
        ({"episode_id": [0.5] * 5, "is_first": [YES, NO, NO, NO, NO]}, r"episode_id holds float64"),
        ({"observation": [[1.0], [2.0], [3.0], [4.0], [5.0, 6.0]]}, r"row 4: observation has 2 values"),
        ({"observation": [[NAN, 1.0]] * 5}, r"trajectory 'e0', stage 1: covariate observation_0 is null"),
        ({"observation": [[1.0, np.inf]] * 5}, r"covariate observation_1 is inf"),
        ({"observation": [{"a": 1.0}] * 5, "observation.a": [2.0] * 5}, r"two columns 'observation\.a'; drop or"),
        ({"episode_id": [*"abccc"], "is_first": [YES, YES, YES, NO, NO], "is_last": [YES, YES, NO, NO, YES],
          "is_terminal": [YES, YES, NO, NO, NO]},
         r"'a': it has no step, as its only row is is_last.* of 2 of 3 episodes; if the ending stands in the row of"),
    ],
    arrays_with: [
        ({"rewards": None}, r"no 'rewards' for the reward among actions, next_observations"),
        ({"observations": None}, r"no 'observations' for the observations"),
        ({"rewards": [1.0] * 7}, r"rewards has the shape \(7,\), and terminals \(8,\); every array has one row a step"),
        ({"observations": np.zeros((7, 2))}, r"observations has the shape \(7, 2\)"),
        ({"terminals": 1.0}, r"every array has one row a step"),
        ({"terminals": [0.5] * 8}, r"row 0: terminals is 0\.5, neither true nor false"),
        ({"timeouts": [NAN] * 8}, r"timeouts is null, neither true nor false"),
        ({"actions": np.zeros((8, 3))}, r"actions holds float64 of shape \(3,\).*discretise"),
        ({"rewards": [NAN] * 8}, r"trajectory 0, stage 1: .*reward is nan"),
        (dict.fromkeys(["observations", "next_observations"], np.full((8, 2), np.inf)), r"observations_0 is inf"),
        ({"next_observations": np.zeros((8, 3))}, r"next_observations and observations differ in observations_2"),
        ({"rewards": np.array([(1, 2)] * 8, dtype="i4,i4")}, r"rewards holds"),
        (NOTHING | {"observations": np.zeros((0, 2)), "next_observations": np.zeros((0, 2))}, r"it has no episodes"),
    ],
}  # fmt: skip
"""By what writes and reads: what is other, what is said of it, and rules that say more than how long a step is."""


@pytest.mark.filterwarnings("ignore:.*which hold no action:halfseen.errors.HalfseenWarning")
@pytest.mark.parametrize(("make", "case"), [(make, case) for make, cases in WRONG.items() for case in cases])
def test_what_is_wrong_is_reported_in_one_line(tmp_path, make, case):
    other, result, *rules = case
    read = make(tmp_path, **other)
    with refused(result):
        read(*rules or [SECONDS])


def test_a_table_without_rows_is_reported(tmp_path):
    (tmp_path / "steps.csv").write_text("is_first,is_last,is_terminal,observation.x,action,reward\n")
    with pytest.raises(HalfseenError, match=r"steps\.csv: there are no rows; give a table"):
        read_steps(tmp_path / "steps.csv")


@pytest.mark.parametrize(
    "wrong", [{"step_s": 0.0}, {"step_s": NAN}, {"step_s": 1.0, "clock": "t"}, {"truncated": "maybe"}]
)
def test_rules_that_contradict_one_another_are_refused(wrong):
    with pytest.raises(ArgumentError):
        StepRules(**wrong)
