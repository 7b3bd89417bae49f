"""Arms that want the same space wait for one another; where they would for ever, one gives way."""

import numpy as np
import pytest

from halfseen.cell.commands import Grip, Move, Reserve, Rest
from halfseen.cell.live_cell import LiveCell
from halfseen.cell.model import cell_model
from halfseen.cell.several.crew import DEADLOCK, Crew
from halfseen.cell.several.pair import PAIR
from halfseen.cell.several.touches import Touches
from halfseen.cell.stops import EMERGENCY_STOP, Guard, StoppedError, Stops, largest_force_n
from halfseen.scene.cups import Cup
from halfseen.scene.poses import Pose
from halfseen.scene.table import TABLE_TOP_M

ROBOTS = [station.robot for station in PAIR]
LEFT, RIGHT = ROBOTS
HOMES = [np.array(robot.home_rad) for robot in ROBOTS]


@pytest.fixture
def cell():
    return LiveCell(cell_model([], [], ROBOTS, [station.rack for station in PAIR]), ROBOTS)


@pytest.fixture
def touches(cell):
    watch = Touches(cell, ROBOTS)
    cell.watches.append(watch)
    return watch


def over(cell, arm, x_m, y_m=0.0, z_m=0.98):
    """Angles with the hand of an arm over a place, pointing down."""
    kinematics, rng = cell.kinematics[ROBOTS[arm].name], np.random.default_rng(0)
    begins = [HOMES[arm], *rng.uniform(*kinematics.search_rad.T, size=(20, 6))]
    found = kinematics.solve_from(Pose((x_m, y_m, z_m), (0.0, 1.0, 0.0, 0.0)), begins, HOMES[arm])
    assert found is not None
    return found


def to_the_end(crew, most_ticks=6000):
    while crew.work(most_ticks):
        pass


def there_and_back(place, home, told=None, seconds=0.2):
    """Reserve, go to a place, stay, and come home; what the answers were."""
    answers = [(yield Reserve(np.stack([place, home])))]
    if answers[0]:
        yield Move(place[None])
        yield Rest(seconds)
        yield Move(home[None])
    if told is not None:
        told.append("home")
    return answers


def parked(place):
    """Go to a place without asking, and be idle there."""
    yield Move(place[None])


def asking(place, **options):
    return (yield Reserve(place[None], **options))


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


def begun(cell, *activities, patience_s=60.0):
    """A crew whose arms have begun their activities."""
    crew = Crew(cell, ROBOTS, patience_s=patience_s)
    for arm, activity in enumerate(activities):
        crew.begin(arm, activity)
    return crew


def resting(seconds):
    yield Rest(seconds)
    return "rested"


def test_an_arm_loses_no_time_where_another_ends_again_and_again(cell):
    crew, begun_s = Crew(cell, ROBOTS), cell.time_s
    crew.begin(0, resting(50 * cell.tick_s))
    ends = []
    while not ends or ends[-1] != 0:
        if not crew.is_busy(1):
            crew.begin(1, resting(3 * cell.tick_s))
        ends += [ended.arm for ended in crew.work()]
    assert ends.count(1) > 10
    alone_s = cell.time_s - begun_s
    begun_s = cell.time_s
    crew.begin(0, resting(50 * cell.tick_s))
    while crew.is_busy(0):
        crew.work()
    assert alone_s == pytest.approx(cell.time_s - begun_s, abs=1.5 * cell.tick_s)


def test_one_arm_of_a_crew_goes_to_the_last_bit_as_one_that_is_alone():
    def work(home):
        yield Grip(0.05, 0.3)
        yield Move(home[None] + 0.2, 0.7)
        yield Rest(0.1)
        return "done"

    alone, crewed = (LiveCell(cell_model([], [], ROBOTS, None), ROBOTS) for _ in range(2))
    assert alone.carry_out(LEFT, work(HOMES[0])) == "done"
    crew = Crew(crewed, ROBOTS)
    crew.begin(0, work(HOMES[0]))
    (ended,) = crew.work()
    assert (ended.arm, ended.result) == (0, "done")
    np.testing.assert_array_equal(alone.data.qpos, crewed.data.qpos)
    assert alone.time_s == crewed.time_s


def test_arms_with_room_for_both_move_at_once(cell, touches):
    crew = begun(cell, *(there_and_back(over(cell, arm, x_m), HOMES[arm]) for arm, x_m in enumerate((-0.30, 0.30))))
    first = crew.work()
    both_s = cell.time_s
    ended = first + crew.work()
    assert sorted((done.arm, done.result) for done in ended) == [(0, [True]), (1, [True])]
    assert (crew.tally.num_waits, touches.num_collisions) == (0, 0)
    assert cell.time_s < 1.5 * both_s


def test_an_arm_waits_until_the_space_that_it_wants_is_free(cell, touches):
    told = [[], []]
    crew = begun(cell, *(there_and_back(over(cell, arm, 0.0), HOMES[arm], told[arm]) for arm in (0, 1)))
    (first,) = crew.work()
    alone_s = cell.time_s
    assert (first.arm, told) == (0, [["home"], []])
    (second,) = crew.work()
    assert (second.arm, second.result) == (1, [True])
    # It set out when the other had left, not when that was home.
    assert 0.3 * alone_s < crew.tally.waited_s < 0.95 * alone_s
    assert (crew.tally.num_waits, crew.tally.num_deadlocks, touches.num_collisions) == (1, 0, 0)


def test_arms_that_do_not_wait_for_space_collide_and_that_is_counted(cell, touches):
    crew = begun(cell, *(parked(over(cell, arm, 0.0)) for arm in (0, 1)))
    to_the_end(crew)
    assert touches.num_collisions >= 1
    assert touches.begun_s[0] > 0.5


def test_what_one_arm_presses_on_another_is_a_force_that_stops_the_cell(cell):
    crew = begun(cell, *(parked(over(cell, arm, 0.0)) for arm in (0, 1)))
    cell.watches.append(Guard(Stops(limit_s=1e9, force_n=5.0, camera_lost_per_s=0.0), 0.0, np.random.default_rng(0)))
    with pytest.raises(StoppedError, match=EMERGENCY_STOP):
        to_the_end(crew)
    assert largest_force_n(cell) > 5.0


def crossing(cell, arm, near_m, far_m):
    """Go to a place, then want one behind the other arm, and home."""
    return wanting(over(cell, arm, near_m), np.stack([over(cell, arm, far_m), HOMES[arm]]), HOMES[arm][None])


def test_in_a_deadlock_one_arm_goes_home_and_the_other_goes_on(cell, touches):
    crew = begun(cell, crossing(cell, 0, -0.14, 0.08), crossing(cell, 1, 0.14, -0.08))
    results = [done.result for _ in range(2) for done in crew.work()]
    assert sorted(results) == ["gave way", "went on"]
    assert (crew.tally.num_deadlocks, crew.tally.num_gave_way, touches.num_collisions) == (1, 1, 0)
    # Noticed at once, not after the patience is over.
    assert cell.time_s < 30.0


def test_an_arm_that_waits_too_long_at_home_gives_up(cell):
    stays, wants = (there_and_back(over(cell, arm, 0.0), HOMES[arm], seconds=12.0) for arm in (0, 1))
    crew = begun(cell, stays, wants, patience_s=4.0)
    (ended,) = crew.work()
    assert (ended.arm, ended.result) == (1, [False])
    assert cell.time_s == pytest.approx(4.0, abs=0.3)
    assert (crew.tally.num_deadlocks, crew.tally.num_gave_way) == (1, 0)
    np.testing.assert_allclose(cell.angles_rad(RIGHT), HOMES[1], atol=0.02)


def test_an_arm_that_waits_too_long_with_no_free_way_home_waits_on_while_the_other_is_at_work(cell):
    same = over(cell, 1, 0.0)
    stays = there_and_back(over(cell, 0, 0.0), HOMES[0], seconds=8.0)
    crew = begun(cell, stays, asking(same, back=same[None]), patience_s=2.0)
    assert {done.arm: done.result for _ in range(2) for done in crew.work()} == {0: [True], 1: True}
    assert crew.tally.num_deadlocks == 0


def test_who_only_tries_is_answered_at_once(cell):
    crew = begun(cell, there_and_back(over(cell, 0, 0.0), HOMES[0]))
    crew.work(50)
    begun_s = cell.time_s
    crew.begin(1, asking(over(cell, 1, 0.0), is_patient=False))
    (ended,) = crew.work()
    assert ended.result is False
    assert cell.time_s == begun_s


@pytest.mark.parametrize(
    ("is_away", "result", "within_s", "num_gave_way"), [(True, "gave way", 10.0, 1), (False, [False], 1.0, 0)]
)
def test_an_arm_whose_way_an_idle_one_blocks_goes_home_at_once(cell, touches, is_away, result, within_s, num_gave_way):
    crew = begun(cell, parked(over(cell, 0, 0.0)))
    crew.work()
    begun_s, same = cell.time_s, over(cell, 1, 0.0)
    away = wanting(over(cell, 1, 0.35), same[None], HOMES[1][None])
    crew.begin(1, away if is_away else there_and_back(same, HOMES[1]))
    (ended,) = crew.work(3000)
    assert (ended.arm, ended.result) == (1, result)
    assert cell.time_s - begun_s < within_s
    assert (crew.tally.num_deadlocks, crew.tally.num_gave_way, touches.num_collisions) == (1, num_gave_way, 0)


def cornered(cell, arm, near_m, far_m):
    """Go to a place, then want another, and nothing else in its stead."""
    far = over(cell, arm, far_m)[None]
    return wanting(over(cell, arm, near_m), far, far)


@pytest.mark.parametrize("is_idle", [True, False])
def test_a_deadlock_without_a_way_home_stops_the_cell(cell, is_idle):
    first = parked(over(cell, 0, 0.0)) if is_idle else cornered(cell, 0, -0.14, 0.08)
    wanted_m = (0.35, 0.0) if is_idle else (0.14, -0.08)
    crew = begun(cell, first, cornered(cell, 1, *wanted_m))
    with pytest.raises(StoppedError, match=DEADLOCK):
        to_the_end(crew)


@pytest.mark.parametrize("phase", [1, 4, 7])
def test_an_arm_that_has_left_what_another_wants_is_in_no_deadlock(cell, phase):
    """The one waits for space that the other no longer has since it asked; the other waits for the one by now."""
    middle, aside, left = over(cell, 0, 0.08), over(cell, 1, 0.40), over(cell, 0, -0.14)

    def waiting():
        assert (yield Reserve(left[None]))
        yield Move(left[None])
        yield Rest(4.0 + phase * cell.tick_s)
        is_free = yield Reserve(np.stack([middle, HOMES[0]]), HOMES[0][None])
        yield Move(HOMES[0][None])
        return is_free

    def changing():
        yield Move(aside[None])
        assert (yield Reserve(np.stack([over(cell, 1, 0.14), aside])))
        yield Rest(6.0)
        return (yield Reserve(over(cell, 1, -0.08)[None], aside[None]))

    crew = Crew(cell, ROBOTS, patience_s=60.0)
    crew.begin(0, waiting())
    crew.begin(1, changing())
    ended = [done for _ in range(2) for done in crew.work(6000)]
    assert {done.arm: done.result for done in ended} == {0: True, 1: True}
    assert crew.tally.num_waits == 2
    assert crew.tally.num_deadlocks == 0


def test_an_arm_that_touches_what_another_holds_has_collided():
    cup = Cup(0.10, 0.036, 0.034)
    cell = LiveCell(cell_model([cup], [Pose((0.0, 0.0, TABLE_TOP_M))], ROBOTS, None), ROBOTS)
    watch = Touches(cell, ROBOTS)
    cell.watches.append(watch)
    above, at = over(cell, 0, 0.0, 0.0, 0.92), over(cell, 0, 0.0, 0.0, 0.80)
    cell.grip(LEFT, 0.12, 0.3)
    for place in (above, at):
        cell.move(LEFT, place[None], 0.6)
    cell.grip(LEFT, 0.0)
    cell.wait(0.2)
    assert cell.opening_m(LEFT) > 0.05, "it holds the cup"
    assert watch.num_collisions == 0
    cell.grip(RIGHT, 0.0, 0.3)
    for x_m, z_m in ((0.16, 0.90), (0.16, 0.75)):
        cell.move(RIGHT, over(cell, 1, x_m, 0.0, z_m)[None], 0.5)
    assert watch.num_collisions == 0
    # Lower than the other hand, its fingers meet the cup and nothing else.
    cell.move(RIGHT, over(cell, 1, 0.04, 0.0, 0.75)[None], 0.3)
    assert watch.num_collisions >= 1
