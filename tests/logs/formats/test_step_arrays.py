import h5py
import numpy as np
import pytest
from foreign import assert_is, episodes, expected

from halfseen.errors import HalfseenError, HalfseenWarning
from halfseen.logs.formats import StepRules, read_step_arrays

SEEN = ["observations_0", "observations_1"]
FINISHED, CUT, OVER = ("finished", None), ("cut", "truncated"), ("cut", "end-of-data")


def arrays(found, terminated=(), timed_out=(), *, has_next=True):
    """Steps as of D4RL: the episodes one below the other."""
    ends = np.cumsum([len(each["actions"]) for each in found]) - 1
    rows = {
        "observations": [row for each in found for row in each["observed"][:-1]],
        "actions": [action for each in found for action in each["actions"]],
        "rewards": [reward for each in found for reward in each["rewards"]],
        "terminals": np.isin(np.arange(ends[-1] + 1), ends[list(terminated)]),
        "timeouts": np.isin(np.arange(ends[-1] + 1), ends[list(timed_out)]),
    }
    if has_next:
        rows["next_observations"] = [row for each in found for row in each["observed"][1:]]
    return rows


def write(file, rows):
    with h5py.File(file, "w") as root:
        for name, values in rows.items():
            if values is not None:
                root.create_dataset(name, data=values)
    return file


def ends(found, step_s=1.0):
    return [[step_s * (k + 1) for k in range(len(each["actions"]))] for each in found]


@pytest.mark.parametrize("has_next", [True, False])
@pytest.mark.parametrize(
    ("truncated", "endings"), [("cut", [FINISHED, CUT, FINISHED, OVER]), ("finished", [FINISHED] * 3 + [OVER])]
)
def test_each_ending_has_its_meaning(tmp_path, has_next, truncated, endings):
    found = episodes(lengths=(3, 1, 2, 4))
    # The third both terminates and times out.
    file = write(tmp_path / "a.hdf5", arrays(found, terminated=[0, 2], timed_out=[1, 2], has_next=has_next))
    logs = read_step_arrays(file, StepRules(step_s=0.5, truncated=truncated))
    assert_is(logs, expected(found, endings, ends(found, 0.5), SEEN, has_last=has_next))


def test_without_timeouts_that_is_told(tmp_path):
    found = episodes()
    file = write(tmp_path / "a.hdf5", arrays(found, terminated=[0, 1, 2]) | {"timeouts": None})
    with pytest.warns(HalfseenWarning) as told:
        logs = read_step_arrays(file)
    assert ["no timeouts" in str(each.message) or "counts as 1 s" in str(each.message) for each in told] == [True, True]
    assert_is(logs, expected(found, [FINISHED] * 3, ends(found), SEEN))


def test_groups_of_observations_and_named_arrays_are_read(tmp_path):
    found = episodes(lengths=(2,))
    rows = arrays(found, terminated=[0], has_next=False) | {"observations": None, "actions": np.zeros((2, 3))}
    rows |= {"observations/arm/q": np.arange(4.0).reshape(2, 2), "observations/lit": [True, False]}
    rows |= {
        "infos/verb": ["pick", "stop"],
        "infos/t": [0.5, 2.0],
        "infos/qpos": np.zeros((2, 9)),
        "infos/gain": [3, 4],
    }
    file = write(tmp_path / "a.hdf5", rows)
    rules = StepRules(action="infos/verb", clock="infos/t", reward="infos/gain")
    with pytest.warns(HalfseenWarning, match=r"left out are actions, rewards, infos/qpos: nobody saw them"):
        logs = read_step_arrays(file, rules)
    assert logs.stages["action"].tolist() == ["pick", "stop"]
    assert logs.stages["reward"].tolist() == [3.0, 4.0]
    assert logs.elapsed_s().tolist() == [[0.5, 2.0]]
    assert logs.stages["observations/arm/q_1"].tolist() == [1.0, 3.0]
    assert sorted(logs.stage_covariates) == ["observations/arm/q_0", "observations/arm/q_1", "observations/lit"]


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"rewards": None}, r"no 'rewards' for the reward among actions, next_observations"),
        ({"observations": None}, r"no 'observations' for the observations"),
        ({"rewards": [1.0] * 7}, r"rewards has the shape \(7,\), and terminals \(8,\); every array has one row a step"),
        ({"observations": np.zeros((7, 2))}, r"observations has the shape \(7, 2\)"),
        ({"terminals": 1.0}, r"every array has one row a step"),
        ({"terminals": [0.5] * 8}, r"row 0: terminals is 0\.5, neither true nor false"),
        ({"timeouts": [np.nan] * 8}, r"timeouts is null, neither true nor false"),
        ({"actions": np.zeros((8, 3))}, r"actions holds float64 of shape \(3,\).*discretise"),
        ({"rewards": [np.nan] * 8}, r"path 0, stage 1: .*reward is nan"),
        ({"observations": np.full((8, 2), np.inf)}, r"covariate observations_0 is inf"),
        ({"next_observations": np.zeros((8, 3))}, r"next_observations and observations differ in observations_2"),
        ({"rewards": np.array([(1, 2)] * 8, dtype="i4,i4")}, r"rewards holds"),
        ({"terminals": np.zeros(0), "actions": np.zeros(0), "rewards": np.zeros(0), "timeouts": np.zeros(0),
          "observations": np.zeros((0, 2)), "next_observations": np.zeros((0, 2))}, r"it has no episodes"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told_in_one_line(tmp_path, change, told):
    file = write(tmp_path / "a.hdf5", arrays(episodes(), terminated=[0, 1, 2]) | change)
    with pytest.raises(HalfseenError, match=told) as caught:
        read_step_arrays(file, StepRules(step_s=1.0))
    assert "\n" not in str(caught.value)


def test_a_file_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(HalfseenError, match="there is no such file"):
        read_step_arrays(tmp_path / "none.h5")


def test_nothing_outside_the_file_is_read(tmp_path):
    rows = arrays(episodes(), terminated=[0, 1, 2])
    other = write(tmp_path / "other.hdf5", rows)
    for name, link in (("soft", h5py.SoftLink("/actions")), ("external", h5py.ExternalLink(str(other), "/actions"))):
        file = write(tmp_path / f"{name}.hdf5", rows | {"rewards": None})
        with h5py.File(file, "a") as root:
            root["rewards"] = link
        with pytest.raises(HalfseenError, match="rewards is a link"):
            read_step_arrays(file)
    file = write(tmp_path / "raw.hdf5", rows | {"rewards": None})
    with h5py.File(file, "a") as root:
        root.create_dataset("rewards", (8,), "f8", external=[("raw.bin", 0, 64)])
    with pytest.raises(HalfseenError, match="rewards stands in another file"):
        read_step_arrays(file)
    file = write(tmp_path / "virtual.hdf5", rows | {"rewards": None})
    with h5py.File(file, "a") as root:
        layout = h5py.VirtualLayout((8,), "f8")
        layout[:] = h5py.VirtualSource(str(other), "rewards", (8,))
        root.create_virtual_dataset("rewards", layout)
    with pytest.raises(HalfseenError, match="rewards stands in another file"):
        read_step_arrays(file)


def test_groups_that_hold_one_another_come_to_an_end(tmp_path):
    file = write(tmp_path / "a.hdf5", arrays(episodes(), terminated=[0, 1, 2]))
    with h5py.File(file, "a") as root:
        group = root.create_group("infos")
        group["a"], group["b"] = group, group
    with pytest.raises(HalfseenError, match="its groups are too many"):
        read_step_arrays(file)


def test_an_array_that_says_to_be_large_is_refused_before_it_is_read(tmp_path):
    rows = arrays(episodes(), terminated=[0, 1, 2]) | {"observations": None, "next_observations": None}
    file = write(tmp_path / "a.hdf5", rows)
    with h5py.File(file, "a") as root:
        root.create_dataset("observations", (8, 10**9), "f8", chunks=(1, 10**6), compression="gzip")
    with pytest.raises(HalfseenError, match="unpacked, it has 64,000 MB"):
        read_step_arrays(file)
