"""Seconds count from the beginning of each trajectory, whatever a source counts from."""

import warnings
from contextlib import nullcontext
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from foreign import (
    LAST,
    NO,
    arrays,
    episodes,
    last_of,
    rows_of,
    write_arrays,
    write_lerobot,
    write_minari_episodes,
    write_rows,
)
from halfseen.errors import HalfseenWarning, LogError
from halfseen.logs.formats import StepRules, read_lerobot, read_minari, read_step_arrays, read_steps
from halfseen.logs.formats.step_clocks import ends_by_observations, ends_by_steps, refuse_rounded
from refusals import refused

FOUND = episodes(lengths=(3, 3, 3))
EACH = [0.5, 1.0, 1.5]
BEGINS = {
    "each at 0": [0.0, 0.0, 0.0],
    "running on": [0.0, 1.5, 3.0],
    "of the calendar": [1.7e9, 1.7e9 + 60.0, 1.7e9 + 90],
}
RULES = StepRules(clock="t")


def of_minari(folder, times):
    infos = [{"infos": {"t": np.array(each)}} for each in times]
    return read_minari(write_minari_episodes("clock-v0", [(LAST, NO)] * len(times), each=infos), clock="t")


def of_rlds(folder, times):
    return read_steps(write_rows(folder / "steps", rows_of(FOUND, [True] * 3, clocks=times)), RULES)


def of_lerobot(folder, times):
    flags = {"next.terminated": last_of(FOUND, [True] * 3)}
    write_lerobot(folder, FOUND, fps=2, extra=flags, stamps=[time for each in times for time in each[:3]])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", HalfseenWarning)
        return read_lerobot(folder, StepRules(clock="timestamp"))


def of_d4rl(folder, times):
    rows = arrays(FOUND, terminated=[0, 1, 2]) | {"t": np.concatenate(times)}
    return read_step_arrays(write_arrays(folder / "a.hdf5", rows), RULES)


@pytest.fixture(autouse=True)
def datasets(tmp_path, monkeypatch):
    monkeypatch.setenv("MINARI_DATASETS_PATH", str(tmp_path))


@pytest.mark.parametrize("counted", list(BEGINS))
@pytest.mark.parametrize("read", [of_rlds, of_lerobot, of_minari])
def test_times_of_observations_say_when_each_began(tmp_path, read, counted):
    if read is of_lerobot and counted == "of the calendar":  # its stamps are float32, which hold no such times
        counted = "running on"
    logs = read(tmp_path, [[begin + time for time in (0.0, *EACH)] for begin in BEGINS[counted]])
    assert (logs.elapsed_s().tolist(), logs.end_s.tolist()) == ([EACH] * 3, [1.5] * 3)


def of_ends(begins):
    return [[begin + time for time in EACH] for begin in begins]


@pytest.mark.parametrize("counted", ["each at 0", "running on"])
@pytest.mark.parametrize("read", [of_d4rl, of_minari])
def test_times_of_ends_of_steps_begin_at_0_or_where_the_episode_before_ended(tmp_path, read, counted):
    message = r"t is later .* 2 of 2 times: each begins when the one before ended.*up to 0\.5 s"
    with pytest.warns(HalfseenWarning, match=message) if counted == "running on" else nullcontext():
        logs = read(tmp_path, of_ends(BEGINS[counted]))
    assert (logs.elapsed_s().tolist(), logs.end_s.tolist()) == ([EACH] * 3, [1.5] * 3)


OF_STEPS, OF_OBSERVATIONS = [of_d4rl, of_minari], [of_rlds, of_minari]
COUNTED = r"steps last \S+e\+\d+ s by its clock, in whole numbers, as if it counted nano.*--step-s"
FINER = r"t is 1\.7e\+\d+, which is no date in seconds, but may be one in milliseconds or a finer unit"
ROUNDED = np.float32(1.7e9) + np.array([0.0, 130.0, 260.0, 390.0], dtype=np.float32)
REFUSED = [
    (OF_STEPS, of_ends(BEGINS["of the calendar"]), r"episode 0: by t its first step would last 1\.7e\+09 s"),
    (OF_STEPS, of_ends([0.0, 99.0, 101.0]),
     r"episode 1: by t its first step would last 98 s, but no later step lasts more than 0\.5 s"),
    # It begins again, though not everywhere.
    (OF_STEPS, of_ends([0.0, 1.5, 0.0]), r"episode 1: by t its first step would last 2 s"),
    *(([read], [[per_s * time for time in times]] * 3, COUNTED)
      for per_s in (1e9, 4e6)
      for read, times in ((of_d4rl, EACH), *((read, [0.0, *EACH]) for read in (of_rlds, of_lerobot, of_minari)))),
    *((OF_OBSERVATIONS, [[per_s * (1.7e9 + time) for time in (0.0, *EACH)]] * 3, FINER) for per_s in (1e3, 1e6, 1e9)),
    (OF_OBSERVATIONS, [list(ROUNDED)] * 3,
     r"t holds float32, which rounds its times to multiples of 128 s, and steps last 128 s; write it as"),
]  # fmt: skip
"""By readers: times that do not tell when a step ended, and what is reported of them."""


@pytest.mark.parametrize(
    ("read", "times", "message"), [(read, times, message) for readers, times, message in REFUSED for read in readers]
)
def test_a_clock_that_does_not_tell_seconds_is_refused(tmp_path, read, times, message):
    with refused(message, LogError):
        read(tmp_path, times)


def test_single_precision_holds_times_of_a_clock_that_begins_at_0():
    refuse_rounded("a", "t", ROUNDED - ROUNDED[0])


def test_a_first_step_that_outlasts_the_episode_before_is_believed_and_reported():
    times = [np.array(each) for each in ([0.5], [0.7, 1.5], [0.2, 0.4])]
    with pytest.warns(HalfseenWarning, match="1 of 2 times: each counts from its own beginning"):
        found = ends_by_steps("a", "t", [0, 1, 2], times)
    assert [each.tolist() for each in found] == [[0.5], [0.7, 1.5], [0.2, 0.4]]


@given(
    st.lists(st.lists(st.floats(0.5, 1.4), min_size=1, max_size=5), min_size=2, max_size=6),
    st.floats(-1e6, 1e6),
)
def test_each_way_of_counting_gives_the_same_seconds(durations, begin):
    """The oracle adds up the steps of each episode, one after the other."""
    wanted = [[sum(each[: k + 1]) for k in range(len(each))] for each in durations]
    now, running = 0.0, []
    for each in wanted:
        running.append(np.array([now + end for end in each]))
        now = running[-1][-1]
    with pytest.warns(HalfseenWarning, match="begins when the one before ended"):
        found = ends_by_steps("a", "t", range(len(running)), running)
    for ours, theirs in zip(found, wanted, strict=True):
        np.testing.assert_allclose(ours, theirs, rtol=1e-9)
    begins = np.cumsum([0, *(len(each) + 1 for each in wanted)])
    found = ends_by_observations(begin + np.concatenate([[0.0, *each] for each in wanted]), begins)
    ours = [found[first : last - 1] for first, last in pairwise(begins)]
    np.testing.assert_allclose(np.concatenate(ours), np.concatenate(wanted), atol=1e-9)
