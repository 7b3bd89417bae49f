"""A policy against the rule of today: bounds by naive loops, false verdicts and losses over many lifetimes."""

from dataclasses import replace

import numpy as np
import pytest

from halfseen.errors import ArgumentError
from halfseen.monitoring import comparison, dealing
from halfseen.monitoring.comparison import (
    NOTHING,
    ComparisonCache,
    CountedTrajectories,
    Courses,
    beats_at,
    bound,
    counted,
    log_wealth,
)
from halfseen.monitoring.dealing import Standing, Terms, standing


def drawn(num, rng, chance=0.5, gain=0.0, cut=0.0, noise=1.0, num_stages=3):
    """Trajectories of up to three stages, of which about a share is cut; the policy earns so much more in its last."""
    is_policy = rng.random(num) < chance
    rows = []
    for k in range(num):
        x, clock_s, limit_s = rng.normal(), 0.0, rng.exponential() / cut if cut else np.inf
        for stage in range(num_stages):
            clock_s += rng.exponential()
            reward = x + noise * rng.normal() + (gain if is_policy[k] and stage == num_stages - 1 else 0.0)
            is_cut = clock_s > limit_s
            rows.append((k, x, np.nan if is_cut else reward, np.nan if is_cut else clock_s, min(clock_s, limit_s)))
            if is_cut:
                break
    trajectory, state, reward, clock_s, end_s = map(np.array, zip(*rows, strict=True))
    last = np.append(np.flatnonzero(np.diff(trajectory)), len(trajectory) - 1)
    return Courses(
        is_policy,
        np.full(num, chance),
        end_s[last],
        ~np.isnan(reward[last]),
        trajectory,
        state[:, None],
        reward,
        clock_s,
    )


@pytest.mark.parametrize(
    ("asks", "message"),
    [
        (lambda dealt: Terms(share=0.9), r"share is 0\.9; give a probability above 0 and at most 0\.5"),
        (lambda dealt: Terms(most_loss=-1.0), r"most_loss is -1\.0; give a total reward above 0"),
        (lambda dealt: dealt._replace(trajectory=dealt.trajectory[::-1]), "trajectory: the stages are not sorted"),
        (lambda dealt: dealt._replace(trajectory=dealt.trajectory + 1), "trajectory: the stages are not sorted"),
        (lambda dealt: dealt._replace(chance=dealt.chance + 1.0), "chance: a trajectory was dealt with no probability"),
    ],
)
def test_what_cannot_be_compared_is_refused(asks, message):
    with pytest.raises(ArgumentError, match=message):
        standing(asks(drawn(20, np.random.default_rng(1))), Terms())


def survival_of(ends, finished, at):
    """P(C ≥ u) by a loop."""
    left = 1.0
    for s in sorted(set(ends[~finished])):
        if s < at:
            watched = sum((end > s) or (end == s and not done) for end, done in zip(ends, finished, strict=True))
            cuts = sum(end == s and not done for end, done in zip(ends, finished, strict=True))
            left *= (watched - cuts) / watched
    return left


def naive_counted(courses):
    """Contributions of trajectories, by loops over trajectories and stages."""
    stages = [np.flatnonzero(courses.trajectory == k) for k in range(courses.num)]
    arms, ended = courses.is_policy.astype(int), courses.is_finished.astype(int)
    begin = next(k for k in range(courses.num) if min(ended[:k] @ arms[:k], ended[:k] @ (1 - arms[:k])) >= 2)
    found, learned_at = [], None
    for k in range(begin, courses.num):
        if learned_at is None or k >= max(learned_at + 1, int(1.25 * learned_at)):
            learned_at = k
            model = naive_learned(courses, stages, k)
        values, weight, scaled, hidden, totals = model
        p, a = courses.chance[k], arms[k]

        def v(arm, row, values=values, scaled=scaled, first=stages[k][0]):
            return values(arm, scaled(row, row - first))

        both, worth = 2, v(2, stages[k][0])
        for row in stages[k]:
            if not np.isnan(courses.reward[row]):
                after = v(both, row + 1) if row + 1 in stages[k] else 0.0
                worth += weight(a, courses.clock_s[row]) * (courses.reward[row] + after - v(both, row))
        first = stages[k][0]
        excess = worth - (1 - p) * v(1, first) - p * v(0, first)
        found.append((p, a - p, excess, a - 1 + p, *hidden, np.ptp(totals)))
    return np.array(found).T


def naive_learned(courses, stages, num):
    """Values and weights from the first trajectories."""
    rows = [(k, row, row - stages[k][0]) for k in range(num) for row in stages[k]]
    columns = np.array([[stage, courses.state[row, 0]] for _, row, stage in rows])
    centre, spread = columns.mean(axis=0), columns.std(axis=0)

    def scaled(row, stage):
        return np.array([1.0, *((np.array([stage, courses.state[row, 0]]) - centre) / spread)])

    of_arm = [[k for k in range(num) if courses.is_policy[k] == bool(arm)] for arm in (0, 1)]
    of_arm = [each if len(each) >= 10 else list(range(num)) for each in of_arm]

    def weight(arm, at):
        ends, finished = courses.end_s[of_arm[arm]], courses.is_finished[of_arm[arm]]
        return 1.0 / max(survival_of(ends, finished, at), min(0.5, 2.0 / num**0.5))

    coefficients = []
    for arm in (0, 1, 2):
        left, right = np.diag([1e-6, 1.0, 1.0]), np.zeros(3)
        for k, row, stage in rows:
            if (arm == 2 or k in of_arm[arm]) and not np.isnan(courses.reward[row]):
                now = weight(int(courses.is_policy[k]), courses.clock_s[row]) * scaled(row, stage)
                after = scaled(row + 1, stage + 1) if row + 1 in stages[k] else np.zeros(3)
                left += np.outer(now, scaled(row, stage) - after)
                right += now * courses.reward[row]
        coefficients.append(np.linalg.solve(left, right))
    totals = [np.nansum(courses.reward[stages[k]]) for k in range(num)]

    def values(arm, features):
        return np.clip(coefficients[arm] @ features, min(totals), max(totals))

    # Weights make up for these; the others may have earned the most, or the least.
    mean_weight = [
        np.mean([weight(arm, courses.end_s[k]) if courses.is_finished[k] else 0.0 for k in of_arm[arm]])
        for arm in (0, 1)
    ]
    of_rule, of_policy = (max(0.0, 1.0 - each) for each in mean_weight)
    begun = np.mean([values(2, scaled(stages[k][0], 0)) for k in range(num)])
    above, below = max(totals) - begun, begun - min(totals)
    hidden = of_rule * above + of_policy * below, of_policy * above + of_rule * below
    return values, weight, scaled, hidden, totals


@pytest.mark.parametrize("cut", [0.0, 0.3])
def test_what_a_trajectory_adds_is_that_of_a_loop_and_rests_on_those_before_it(cut):
    courses = drawn(40, np.random.default_rng(1), chance=0.4, gain=0.5, cut=cut)
    of = counted(courses)
    np.testing.assert_allclose(np.array(of), naive_counted(courses), rtol=1e-9, atol=1e-12)
    for num in (12, 25):
        part = counted(courses.part(0, num))
        np.testing.assert_array_equal(np.array(part), np.array(of)[:, : part.excess.size])
        np.testing.assert_array_equal(np.array(counted(courses, part)), np.array(of))


def test_without_cuts_a_trajectory_is_worth_what_it_earned():
    courses = drawn(60, np.random.default_rng(2), gain=0.5)
    of = counted(courses)
    shifted = courses._replace(reward=courses.reward + 1.0)
    # A constant a stage is expected of both arms, but for the ridge.
    np.testing.assert_allclose(counted(shifted).excess[30:], of.excess[30:], atol=0.3)
    assert counted(courses.part(0, 3)).excess.size == 0


def test_wealth_is_that_of_a_loop():
    of = counted(drawn(50, np.random.default_rng(3), chance=0.3, gain=0.5, cut=0.2))
    for gain, side in ((0.0, 1), (-0.6, 1), (0.4, -1)):
        wealth, largest, found = np.ones(4), 0.0, []
        for k, (p, w, e, g, too_high, too_low, spread) in enumerate(zip(*of, strict=True)):
            hidden = too_high if side > 0 else too_low
            beside = e - (gain + side * hidden) * g
            w *= max(0.0, 1.0 - 4.0 * hidden / (spread + 4.0 * max(0.0, -side * gain)))
            if k:
                lowered = np.clip(beside, -largest, largest) / (largest or 1.0)
                outcome = side * w * lowered / max(p, 1 - p)
                wealth = wealth * (1.0 + comparison.BETS * outcome)
            largest = max(largest, abs(beside))
            found.append(np.log(comparison.STAKES @ wealth))
        np.testing.assert_allclose(log_wealth(of, gain, side), found, atol=1e-12)


def test_bounds_are_where_the_wealth_is_reached_and_hold_the_gain():
    of = counted(drawn(400, np.random.default_rng(5), gain=1.0))
    low, high = bound(of, 0.025), bound(of, 0.025, -1)
    assert 0.0 < low < 1.0 < high
    for end, side in ((low, 1), (high, -1)):
        assert beats_at(of, end - side * 1e-2, 0.025, side) is not None
        assert beats_at(of, end + side * 1e-2, 0.025, side) is None
    assert bound(of, 0.05) >= low
    assert bound(CountedTrajectories(*np.zeros((7, 0))), 0.05) == -np.inf


@pytest.mark.slow
@pytest.mark.parametrize("cut", [0.0, 0.3])
def test_a_comparison_that_goes_on_stands_where_one_of_the_whole_stands(cut):
    courses, terms = drawn(30, np.random.default_rng(10), gain=0.8, cut=cut), Terms(0.5)
    kept, of = ComparisonCache(), NOTHING
    for num in range(31):
        so_far = courses.part(0, num)
        of = counted(so_far, of, kept)
        assert standing(so_far, terms, of, kept) == standing(so_far, terms)


def test_outcomes_that_never_varied_tell_nothing():
    courses = drawn(30, np.random.default_rng(5))
    same = courses._replace(reward=np.zeros(len(courses.reward)))
    assert (log_wealth(counted(same), 0.0) == 0.0).all()
    # Also while every part has succeeded so far.
    for courses in (same, same._replace(reward=np.ones(len(same.reward)))):
        found = standing(courses, Terms(0.2, most_loss=1.0))
        assert (found.verdict, found.share, found.gain, found.worst_loss) == ("going on", 0.2, 0.0, 0.0)
        assert ": the policy's gain is 0 to 0 a trajectory; it is unknown how many more would decide it" in str(found)


def test_where_no_trajectory_of_an_arm_finished_nothing_is_known():
    courses = drawn(300, np.random.default_rng(5), gain=3.0, cut=1.0)
    found = standing(courses._replace(is_finished=courses.is_finished & courses.is_policy), Terms())
    assert (found.verdict, found.low, found.high) == ("going on", None, None)
    assert str(found).endswith("the policy's gain is not known yet; that takes more finished trajectories of both")


def test_the_share_grows_as_what_is_likely_to_be_lost_shrinks():
    rng = np.random.default_rng(6)
    courses = drawn(200, rng, chance=0.2)
    shares = [standing(courses.part(0, num), Terms(0.1)).share for num in (0, 8, 30, 60, 200)]
    assert shares[:2] == [0.1, 0.1]
    assert shares == sorted(shares)
    assert shares[-1] in (0.2, 0.4, 0.5)


def test_the_chance_of_the_last_trajectory_says_what_was_decided():
    courses = drawn(40, np.random.default_rng(7))
    for chance, verdict in ((1.0, "promoted"), (0.0, "stopped")):
        after = courses._replace(chance=np.append(courses.chance[:-1], chance))
        assert (standing(after, Terms()).verdict, standing(after, Terms()).share) == (verdict, chance)


def test_more_trajectories_are_about_what_a_gain_of_this_size_needs():
    found = [standing(drawn(60, np.random.default_rng(seed), gain=0.8), Terms(0.5)).more for seed in range(12)]
    # Growth of (0.8/2)²/(2·2.9/4) nats a trajectory, and log 40 + 1 wanted: some 85 in all.
    assert 10 < np.median([each for each in found if each is not None]) < 120


def test_how_many_more_is_unknown_where_cuts_may_hide_the_gain():
    courses = drawn(60, np.random.default_rng(0), gain=0.8)
    of = counted(courses)
    assert standing(courses, Terms(0.5), of).more is not None
    assert standing(courses, Terms(0.5), of._replace(too_high=of.too_high + 3.0)).more is None


def test_the_first_trajectory_after_a_verdict_changes_nothing_that_is_said():
    courses = drawn(90, np.random.default_rng(0), cut=0.3)
    for num in range(60, 90):
        at, after = courses.part(0, num), courses.part(0, num + 1)
        promoted = after._replace(chance=np.append(at.chance, 1.0), is_policy=np.append(at.is_policy, True))
        before, found = standing(at, Terms(0.5)), standing(promoted, Terms(0.5))
        assert (found.num, found.low, found.high, found.hidden) == (num, before.low, before.high, before.hidden)


def test_a_loss_that_is_allowed_is_not_passed():
    stopped = []
    for seed in range(8):
        courses = drawn(150, np.random.default_rng(seed), gain=-2.0, noise=0.5)
        for num in range(4, 150, 2):
            found = standing(courses.part(0, num), Terms(0.5, most_loss=40.0))
            if found.verdict == "stopped":
                break
        stopped.append(found.num_policy * 2.0)
    assert max(stopped) <= 40.0


def test_what_is_said():
    assert str(standing(drawn(2, np.random.default_rng(0)), Terms())) == (
        "the comparison goes on after 2 trajectories, 1 by the policy: the policy's gain is not known yet; that takes "
        "more finished trajectories of both"
    )
    stopped = str(standing(drawn(2, np.random.default_rng(0)), Terms(most_loss=1e-9)))
    assert stopped.startswith("the policy is stopped after 2 trajectories, 1 by the policy: it may have lost ")
    assert stopped.endswith(", and its gain stays unknown")
    going_on = Standing(60, 10, 0.4, -0.5, 1.8, 3.0, 0.2, "going on", 16494)
    is_known = str(replace(going_on, verdict="stopped", worst_loss=21.4))
    assert is_known.endswith("gain is −0.5 to +1.8 a trajectory, and it may have lost 21")
    assert str(going_on).endswith("gain is −0.5 to +1.8 a trajectory; about 16,000 more would decide it")
    hidden = str(replace(going_on, hidden=0.25))
    assert hidden.endswith("a trajectory, of which cuts may hide 0.25; about 16,000 more would decide it")
    found = str(standing(drawn(300, np.random.default_rng(0), gain=1.0), Terms()))
    assert found.startswith("the policy is promoted after 300 trajectories, 1")
    assert " a trajectory" in found


def check_false_verdicts(draw):
    false = sum(beats_at(counted(draw()), 0.0, dealing.PROMOTES) is not None for _ in range(150))
    assert false <= 150 * dealing.PROMOTES + 3.0 * np.sqrt(150 * dealing.PROMOTES)


@pytest.mark.slow
@pytest.mark.parametrize("chance", [0.2, 0.5])
@pytest.mark.parametrize("cut", [0.0, 0.4, 1.2])
def test_false_verdicts_are_rare_at_any_time(chance, cut):
    rng = np.random.default_rng(8)
    check_false_verdicts(lambda: drawn(200, rng, chance=chance, cut=cut))


@pytest.mark.slow
@pytest.mark.parametrize("rate", [0.05, 0.5, 0.95])
def test_false_verdicts_are_rare_where_success_is_rare_or_usual(rate):
    rng = np.random.default_rng(9)

    def draw():
        courses = drawn(200, rng, chance=0.2, num_stages=1)
        return courses._replace(reward=(rng.random(200) < rate).astype(float))

    check_false_verdicts(draw)


def test_what_cuts_hide_widens_the_bounds_on_either_side():
    of = counted(drawn(200, np.random.default_rng(5), gain=1.0))
    hides = of._replace(too_high=np.full(len(of.excess), 0.2), too_low=np.full(len(of.excess), 0.3))
    hides, of = (each._replace(range=np.full(len(of.excess), 1e9)) for each in (hides, of))
    assert bound(hides, 0.05) == pytest.approx(bound(of, 0.05) - 0.2, abs=5e-3)
    assert bound(hides, 0.05, -1) == pytest.approx(bound(of, 0.05, -1) + 0.3, abs=5e-3)


@pytest.mark.slow
def test_false_verdicts_are_rare_where_cuts_hide_the_slow_successes_of_one_arm():
    rng = np.random.default_rng(10)

    def draw():
        is_policy, is_success = rng.random((2, 300)) < 0.5
        slow, fast, failing = rng.gamma(4.0, 2.0, 300), rng.gamma(2.0, 0.5, 300), rng.gamma(2.0, 1.0, 300)
        needed = np.where(is_success, np.where(is_policy, fast, slow), failing)
        end_s = np.minimum(needed, rng.exponential(5.0, 300))
        is_finished = needed == end_s
        seen = (np.where(is_finished, each, np.nan) for each in (is_success, needed))
        trajectory = np.arange(300)
        return Courses(is_policy, np.full(300, 0.5), end_s, is_finished, trajectory, np.zeros((300, 0)), *seen)

    check_false_verdicts(draw)
