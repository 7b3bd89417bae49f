"""A policy beside its baselines: by hand, exact ties, several at once, verdicts over all; and policies of tables."""

import json
from itertools import combinations

import numpy as np
import pytest
from enumerated_trial import CHANCE_B, StatePolicy, specified, trial, truth
from scipy import stats

from halfseen.errors import ArgumentError, HalfseenWarning
from halfseen.evaluation import Baseline, FixedSequence, evaluate
from halfseen.evaluation.comparison import Contender, compared, deciding, hochberg, joint_reason
from halfseen.evaluation.simulation import compare_in_world, evaluate_in_world
from halfseen.evaluation.targets import baselines_of, target_probabilities
from halfseen.learning.rows import trajectory_arrays
from halfseen.logs import Logs
from halfseen.planners import GreedyPolicy
from halfseen.tables import TableTask
from halfseen.world import ExploringPolicy, Scene, TableWorld, UniformPolicy, WorldConfig

TARGET = StatePolicy((0.1, 0.8))


def contender(name, values, size=50.0, **more):
    return Contender(name, np.asarray(values, dtype=float), effective_sample_size=size, **more)


def drawn(*means, num_trajectories=50, seed=0):
    """What trajectories add to policies whose difference has these means, in standard errors."""
    rng = np.random.default_rng(seed)
    ours, noise = rng.normal(size=num_trajectories), rng.normal(size=(len(means), num_trajectories))
    noise = (noise - noise.mean(axis=1, keepdims=True)) / noise.std(axis=1, ddof=1, keepdims=True)
    theirs = [ours - each - mean / np.sqrt(num_trajectories) for each, mean in zip(noise, means, strict=True)]
    return contender("ours", ours), [contender(f"baseline {k}", each) for k, each in enumerate(theirs)]


def evaluated(logs, against, policy=TARGET):
    return evaluate(policy, logs, against=against, **specified())


def test_the_difference_is_that_of_what_each_trajectory_adds():
    ours, theirs = np.array([1.0, 4.0, 2.0, 5.0]), np.array([0.5, 3.0, 2.5, 1.0])
    (found,) = compared(contender("ours", ours, 4.0), [contender("theirs", theirs, 3.0)], 0.9)
    error = np.std([0.5, 1.0, -0.5, 4.0], ddof=1) / 2.0
    reach, difference = stats.t.ppf(0.95, 2.0) * error, found.difference
    assert (difference.value, found.value.value) == pytest.approx((1.25, 1.75))
    assert (difference.low, difference.high) == pytest.approx((1.25 - reach, 1.25 + reach))
    assert found.p == pytest.approx(2.0 * stats.t.sf(1.25 / error, 2.0))


def test_each_baseline_is_worth_what_it_is_worth_alone_and_differences_add_up():
    logs, others = trial(0, cut_rate=0.1), [StatePolicy((0.5, 0.5)), FixedSequence(("B", "A"))]
    found = evaluated(logs, ["logging", *(Baseline(each, f"baseline {k}") for k, each in enumerate(others))])
    alone = [evaluated(logs, "logging", each).doubly_robust for each in others]
    first, *values = (each.value for each in found.comparisons)
    assert first == found.logging
    assert [each.value for each in values] == pytest.approx([each.value for each in alone], rel=1e-12)
    assert [each.standard_error for each in values] == pytest.approx([each.standard_error for each in alone])
    for each in found.comparisons:
        assert each.difference.value == pytest.approx(found.doubly_robust.value - each.value.value, abs=1e-12)
        assert each.difference.effective_sample_size <= found.doubly_robust.effective_sample_size


def test_a_policy_against_itself_is_exactly_nothing_and_never_better():
    found = evaluated(trial(1, cut_rate=0.1), Baseline(TARGET, "itself"))
    (itself,) = found.comparisons
    difference = itself.difference
    assert (difference.value, difference.low, difference.high, difference.standard_error) == (0.0, 0.0, 0.0, 0.0)
    assert (itself.p, found.verdict) == (1.0, "not better")
    assert "it earns as much a trajectory as itself" in found.sentence


def test_better_is_better_than_each_and_among_many_one_small_p_value_is_no_evidence():
    ours, theirs = drawn(2.2, 3.0)
    both = compared(ours, theirs, 0.95)
    assert [each.verdict for each in both] == ["better", "better"]
    assert all(each.difference.low > 0 for each in both)
    ours, theirs = drawn(1.9, 9.0)
    one = compared(ours, theirs, 0.95)
    assert [each.verdict for each in one] == ["inconclusive", "better"]
    assert deciding(one) is one[0]
    assert "more a trajectory than baseline 0, though" in joint_reason(one)
    assert "more than baseline 1" in joint_reason(one).partition("; ")[0]
    ours, theirs = drawn(2.2, 3.0)
    theirs[1] = theirs[1]._replace(why_unknown="the log does not show it; log it")
    two = compared(ours, theirs, 0.95)
    assert joint_reason(two).startswith("the log does not show it, though it earns ")
    assert joint_reason(two).endswith(" more than baseline 0; log it")
    ours, theirs = drawn(2.2, 0.1, -0.3, 0.2)
    first, *_ = compared(ours, theirs, 0.95)
    assert first.difference.low > 0
    assert first.p < 0.05 < first.adjusted_p
    assert first.verdict == "inconclusive"
    assert "not significant among so many baselines" in first.reason
    assert compared(ours, theirs[:1], 0.95)[0].verdict == "better"


def test_adjusted_p_values_are_hochbergs_and_reject_no_more_true_nulls_than_the_level():
    # Rejects, by definition, the k least p-values for the largest k with p_(k) ≤ α / (m − k + 1).
    rng = np.random.default_rng(3)
    for _ in range(200):
        p = rng.random(rng.integers(1, 6)) ** 3
        for level in (0.01, 0.05, 0.2):
            ranked = np.sort(p)
            passed = [k for k in range(1, len(p) + 1) if ranked[k - 1] <= level / (len(p) - k + 1)]
            rejected = p <= (ranked[passed[-1] - 1] if passed else -1.0)
            np.testing.assert_array_equal(hochberg(p) <= level, rejected)
        assert hochberg(p).max() == p.max()
    for correlation in (-0.9, 0.0, 0.9):
        z = rng.multivariate_normal([0.0, 0.0], [[1.0, correlation], [correlation, 1.0]], size=4_000)
        p = 2.0 * stats.norm.sf(np.abs(z))
        wrong = np.mean([(hochberg(each) <= 0.05).any() for each in p])
        assert wrong < 0.05 + 3.0 * np.sqrt(0.05 * 0.95 / len(p))


def test_an_baseline_of_unseen_actions_spoils_its_own_comparison_alone():
    found = evaluated(trial(2), ["logging", FixedSequence(("A", "C"))])
    logging, sequence = found.comparisons
    assert (logging.verdict, sequence.verdict, found.verdict) == ("better", "inconclusive", "inconclusive")
    assert (sequence.value, sequence.difference, sequence.p) == (None, None, None)
    assert "the sequence A, C takes C in stage 2, which no trajectory" in sequence.reason
    assert found.difference == logging.difference
    assert "NaN" not in json.dumps(found.as_dict())


def test_the_default_is_the_logging_policy_with_and_without_its_exploration():
    found = evaluate(TARGET, trial(4, num_trajectories=1000), **specified())
    logging, rule = found.comparisons
    assert logging.baseline == "the logging policy"
    assert rule.baseline == "the logging policy without its exploration"
    assert (logging.verdict, rule.verdict, found.verdict) == ("better", "not better", "not better")
    assert found.sentence.startswith("Not better: it earns ")
    assert "less a trajectory than the logging policy without its exploration" in found.sentence
    assert "though" in found.sentence
    assert found.difference == rule.difference
    assert abs(rule.value.value - truth(CHANCE_B > 0.5)) < 3.0 * rule.value.standard_error


def test_every_kind_of_baseline_has_a_name(tmp_path):
    (tmp_path / "thumb.csv").write_text("x,action\n1,B\n,A\n")

    def guess(frame, stage):
        return np.where(frame["x"] == 1, "B", "A")

    in_person = Baseline(StatePolicy((0.0, 1.0)), "the rule in person")
    found = evaluated(trial(5), ["sequence:B, A", tmp_path / "thumb.csv", guess, TARGET, in_person])
    names = ["the sequence B, A", "the rule thumb.csv", "the rule guess", "the StatePolicy", "the rule in person"]
    assert [each.baseline for each in found.comparisons] == names
    for one, other in combinations([found.comparisons[k] for k in (1, 2, 4)], 2):
        assert one.value == other.value
    lines = str(found).splitlines()
    assert lines[0] == found.sentence
    assert [line.split("  ")[0] for line in lines[-5:]] == names
    assert all(line.rstrip().endswith(each.verdict) for line, each in zip(lines[-5:], found.comparisons, strict=True))


@pytest.mark.parametrize(
    ("against", "message"),
    [
        ([], "against is empty"),
        (["logging", "logging"], "names the logging policy twice"),
        ("rules.ods", "against is 'rules.ods'; give logging, logging-rule"),
        ("sequence:A,,B", "name an action for each stage"),
        ("sequence:A", "the sequence A is for 1 stage"),
        (3, "the int does not decide about the named actions"),
        ("nowhere.toml", "nowhere.toml: it cannot be read"),
    ],
)
def test_what_is_no_baseline_is_reported_in_one_line(against, message):
    with pytest.raises(ArgumentError, match=message) as refusal:
        evaluated(trial(6, num_trajectories=40), against)
    assert "\n" not in str(refusal.value)


def test_a_rule_of_other_spelling_than_the_log_is_warned_of(tmp_path):
    """A row that never matches would make of a rule another one, and of the policy a better one."""
    logs = trial(6, num_trajectories=40)
    stages = logs.stages.assign(colour=np.where(np.arange(len(logs.stages)) % 2, "red", "blue"))
    logs, file = Logs(stages, logs.trajectories), tmp_path / "rule.csv"
    for rule, result in (
        ("colour,action\nRed,A\n,B\n", "a row asks for colour = Red, which no log showed; did you mean 'red'?"),
        ("colour,action\nred,A\n,b\n", "it takes 'b', which no log showed; did you mean 'B'?"),
    ):
        file.write_text(rule)
        with pytest.warns(HalfseenWarning) as warned:
            baselines_of(str(file), logs)
        assert [str(each.message) for each in warned] == [f"{file}: {result}"]
    file.write_text("colour,action\nred,A\n,B\n")
    assert baselines_of(str(file), logs)[0].name == "the rule rule.csv"


def test_a_verdict_says_what_would_undo_it_and_an_open_one_or_one_without_cuts_nothing():
    ours, (far, near) = drawn(9.0, 0.5)
    rng = np.random.default_rng(4)
    excess, errors = rng.exponential(size=(50, 2)), rng.normal(size=(50, 2))
    first, *others = (one._replace(errors=errors * k) for k, one in enumerate((ours, far, near)))
    clear, unclear = compared(first, others, 0.95, excess)
    assert (clear.verdict, unclear.verdict, unclear.gamma) == ("better", "inconclusive", None)
    assert clear.gamma > 1.0
    assert compared(first, others, 0.95, 0.0 * excess)[0].gamma is None
    cut, uncut = (
        evaluate(StatePolicy((0.0, 1.0)), trial(8, cut_rate=rate), against=StatePolicy((1.0, 0.0)))
        for rate in (0.15, 0.0)
    )
    assert cut.verdict == "better"
    assert cut.comparisons[0].gamma > 1.0
    assert cut.sensitivity in str(cut).splitlines()[1]
    assert "To overturn this" in cut.sensitivity
    assert (uncut.verdict, uncut.sensitivity) == ("better", "")


def test_a_standard_error_does_not_hang_on_the_residuals_of_a_few_heavy_stages():
    """The heavy trajectory's residual happens to be 0; so its scatter says nothing of what its weight costs."""
    weights = np.full((50, 2), 0.5)
    weights[0] = 25.5
    one = Contender("ours", np.zeros(50), weights=weights, deviation=2.0, effective_sample_size=2.0)
    least = 2.0 * np.sqrt((weights**2).sum()) / 50
    assert one.estimate(0.95).standard_error == pytest.approx(least)
    other = Contender("theirs", np.zeros(50), weights=np.ones((50, 2)), deviation=1.0, effective_sample_size=50.0)
    assert one.less(other, 0.95).standard_error == pytest.approx(2.0 * np.sqrt(((weights - 1.0) ** 2).sum()) / 50)
    same = one.less(one._replace(name="theirs"), 0.95)
    assert (same.low, same.high) == (0.0, 0.0)
    assert one._replace(weights=None).estimate(0.95).standard_error == 0.0


pytestmark = pytest.mark.slow

CONFIG = WorldConfig()
SCENE = Scene(np.array([[0.0, 0.5], [0.0, 0.0]]))
TASK = TableTask()
LOGGER = ExploringPolicy(GreedyPolicy(CONFIG, uses_history=True, counts_penalty=True), 0.4)


@pytest.fixture(scope="module")
def laid_out():
    logs = TableWorld().simulate(SCENE, LOGGER, episodes=40, seed=0, cut_share=0.3)
    return logs, trajectory_arrays(logs, TASK.encode(logs, 10), None)


def test_the_logging_policy_would_have_done_it_as_likely_as_it_was_logged(laid_out):
    logs, trajectories = laid_out
    chances = target_probabilities(LOGGER, logs, trajectories, TASK)
    np.testing.assert_allclose(chances.sum(axis=2)[trajectories.is_begun], 1.0, rtol=1e-6)
    taken = np.take_along_axis(chances, trajectories.action[..., None], axis=2)[..., 0]
    np.testing.assert_allclose(taken[trajectories.is_begun], trajectories.probability[trajectories.is_begun], rtol=1e-5)


def test_a_policy_without_chance_takes_one_possible_action(laid_out):
    logs, trajectories = laid_out
    chances = target_probabilities(LOGGER.base, logs, trajectories, TASK)
    assert set(np.unique(chances)) == {0.0, 1.0}
    np.testing.assert_array_equal(chances.sum(axis=2), trajectories.is_begun)
    assert not (chances[~trajectories.is_possible] > 0).any()
    # The uniform policy shares among what is possible.
    chances = target_probabilities(UniformPolicy(), logs, trajectories, TASK)[trajectories.is_begun]
    possible = trajectories.is_possible[trajectories.is_begun]
    np.testing.assert_allclose(chances, possible / possible.sum(axis=1, keepdims=True), rtol=1e-6)


def test_the_world_pays_what_its_episodes_hold():
    found = evaluate_in_world(UniformPolicy(), [SCENE], CONFIG, episodes=2500, seed=1)
    logs = TableWorld().simulate(SCENE, UniformPolicy(), episodes=2500, seed=7)
    mean = logs.stages.groupby("trajectory")["reward"].sum().mean()
    assert abs(found.value.value - mean) < 4.0 * found.value.standard_error
    assert found.value.low < found.value.value < found.value.high


def test_heuristics_meet_the_same_episodes():
    others = {"itself": LOGGER.base, "chance": UniformPolicy()}
    found, (itself, chance) = compare_in_world(LOGGER.base, others, [SCENE], CONFIG, episodes=300, seed=1)
    assert found == evaluate_in_world(LOGGER.base, [SCENE], CONFIG, episodes=300, seed=1)
    assert (itself.value, itself.difference.value, itself.difference.standard_error) == (found.value, 0.0, 0.0)
    assert chance.difference.value == pytest.approx(found.value.value - chance.value.value)
    assert chance.difference.low > 0
