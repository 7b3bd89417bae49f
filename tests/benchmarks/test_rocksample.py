"""RockSample: its facts, pomdp-py's own, routes and returns by hand, and what is kept."""

import json
from itertools import permutations
from pathlib import Path

import numpy as np
import pytest
from peers.side_by_side import stored
from published import rocksample
from worlds import rocks
from worlds.rocks import BY_NUMBER, BY_RANK, CHECK, EAST, NUM, ROCKS, SAMPLE, SIZE, START, Rovers, Seen

PLACES = np.array([(x, y) for x in range(SIZE) for y in range(SIZE)])


def known(position, log_odds=0.0):
    return Seen(np.array([position]), np.full((1, NUM), log_odds), np.zeros(1, dtype=int))


def rover(position, is_good=True):
    return Rovers(np.array([position]), np.full((1, NUM), is_good))


def after(rovers, action, uniform=0.5):
    moved, reward, seen = rocks.step(rovers, np.array([action]), np.array([uniform]))
    return moved, float(reward[0]), int(seen[0])


@pytest.mark.parametrize(("distance", "right"), [(0, 1.0), (20, 0.75), (40, 0.625)])
def test_the_sensor_fades_by_half_every_twenty_cells(distance, right):
    assert rocks.accuracy(ROCKS[:1] + np.array([[distance, 0]]))[0, 0] == pytest.approx(right)


def test_a_good_rock_pays_once_and_then_costs_as_a_bad_one_does():
    sampled, first, _ = after(rover(ROCKS[2]), SAMPLE)
    assert (first, after(sampled, SAMPLE)[1], after(rover(ROCKS[2], False), SAMPLE)[1]) == (10.0, -10.0, -10.0)
    assert sampled.is_good.sum() == NUM - 1
    assert after(rover(START), SAMPLE)[1] == 0.0


def test_to_leave_pays_once_and_the_other_borders_hold():
    moved, reward, _ = after(rover([SIZE - 1, 2]), EAST)
    assert (reward, moved.is_out[0], after(moved, EAST)[1], after(moved, CHECK)[2]) == (10.0, True, 0.0, -1)
    for corner, action in (([0, 0], rocks.NORTH), ([0, 0], rocks.WEST), ([0, SIZE - 1], rocks.SOUTH)):
        assert after(rover(corner), action)[0].position.tolist() == [corner]


def test_steps_are_those_of_pomdp_py():
    theirs = pytest.importorskip("pomdp_py.problems.rocksample.rocksample_problem")
    moves = [theirs.MoveNorth, theirs.MoveSouth, theirs.MoveEast, theirs.MoveWest]
    actions = [*moves, theirs.SampleAction(), *map(theirs.CheckAction, range(NUM))]
    at = {tuple(rock): k for k, rock in enumerate(ROCKS.tolist())}
    is_good = np.random.default_rng(0).random((len(PLACES), NUM)) < 0.5
    transition = theirs.RSTransitionModel(SIZE, at, lambda place: place[0] == SIZE)
    observation, pays = theirs.RSObservationModel(at), theirs.RSRewardModel(at, lambda place: place[0] == SIZE)
    right = rocks.accuracy(PLACES)
    for number, action in enumerate(actions):
        moved, reward, _ = rocks.step(Rovers(PLACES, is_good), np.full(len(PLACES), number), np.full(len(PLACES), 0.5))
        for row, place in enumerate(PLACES.tolist()):
            state = theirs.State(tuple(place), tuple(np.where(is_good[row], "good", "bad").tolist()))
            then = transition.sample(state, action)
            assert then.position == tuple(moved.position[row])
            assert then.rocktypes == tuple(np.where(moved.is_good[row], "good", "bad").tolist())
            assert (then.terminal, pays.sample(state, action, then)) == (moved.is_out[row], reward[row])
            if number >= CHECK:
                result = theirs.Observation(state.rocktypes[number - CHECK])
                assert observation.probability("good", then, action) == pytest.approx(
                    right[row, number - CHECK] if result.quality == "good" else 1.0 - right[row, number - CHECK]
                )


def test_checks_are_right_as_often_as_the_sensor_is():
    place = np.tile(START, (20_000, 1))
    uniform = np.random.default_rng(1).random(len(place))
    _, _, seen = rocks.step(Rovers(place, np.ones((len(place), NUM), bool)), np.full(len(place), CHECK), uniform)
    right = rocks.accuracy(place[:1])[0, 0]
    assert seen.mean() == pytest.approx(right, abs=4.0 * np.sqrt(right * (1.0 - right) / len(place)))


def test_beliefs_are_by_bayes_and_certain_on_the_rock():
    here, p = rover(START), rocks.accuracy(START[None])[0, 4]
    one = rocks.known_after(known(START), here, np.array([CHECK + 4]), np.array([1]))
    two = rocks.known_after(one, here, np.array([CHECK + 4]), np.array([1]))
    assert one.belief[0, 4] == pytest.approx(p)
    assert two.belief[0, 4] == pytest.approx(p**2 / (p**2 + (1.0 - p) ** 2))
    assert two.belief[0, 5] == 0.5
    sure = rocks.known_after(known(ROCKS[4]), rover(ROCKS[4]), np.array([CHECK + 4]), np.array([0]))
    gone = rocks.known_after(two, rover(ROCKS[4]), np.array([SAMPLE]), np.array([-1]))
    assert (sure.belief[0, 4], gone.belief[0, 4]) == (0.0, 0.0)


@pytest.mark.parametrize("good", [[], [3], [0, 4, 7], [1, 2, 5, 6]])
def test_the_best_route_is_the_best_of_all_orders(good):
    def worth(order):
        place, t, total = START, 0, 0.0
        for k in order:
            t += np.abs(ROCKS[k] - place).sum() + 1
            place, total = ROCKS[k], total + 10.0 * 0.95 ** (t - 1)
        return total + 10.0 * 0.95 ** (t + SIZE - 1 - place[0])

    orders = (order for length in range(len(good) + 1) for order in permutations(good, length))
    assert rocks.best_routes()[sum(1 << k for k in good), NUM] == pytest.approx(max(map(worth, orders)))


@pytest.mark.parametrize(("is_good", "pay"), [(True, 10.0), (False, -10.0)])
def test_returns_are_discounted_by_steps(is_good, pay):
    """Sample rock 4, check it from there, sample rock 5, leave."""
    plan = [NUM + 4, 4, NUM + 5, rocks.EXIT]
    rule = lambda seen, stage: np.eye(len(BY_NUMBER.names))[np.full(len(seen.steps), plan[stage - 1])]  # noqa: E731
    played = rocks.play(3, rule, BY_NUMBER, np.random.default_rng(0), np.full(NUM, is_good))
    assert played.end.tolist() == [4, 5, 7, 11] * 3
    expected = pay * 0.95**3 + pay * 0.95**6 + 10.0 * 0.95**10
    np.testing.assert_allclose(played.returns, expected)
    assert np.all(played.chance == 1.0)


def test_a_rank_is_of_the_nearest_rock_that_is_not_believed_to_be_bad():
    seen = known(START)
    seen.log_odds[0, [4, 5]] = -1.0
    assert BY_RANK.skills(seen)[0].tolist() == [1, 7, 0, NUM + 1, NUM + 7, NUM, rocks.EXIT]
    assert BY_RANK.skills(known(START, -1.0))[0].tolist() == [rocks.EXIT] * 7


@pytest.mark.slow
def test_a_log_tells_the_same_trajectories_by_number_and_by_rank_and_half_are_cut():
    rule = rocks.heuristic(0.3)
    rate = rocks.rate_of(0.5, rule, np.random.default_rng(3))
    played = rocks.play(1000, rule, BY_RANK, np.random.default_rng(4))
    logs = [
        rocks.log_of(played, choices, make(played.seen), rate, np.random.default_rng(5))
        for choices, make in ((BY_NUMBER, rocksample.beliefs), (BY_RANK, rocksample.present_values))
    ]
    assert logs[0].cut_share == logs[1].cut_share == pytest.approx(0.5, abs=4.0 * 0.5 / np.sqrt(1000))
    assert logs[0].stages["reward"].equals(logs[1].stages["reward"])
    assert np.all(logs[0].stages["probability"] >= logs[1].stages["probability"] - 1e-12)
    assert np.all(rocks.play(50, rule, BY_RANK, np.random.default_rng(6)).returns <= rocks.best_routes().max())


def test_the_model_of_pomcp_takes_the_same_steps():
    peer = pytest.importorskip("peers.rover", reason="pomdp-py is not installed")
    none, model, good = (0,) * NUM, peer.RoverModel(), 0b10110010
    is_good = np.array([[good >> k & 1 for k in range(NUM)]], dtype=bool)
    for place in map(tuple, PLACES.tolist()):
        for action in peer.possible(place, none, none):
            then, said, reward, steps = model.sample(peer.State(place, good, none, none), action)
            moved, expected, seen = after(Rovers(np.array([place]), is_good), action.number)
            assert (steps == peer.DEPTH, reward) == (bool(moved.is_out[0]), expected)
            if not moved.is_out[0]:
                assert then.place == tuple(moved.position[0])
                assert [then.good >> k & 1 for k in range(NUM)] == moved.is_good[0].tolist()
            assert (seen >= 0) == (said is not peer.NOTHING)


def test_pomcp_samples_a_rock_that_is_surely_good_and_leaves_where_all_are_bad():
    peer = pytest.importorskip("peers.rover", reason="pomdp-py is not installed")
    none, rng = (0,) * NUM, np.random.default_rng(0)
    here, edge = known(ROCKS[3], -30.0), known([SIZE - 1, 0], -30.0)
    here.log_odds[0, 3] = 30.0
    said = tuple(np.where(np.arange(NUM) == 3, 3, -3).tolist())
    assert peer.decided(peer.states(here, said, none, rng), 200)[0] == SAMPLE
    assert peer.decided(peer.states(edge, (-3,) * NUM, none, rng), 200)[0] == EAST


def test_what_is_kept_makes_a_table():
    printed = rocksample.tables(stored("rocksample"))
    assert printed.count("\n") == 15
    assert "nan" not in printed


def test_the_page_tells_how_often_the_default_breaks_down_and_who_is_behind_the_heuristic():
    page = (Path(__file__).parents[2] / "docs" / "guide" / "published-worlds.md").read_text(encoding="utf-8")
    kept = stored("rocksample")
    each = [row["values"]["by rank, default"] for row in kept["rows"] if row["log"].startswith("heuristic")]
    assert f"{(np.array(each) < 19.0).sum()} of {np.size(each)} logs of the heuristic teach less than 19" in page
    assert f"leaves it {-np.mean(kept['POMCP']['ahead']):.1f} behind" in page
    best = max(max(values) for row in kept["rows"] for values in row["values"].values())
    assert best < kept["known"]["heuristic"] + kept["error"]


@pytest.mark.slow
def test_the_benchmark_stores_and_prints_what_it_found(tmp_path, monkeypatch, capsys):
    out = tmp_path / "found.json"
    words = ["--repetitions", "1", "--episodes", "0", "--sizes", "60", "--logs", "heuristic", "--out", str(out)]
    monkeypatch.setattr("sys.argv", ["rocksample", *words])
    rocksample.main()
    found = json.loads(out.read_text(encoding="utf-8"))
    assert len(found["rows"]) == 2
    assert found["known"]["heuristic"] < found["clairvoyant"]
    assert capsys.readouterr().out == rocksample.tables(found) + "\n"


@pytest.mark.slow
def test_the_first_log_of_what_is_kept_comes_out_again():
    kept = stored("rocksample")["rows"][0]
    again = rocksample.measured(*kept["log"].split(", "), kept["size"], 1)["values"]
    for name in ("by number, linear", "by rank, linear"):
        assert again[name][0] == pytest.approx(kept["values"][name][0], abs=0.02), name
