"""Arms that want the same space wait for one another; where they would for ever, one gives way."""

import numpy as np
import pytest
from cells import HOMES, LEFT, RIGHT, ROBOTS, SLIM, live_pair, over, standing

from halfseen.cell.executor import DEADLOCK, Executor
from halfseen.cell.live_cell import (
    EMERGENCY_STOP,
    Grip,
    Guard,
    LiveCell,
    Move,
    Reserve,
    Rest,
    StoppedError,
    Stops,
    largest_force_n,
)
from halfseen.cell.model import cell_model
from halfseen.cell.space import Touches


@pytest.fixture
def cell():
    return live_pair()


@pytest.fixture
def touches(cell):
    watch = Touches(cell, ROBOTS)
    cell.watches.append(watch)
    return watch


def at(cell, arm, x_m, z_m=0.98):
    """Angles with the hand of an arm over a place along the table's middle."""
    return over(cell.kinematics[ROBOTS[arm].name], HOMES[arm], (x_m, 0.0, z_m))


def begun(cell, *activities, patience_s=60.0):
    """An executor whose arms have begun their activities."""
    executor = Executor(cell, ROBOTS, patience_s=patience_s)
    for arm, activity in enumerate(activities):
        executor.begin(arm, activity)
    return executor


def results(executor, num=2, most_ticks=6000):
    """What came of so many arms, by arm."""
    return {done.arm: done.result for _ in range(num) for done in executor.work(most_ticks)}


def to_the_end(executor):
    while executor.work(6000):
        pass


def resting(seconds):
    yield Rest(seconds)
    return "rested"


def parked(place):
    """Go to a place without asking, and be idle there."""
    yield Move(place[None])


def asking(place, **options):
    return (yield Reserve(place[None], **options))


def there_and_back(place, home, result=None, seconds=0.2):
    """Reserve, go to a place, stay, and come home; whether the answer was yes."""
    is_free = yield Reserve(np.stack([place, home]))
    if is_free:
        yield Move(place[None])
        yield Rest(seconds)
        yield Move(home[None])
    if result is not None:
        result.append("home")
    return is_free


def wanting(near, way, back):
    """Go to a place, then want a way; who gives way goes back."""
    assert (yield Reserve(near[None]))
    yield Move(near[None])
    yield Rest(0.5)
    if not (yield Reserve(way, back)):
        yield Move(back)
        return "gave way"
    for place in way:
        yield Move(place[None])
    return "went on"


def crossing(cell, arm, near_m, far_m, has_home=True):
    """Go to a place, then want one behind the other arm, and home, or nothing else in its stead."""
    far = at(cell, arm, far_m)
    ways = (np.stack([far, HOMES[arm]]), HOMES[arm][None]) if has_home else (far[None], far[None])
    return wanting(at(cell, arm, near_m), *ways)


def test_an_arm_loses_no_time_where_another_ends_again_and_again(cell):
    executor, begun_s, ends = Executor(cell, ROBOTS), cell.time_s, []
    executor.begin(0, resting(50 * cell.tick_s))
    while not ends or ends[-1] != 0:
        if not executor.is_busy(1):
            executor.begin(1, resting(3 * cell.tick_s))
        ends += [ended.arm for ended in executor.work()]
    assert ends.count(1) > 10
    beside_s, begun_s = cell.time_s - begun_s, cell.time_s
    executor.begin(0, resting(50 * cell.tick_s))
    while executor.is_busy(0):
        executor.work()
    assert beside_s == pytest.approx(cell.time_s - begun_s, abs=1.5 * cell.tick_s)


def test_one_arm_of_a_crew_goes_to_the_last_bit_as_one_that_is_alone():
    def work(home):
        yield Grip(0.05, 0.3)
        yield Move(home[None] + 0.2, 0.7)
        yield Rest(0.1)
        return "done"

    alone, crewed = live_pair(racks=False), live_pair(racks=False)
    assert alone.carry_out(LEFT, work(HOMES[0])) == "done"
    assert results(begun(crewed, work(HOMES[0])), 1) == {0: "done"}
    np.testing.assert_array_equal(alone.data.qpos, crewed.data.qpos)
    assert alone.time_s == crewed.time_s


def test_arms_with_room_for_both_move_at_once(cell, touches):
    executor = begun(cell, *(there_and_back(at(cell, arm, x_m), HOMES[arm]) for arm, x_m in enumerate((-0.30, 0.30))))
    first = results(executor, 1)
    both_s = cell.time_s
    assert first | results(executor, 1) == {0: True, 1: True}
    assert (executor.tally.num_waits, touches.num_collisions) == (0, 0)
    assert cell.time_s < 1.5 * both_s


@pytest.mark.slow
def test_an_arm_waits_until_the_space_that_it_wants_is_free(cell, touches):
    result = [[], []]
    executor = begun(cell, *(there_and_back(at(cell, arm, 0.0), HOMES[arm], result[arm]) for arm in (0, 1)))
    assert (results(executor, 1), result) == ({0: True}, [["home"], []])
    alone_s = cell.time_s
    assert results(executor, 1) == {1: True}
    # It set out when the other had left, not when that was home.
    assert 0.3 * alone_s < executor.tally.waited_s < 0.95 * alone_s
    assert (executor.tally.num_waits, executor.tally.num_deadlocks, touches.num_collisions) == (1, 0, 0)


def test_arms_that_do_not_wait_for_space_collide_which_is_counted_and_a_force_that_stops_the_cell(cell, touches):
    executor = begun(cell, *(parked(at(cell, arm, 0.0)) for arm in (0, 1)))
    cell.watches.append(Guard(Stops(limit_s=1e9, force_n=5.0, camera_lost_per_s=0.0), 0.0, np.random.default_rng(0)))
    with pytest.raises(StoppedError, match=EMERGENCY_STOP):
        to_the_end(executor)
    assert largest_force_n(cell) > 5.0
    assert touches.num_collisions >= 1
    assert touches.begun_s[0] > 0.5


@pytest.mark.slow
def test_in_a_deadlock_one_arm_goes_home_and_the_other_goes_on(cell, touches):
    executor = begun(cell, crossing(cell, 0, -0.14, 0.08), crossing(cell, 1, 0.14, -0.08))
    assert sorted(results(executor).values()) == ["gave way", "went on"]
    assert (executor.tally.num_deadlocks, executor.tally.num_gave_way, touches.num_collisions) == (1, 1, 0)
    # Noticed at once, not after the patience is over.
    assert cell.time_s < 30.0


@pytest.mark.slow
def test_an_arm_that_waits_too_long_at_home_gives_up(cell):
    stays, wants = (there_and_back(at(cell, arm, 0.0), HOMES[arm], seconds=12.0) for arm in (0, 1))
    executor = begun(cell, stays, wants, patience_s=4.0)
    assert results(executor, 1) == {1: False}
    assert cell.time_s == pytest.approx(4.0, abs=0.3)
    assert (executor.tally.num_deadlocks, executor.tally.num_gave_way) == (1, 0)
    np.testing.assert_allclose(cell.angles_rad(RIGHT), HOMES[1], atol=0.02)


@pytest.mark.slow
def test_an_arm_that_waits_too_long_with_no_free_way_home_waits_on_while_the_other_is_at_work(cell):
    same = at(cell, 1, 0.0)
    stays = there_and_back(at(cell, 0, 0.0), HOMES[0], seconds=8.0)
    executor = begun(cell, stays, asking(same, back=same[None]), patience_s=2.0)
    assert results(executor) == {0: True, 1: True}
    assert executor.tally.num_deadlocks == 0


def test_who_only_tries_is_answered_at_once(cell):
    executor = begun(cell, there_and_back(at(cell, 0, 0.0), HOMES[0]))
    executor.work(50)
    begun_s = cell.time_s
    executor.begin(1, asking(at(cell, 1, 0.0), is_patient=False))
    assert results(executor, 1) == {1: False}
    assert cell.time_s == begun_s


@pytest.mark.slow
@pytest.mark.parametrize(
    ("is_away", "result", "within_s", "num_gave_way"), [(True, "gave way", 10.0, 1), (False, False, 1.0, 0)]
)
def test_an_arm_whose_way_an_idle_one_blocks_goes_home_at_once(cell, touches, is_away, result, within_s, num_gave_way):
    executor = begun(cell, parked(at(cell, 0, 0.0)))
    executor.work()
    begun_s, same = cell.time_s, at(cell, 1, 0.0)
    away = wanting(at(cell, 1, 0.35), same[None], HOMES[1][None])
    executor.begin(1, away if is_away else there_and_back(same, HOMES[1]))
    assert results(executor, 1, 3000) == {1: result}
    assert cell.time_s - begun_s < within_s
    assert (executor.tally.num_deadlocks, executor.tally.num_gave_way, touches.num_collisions) == (1, num_gave_way, 0)


@pytest.mark.slow
@pytest.mark.parametrize("is_idle", [True, False])
def test_a_deadlock_without_a_way_home_stops_the_cell(cell, is_idle):
    first = parked(at(cell, 0, 0.0)) if is_idle else crossing(cell, 0, -0.14, 0.08, has_home=False)
    second_m = (0.35, 0.0) if is_idle else (0.14, -0.08)
    executor = begun(cell, first, crossing(cell, 1, *second_m, has_home=False))
    with pytest.raises(StoppedError, match=DEADLOCK):
        to_the_end(executor)


@pytest.mark.slow
@pytest.mark.parametrize("phase", [1, 4, 7])
def test_an_arm_that_has_left_what_another_wants_is_in_no_deadlock(cell, phase):
    """The one waits for space that the other no longer has since it asked; the other waits for the one by now."""
    middle, aside, left = at(cell, 0, 0.08), at(cell, 1, 0.40), at(cell, 0, -0.14)

    def waiting():
        assert (yield Reserve(left[None]))
        yield Move(left[None])
        yield Rest(4.0 + phase * cell.tick_s)
        is_free = yield Reserve(np.stack([middle, HOMES[0]]), HOMES[0][None])
        yield Move(HOMES[0][None])
        return is_free

    def changing():
        yield Move(aside[None])
        assert (yield Reserve(np.stack([at(cell, 1, 0.14), aside])))
        yield Rest(6.0)
        return (yield Reserve(at(cell, 1, -0.08)[None], aside[None]))

    executor = begun(cell, waiting(), changing())
    assert results(executor) == {0: True, 1: True}
    assert (executor.tally.num_waits, executor.tally.num_deadlocks) == (2, 0)


@pytest.mark.slow
def test_an_arm_that_touches_what_another_holds_has_collided():
    cell = LiveCell(cell_model([SLIM], standing((0.0, 0.0)), ROBOTS, []), ROBOTS)
    watch = Touches(cell, ROBOTS)
    cell.watches.append(watch)
    cell.do(LEFT, Grip(0.12, 0.3))
    for z_m in (0.92, 0.80):
        cell.do(LEFT, Move(at(cell, 0, 0.0, z_m)[None], 0.6))
    cell.do(LEFT, Grip(0.0))
    cell.wait(0.2)
    assert cell.opening_m(LEFT) > 0.05, "it holds the cup"
    cell.do(RIGHT, Grip(0.0, 0.3))
    for z_m in (0.90, 0.75):
        cell.do(RIGHT, Move(at(cell, 1, 0.16, z_m)[None], 0.5))
    assert watch.num_collisions == 0
    # Lower than the other hand, its fingers meet the cup and nothing else.
    cell.do(RIGHT, Move(at(cell, 1, 0.04, 0.75)[None], 0.3))
    assert watch.num_collisions >= 1
