"""An arm that is told to give way, wherever in an attempt it is: its cup stands where it stood, and it is home."""

from typing import NamedTuple

import numpy as np
import pytest
from cells import CAMERA, FULL_CAMERA, LEFT, SLIM, two_arm_cell

from halfseen.cell.live_cell import Reserve
from halfseen.cell.space import Outline
from halfseen.scene.cups import draw_surface
from halfseen.scene.table import TABLE_TOP_M

STOOD_M = (-0.26, 0.0, TABLE_TOP_M)


def looked_at(camera):
    surface = draw_surface(SLIM, True, np.random.default_rng(2))
    cell = two_arm_cell(STOOD_M[:2], surfaces=[surface], camera=camera)
    cell.look()
    return cell


@pytest.fixture
def cell():
    return looked_at(CAMERA)


class Asked(NamedTuple):
    """A reservation that was granted or refused for good, when it was asked for, and where the arm stood."""

    command: Reserve
    time_s: float
    angles_rad: np.ndarray


def told(cell, activity, refused):
    """Carry out an activity, and answer no to the reservations whose numbers are in `refused`.

    What is only tried is granted the first time, and no reservation of its own where that is refused: the patient one
    after it is. Gives what came of it, and the reservations.
    """
    live, asked = cell.cell, []
    command, answer = next(activity), True
    while True:
        live.do(LEFT, command)
        if isinstance(command, Reserve):
            number = len(asked)
            answer = number not in refused if command.is_patient or 0 not in refused else False
            if command.is_patient or answer:
                asked.append(Asked(command, live.time_s, live.angles_rad(LEFT)))
        try:
            command, answer = activity.send(answer), True
        except StopIteration as ended:
            return ended.value, asked


def assert_home_with_nothing_in_hand(cell):
    assert cell.in_hand == {}
    np.testing.assert_allclose(cell.cell.angles_rad(LEFT), LEFT.home_rad, atol=0.02)


def test_whose_hand_closed_on_nothing_goes_home_all_the_same(cell, monkeypatch):
    monkeypatch.setattr("halfseen.cell.fetching.feels", lambda *_: False)
    attempt, asked = told(cell, cell.washing(0, 0), {1})
    assert len(asked) == 2
    np.testing.assert_array_equal(asked[1].command.way, asked[1].command.back)
    assert not attempt.is_held
    assert len(cell.memory.objects[0].failed) == 1
    assert_home_with_nothing_in_hand(cell)


@pytest.mark.parametrize(
    ("work", "phase", "is_held", "lifts", "num_glances", "why"),
    [
        ("washing", 0, False, 0, 1, "another arm was in the way"),
        ("lifting", 0, False, 0, 1, "another arm was in the way"),
        ("washing", 1, False, 0, 1, "gave way"),
        ("lifting", 1, True, 0, 1, ""),
        ("lifting", 2, True, 1, 2, ""),
        ("lifting", 3, True, 1, 3, ""),
    ],
)
def test_who_gives_way_puts_back_what_it_holds_by_the_way_that_it_reserved_and_what_was_shown_counts(
    cell, work, phase, is_held, lifts, num_glances, why
):
    known, gone = cell.memory.objects[0], []
    cell.cell.watches.append(lambda live: gone.append((live.time_s, live.angles_rad(LEFT))))
    attempt, asked = told(cell, getattr(cell, work)(0, 0), {phase})
    # The way back was granted with the answer: nothing more is asked for.
    assert len(asked) == phase + 1
    assert (attempt.is_held, known.lifts) == (is_held, lifts)
    assert why in attempt.reason
    # Where the grasp held, that is what a law of grasping is to learn.
    assert [trial.is_held for trial in known.trials] == [True] * (phase > 0)
    assert len(known.glances) <= num_glances
    last = asked[phase]
    if phase == 0:
        assert (attempt.kind, attempt.duration_s, known.failed) == (None, 0.0, [])
    elif phase == 3:
        # Its way back is its way home: no answer leads elsewhere.
        np.testing.assert_array_equal(last.command.way, last.command.back)
    else:
        places_rad = Outline(cell.cell.model, LEFT).along(last.angles_rad, last.command.back).places_rad
        passed = [angles for time_s, angles in gone if time_s > last.time_s]
        assert len(passed) > 100
        # Servos are a little behind, and cut corners by as much.
        assert max(np.abs(places_rad - angles).max(axis=1).min() for angles in passed) < 0.10
    assert_home_with_nothing_in_hand(cell)
    cup = cell.cell.cup(0)
    np.testing.assert_allclose(cup.position_m, STOOD_M, atol=0.02)
    assert cup.rotation[2, 2] > 0.99
    assert not known.is_racked
    if (work, phase) == ("washing", 1):
        again, _ = told(cell, cell.washing(0, 0), set())
        assert again.is_held
        assert known.is_racked


@pytest.mark.slow
def test_what_is_put_back_is_the_same_object_to_whoever_looks_meanwhile():
    """The other arm decides, and so looks, while this one has opened its hand and is on its way home."""
    cell = looked_at(FULL_CAMERA)
    known, seen = cell.memory.objects[0], []
    cell.cell.watches.append(lambda live: seen.append(cell.look()) if round(live.time_s, 2) % 0.5 == 0 else None)
    told(cell, cell.lifting(0, 0), set())
    assert len(seen) > 10
    cell.look()
    assert cell.memory.objects == [known]
    assert known.seen is not None
    assert not known.is_lost
