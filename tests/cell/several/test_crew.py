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


def to_the_end(crew):
    while crew.work():
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


def test_between_two_ends_time_passes(cell):
    crew = Crew(cell, ROBOTS)
    crew.begin(0, resting(10 * cell.tick_s))
    crew.begin(1, resting(11 * cell.tick_s))
    assert [ended.arm for ended in crew.work()] == [0]
    first_s = cell.time_s
    crew.begin(0, resting(10 * cell.tick_s))
    assert [ended.arm for ended in crew.work()] == [1]
    assert cell.time_s > first_s


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
    crew, own = Crew(cell, ROBOTS), [over(cell, 0, -0.30), over(cell, 1, 0.30)]
    for arm in (0, 1):
        crew.begin(arm, there_and_back(own[arm], HOMES[arm]))
    first = crew.work()
    both_s = cell.time_s
    ended = first + crew.work()
    assert sorted(done.arm for done in ended) == [0, 1]
    assert all(done.result == [True] for done in ended)
    assert crew.tally.num_waits == 0
    assert touches.num_collisions == 0
    assert cell.time_s < 1.5 * both_s


def test_an_arm_waits_until_the_space_that_it_wants_is_free(cell, touches):
    crew, same = Crew(cell, ROBOTS, patience_s=60.0), [over(cell, arm, 0.0) for arm in (0, 1)]
    told = [[], []]
    for arm in (0, 1):
        crew.begin(arm, there_and_back(same[arm], HOMES[arm], told[arm]))
    (first,) = crew.work()
    assert first.arm == 0
    alone_s = cell.time_s
    assert told == [["home"], []]
    (second,) = crew.work()
    assert (second.arm, second.result) == (1, [True])
    assert crew.tally.num_waits == 1
    # It set out when the other had left, not when that was home.
    assert 0.3 * alone_s < crew.tally.waited_s < 0.95 * alone_s
    assert crew.tally.num_deadlocks == 0
    assert touches.num_collisions == 0


def test_arms_that_do_not_wait_for_space_collide_and_that_is_counted(cell, touches):
    def recklessly(place):
        yield Move(place[None])

    crew = Crew(cell, ROBOTS)
    for arm in (0, 1):
        crew.begin(arm, recklessly(over(cell, arm, 0.0)))
    to_the_end(crew)
    assert touches.num_collisions >= 1
    assert touches.begun_s[0] > 0.5


def test_what_one_arm_presses_on_another_is_a_force_that_stops_the_cell(cell):
    def recklessly(place):
        yield Move(place[None])

    crew = Crew(cell, ROBOTS)
    cell.watches.append(Guard(Stops(limit_s=1e9, force_n=5.0, camera_lost_per_s=0.0), 0.0, np.random.default_rng(0)))
    for arm in (0, 1):
        crew.begin(arm, recklessly(over(cell, arm, 0.0)))
    with pytest.raises(StoppedError, match=EMERGENCY_STOP):
        to_the_end(crew)
    assert largest_force_n(cell) > 5.0


def crossing(cell, arm, near_m, far_m):
    """Go to a place, then want one behind the other arm; who gives way comes home the way it came."""
    near, far, home = over(cell, arm, near_m), over(cell, arm, far_m), HOMES[arm]
    assert (yield Reserve(near[None]))
    yield Move(near[None])
    yield Rest(0.5)
    if not (yield Reserve(np.stack([far, home]), np.stack([home]))):
        yield Move(home[None])
        return "gave way"
    yield Move(far[None])
    yield Move(home[None])
    return "went on"


def test_in_a_deadlock_one_arm_goes_home_and_the_other_goes_on(cell, touches):
    crew = Crew(cell, ROBOTS, patience_s=60.0)
    crew.begin(0, crossing(cell, 0, -0.14, 0.08))
    crew.begin(1, crossing(cell, 1, 0.14, -0.08))
    results = {done.arm: done.result for _ in range(2) for done in crew.work()}
    assert sorted(results.values()) == ["gave way", "went on"]
    assert crew.tally.num_deadlocks == 1
    assert crew.tally.num_gave_way == 1
    assert touches.num_collisions == 0
    # Noticed at once, not after the patience is over.
    assert cell.time_s < 30.0


def test_an_arm_that_waits_too_long_at_home_gives_up(cell, touches):
    def stay(place, home):
        yield Reserve(np.stack([place, home]))
        yield Move(place[None])
        yield Rest(12.0)
        yield Move(home[None])

    crew = Crew(cell, ROBOTS, patience_s=4.0)
    crew.begin(0, stay(over(cell, 0, 0.0), HOMES[0]))
    crew.begin(1, there_and_back(over(cell, 1, 0.0), HOMES[1]))
    (ended,) = crew.work()
    assert (ended.arm, ended.result) == (1, [False])
    assert cell.time_s == pytest.approx(4.0, abs=0.3)
    assert crew.tally.num_deadlocks == 1
    assert crew.tally.num_gave_way == 0
    np.testing.assert_allclose(cell.angles_rad(RIGHT), HOMES[1], atol=0.02)


def test_an_arm_that_waits_too_long_with_no_free_way_home_waits_on_while_the_other_is_at_work(cell, touches):
    def stay(place, home):
        yield Reserve(np.stack([place, home]))
        yield Move(place[None])
        yield Rest(8.0)
        yield Move(home[None])

    def insist(place):
        return (yield Reserve(place[None], place[None]))

    crew = Crew(cell, ROBOTS, patience_s=2.0)
    crew.begin(0, stay(over(cell, 0, 0.0), HOMES[0]))
    crew.begin(1, insist(over(cell, 1, 0.0)))
    results = {done.arm: done.result for _ in range(2) for done in crew.work()}
    assert results == {0: None, 1: True}
    assert crew.tally.num_deadlocks == 0


def test_who_only_tries_is_answered_at_once(cell):
    def trying(place):
        return (yield Reserve(place[None], is_patient=False))

    crew, same = Crew(cell, ROBOTS), [over(cell, arm, 0.0) for arm in (0, 1)]
    crew.begin(0, there_and_back(same[0], HOMES[0]))
    crew.work(50)
    begun_s = cell.time_s
    crew.begin(1, trying(same[1]))
    (ended,) = crew.work()
    assert ended.result is False
    assert cell.time_s == begun_s


def test_a_deadlock_without_a_way_home_stops_the_cell(cell):
    def cornered(arm, near_m, far_m):
        near, far = over(cell, arm, near_m), over(cell, arm, far_m)
        yield Reserve(near[None])
        yield Move(near[None])
        yield Rest(0.5)
        yield Reserve(far[None], far[None])

    crew = Crew(cell, ROBOTS)
    crew.begin(0, cornered(0, -0.14, 0.08))
    crew.begin(1, cornered(1, 0.14, -0.08))
    with pytest.raises(StoppedError, match=DEADLOCK):
        crew.work()


def parked(place):
    """Go to a place, and be idle there."""
    yield Move(place[None])


def wanting(near, far, back):
    """Go to a place, then want another; who gives way goes back."""
    assert (yield Reserve(near[None]))
    yield Move(near[None])
    if not (yield Reserve(far[None], back)):
        yield Move(back)
        return "gave way"
    return "went on"


def test_an_arm_whose_way_an_idle_one_blocks_goes_home_at_once(cell, touches):
    crew = Crew(cell, ROBOTS, patience_s=60.0)
    crew.begin(0, parked(over(cell, 0, 0.0)))
    crew.work()
    begun_s = cell.time_s
    crew.begin(1, wanting(over(cell, 1, 0.35), over(cell, 1, 0.0), HOMES[1][None]))
    (ended,) = crew.work(3000)
    assert (ended.arm, ended.result) == (1, "gave way")
    assert cell.time_s - begun_s < 10.0
    assert (crew.tally.num_deadlocks, crew.tally.num_gave_way, touches.num_collisions) == (1, 1, 0)


def test_an_arm_at_home_whose_way_an_idle_one_blocks_gives_up_at_once(cell):
    crew = Crew(cell, ROBOTS, patience_s=60.0)
    crew.begin(0, parked(over(cell, 0, 0.0)))
    crew.work()
    begun_s = cell.time_s
    crew.begin(1, there_and_back(over(cell, 1, 0.0), HOMES[1]))
    (ended,) = crew.work(3000)
    assert ended.result == [False]
    assert cell.time_s - begun_s < 1.0


def test_an_arm_with_an_idle_one_in_its_way_and_its_way_home_stops_the_cell(cell):
    crew = Crew(cell, ROBOTS)
    crew.begin(0, parked(over(cell, 0, 0.0)))
    crew.work()
    same = over(cell, 1, 0.0)
    crew.begin(1, wanting(over(cell, 1, 0.35), same, same[None]))
    with pytest.raises(StoppedError, match=DEADLOCK):
        crew.work(3000)


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
