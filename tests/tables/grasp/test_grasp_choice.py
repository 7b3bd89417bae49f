"""What tells grasps: what held-out attempts choose, of all or of each robot, and what a grip counts beside it."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.optimize import minimize
from scipy.special import expit, logit
from tried import beta_attempts, cut_some

from halfseen.arrays import stacked
from halfseen.censoring import censoring_weights
from halfseen.errors import ArgumentError, PolicyError
from halfseen.learning import CensoredQLearner
from halfseen.logs import Logs
from halfseen.policies.folder.kinds import check_shapes
from halfseen.policies.folder.table_kinds import grasp_arrays, grasp_of, grasp_shapes
from halfseen.tables import BetaGrasp, TeamTask
from halfseen.tables.features import NUM_LIFT, NUM_WASH, table_columns, team_features
from halfseen.tables.grasp_choice import FEWEST_ATTEMPTS, NUM_FOLDS, choose_by, choose_grasp, fit_grip_effect
from halfseen.tables.grasp_choice import GRIP_SPREAD as SPREAD
from halfseen.tables.grasp_table import GraspByRobot, GraspTable, GripEffect, tabulate
from halfseen.world import Scene, TableWorld, UniformPolicy, Verb, random
from halfseen.world.transition import start, step
from own_laws import LOGISTIC, SCENE, WORLD, robots
from picked import assert_same, picked

HORIZON = 10


def attempts_of(num_objects, intercept, slope, seed=0):
    """Two objects a trajectory."""
    tried = cut_some(beta_attempts(num_objects, intercept=intercept, slope=slope, seed=seed))
    return tried.assign(trajectory=tried["object"] // 2, stage=1, grip=0.0)


def naive_beta(attempts):
    """Chances by the intercept, slope and log s that a search without gradients finds, sum by sum."""

    def chance(theta, occlusion, k, misses):
        strength = np.exp(theta[2])
        return (strength / (1 + np.exp(-theta[0] - theta[1] * occlusion)) + k) / (strength + k + misses)

    def loss(theta):
        total = (theta[0] / 5) ** 2 / 2 + (theta[1] / 5) ** 2 / 2 + ((theta[2] - np.log(2)) / 2) ** 2 / 2
        for occlusion, k, misses, held, weight in attempts:
            p = chance(theta, occlusion, k, misses)
            total -= weight * np.log(p if held else 1 - p)
        return total

    options = {"xatol": 1e-4, "fatol": 1e-4, "maxiter": 400}
    theta = minimize(loss, [0.0, 0.0, np.log(2)], method="Nelder-Mead", options=options).x
    return lambda *of: chance(theta, *of)


def by_hand(tried):
    """Squared errors of the rule and of the Beta, trajectory by trajectory."""
    tried = tried.assign(weight=censoring_weights(tried["time_s"], tried["is_finished"]))
    trajectories = sorted(set(tried["trajectory"]))
    columns = ["occlusion", "successes", "failures", "succeeded", "weight"]
    rows = {
        trajectory: tried[(tried["trajectory"] == trajectory) & tried["is_finished"]][columns].to_numpy(float)
        for trajectory in trajectories
    }
    errors = np.zeros((len(trajectories), 2))
    for k in range(NUM_FOLDS):
        beta = naive_beta(
            [row for rank, trajectory in enumerate(trajectories) if rank % NUM_FOLDS != k for row in rows[trajectory]]
        )
        for rank in range(k, len(trajectories), NUM_FOLDS):
            for occlusion, successes, failures, held, weight in rows[trajectories[rank]]:
                rule = (1 - occlusion) * (1 + successes) / (1 + successes + failures)
                said = np.array([rule, beta(occlusion, successes, failures)])
                errors[rank] += weight * (said - held) ** 2
    return errors.T


@pytest.mark.slow
@pytest.mark.parametrize(("intercept", "slope"), [(6.0, 0.0), (3.0, 0.0), (1.5, -3.0)])
def test_a_beta_is_taken_where_it_halves_the_error_of_held_out_attempts_beyond_noise(intercept, slope):
    tried = attempts_of(60, intercept, slope)
    rule, beta = by_hand(tried)
    lead = rule / 2 - beta
    chosen = choose_by(tried, HORIZON)
    assert f"{beta.sum() / rule.sum():.0%} of the squared error" in chosen.sentence
    assert (chosen.grasp is not None) == (lead.mean() > 2 * lead.std(ddof=1) / np.sqrt(len(lead))) == (slope == 0.0)
    if chosen.grasp is not None:
        model = BetaGrasp().fit(tried)
        expected = tabulate(model, HORIZON, fit_grip_effect(model, tried))
        np.testing.assert_array_equal(chosen.grasp.probabilities, expected.probabilities)
        assert "learned from the log’s attempts" in chosen.sentence


def test_where_the_rule_is_as_good_it_is_kept():
    rng = np.random.default_rng(3)
    tried = attempts_of(40, 3.0, 0.0).assign(successes=0.0, failures=0.0)
    succeeded = rng.random(len(tried)) < 1.0 - tried["occlusion"]
    kept = tried.assign(succeeded=succeeded.astype("boolean").mask(~tried["is_finished"]))
    chosen = choose_by(kept, HORIZON)
    assert chosen.grasp is None
    assert "does not clearly halve the error" in chosen.sentence


def test_few_attempts_decide_nothing():
    tried = attempts_of(60, 3.0, 0.0)
    chosen = choose_by(tried[np.cumsum(tried["is_finished"]) < FEWEST_ATTEMPTS], HORIZON)
    assert chosen.grasp is None
    assert f"{FEWEST_ATTEMPTS - 1} decided attempts are too few" in chosen.sentence


@pytest.fixture(scope="module")
def logs():
    hides = np.zeros((4, 4))
    hides[1, 0], hides[2, 1], hides[3, 2] = 0.7, 0.45, 0.33
    return TableWorld().simulate(Scene(hides), UniformPolicy(), episodes=60, seed=0, cut_share=0.3)


def test_the_learner_chooses_by_itself_says_why_and_keeps_the_rule_where_the_log_tells_no_outcomes(logs):
    chosen = choose_grasp(logs, HORIZON)
    learner = CensoredQLearner.for_table(reg=1.0).fit(logs)
    assert learner.chosen_ == (chosen.sentence,)
    assert isinstance(learner.policy_.grasp, GraspTable) == (chosen.grasp is not None)
    silent = choose_grasp(Logs(logs.stages, logs.trajectories, logs.objects.assign(successes=0, failures=0)), HORIZON)
    assert silent.grasp is None
    assert "fix the counts" in silent.sentence


class Even:
    """Says the same of every attempt."""

    def fit(self, frame):
        return self

    def predict_proba(self, frame):
        return np.full((len(frame), 2), 0.5)


def gripped(num_attempts, shift, per_grip, seed=0):
    """Attempts that hold with log-odds shift + per_grip · grip."""
    rng = np.random.default_rng(seed)
    tried = beta_attempts(num_attempts, num_tries=1, seed=seed)
    grip = rng.normal(0.0, 2.0, num_attempts)
    succeeded = rng.random(num_attempts) < expit(shift + per_grip * grip)
    return tried.assign(grip=grip, succeeded=succeeded)


def test_it_is_a_ridge_regression_whose_offset_is_the_model():
    """scikit-learn's penalty is the same for all coefficients, so the columns are scaled by their spreads."""
    from sklearn.linear_model import LogisticRegression

    tried = cut_some(gripped(300, 0.4, 0.7))
    weight = censoring_weights(tried["time_s"], tried["is_finished"])
    seen = tried["is_finished"].to_numpy()
    columns = np.column_stack([np.ones(len(tried)), tried["grip"]]) * SPREAD
    peer = LogisticRegression(C=1.0, fit_intercept=False, tol=1e-10, max_iter=1000)
    peer.fit(columns[seen], tried["succeeded"][seen].astype(bool), sample_weight=weight[seen])
    np.testing.assert_allclose(fit_grip_effect(Even(), tried), peer.coef_[0] * SPREAD, atol=1e-5)


def test_many_attempts_tell_what_is_true():
    effect = fit_grip_effect(Even(), gripped(20_000, -0.5, 0.4))
    np.testing.assert_allclose(effect, (-0.5, 0.4), atol=0.05)


def test_attempts_that_a_grip_tells_apart_do_not_run_away():
    few = gripped(12, 0.0, 1.0)
    assert 0.0 < fit_grip_effect(Even(), few.assign(succeeded=few["grip"] > 0)).per_grip < 3 * SPREAD[1]


def test_where_no_grip_was_seen_there_is_no_effect():
    tried = gripped(100, 1.0, 0.5).assign(grip=0.0)
    assert fit_grip_effect(Even(), tried) == GripEffect(0.0, 0.0)


def test_a_spread_about_the_mean_pulls_it_together():
    rng, spread = np.random.default_rng(1), 3.6
    tried = gripped(40_000, 0.0, 1.0, seed=1)
    succeeded = rng.random(len(tried)) < expit(tried["grip"] + rng.normal(0.0, spread, len(tried)))
    per_grip = fit_grip_effect(Even(), tried.assign(succeeded=succeeded)).per_grip
    assert per_grip == pytest.approx(1.0 / np.sqrt(1.0 + 0.346 * spread**2), abs=0.03)


def test_it_moves_log_odds():
    effect = GripEffect(0.3, 0.5)
    np.testing.assert_allclose(logit(effect.moved(np.array([0.2, 0.9]), np.array([1.0, -2.0]))), [
        logit(0.2) + 0.8, logit(0.9) - 0.7,
    ])  # fmt: skip
    assert np.isfinite(effect.moved(np.array([0.0, 1.0]), 0.0)).all()


def test_a_model_that_knows_the_grip_on_average_is_improved_by_it():
    train, fresh = gripped(2_000, 1.0, 0.8), gripped(2_000, 1.0, 0.8, seed=9)
    beta = BetaGrasp().fit(train)
    said = beta.predict_proba(fresh)[:, 1]
    moved = fit_grip_effect(beta, train).moved(said, fresh["grip"].to_numpy())

    def loss(probability):
        return -np.mean(np.log(np.where(fresh["succeeded"], probability, 1.0 - probability)))

    assert loss(moved) < loss(said) - 0.05


def test_a_grip_that_is_no_number_is_refused():
    tried = pd.DataFrame(gripped(50, 0.0, 0.5))
    tried.loc[3, "grip"] = np.nan
    with pytest.raises(ArgumentError, match=r"row 3: grip is nan; give a finite number"):
        fit_grip_effect(Even(), tried)


SURE, CLUMSY = replace(LOGISTIC, log_odds=3.0), replace(LOGISTIC, log_odds=-2.0)
KEY = random.key_of(2)


def world_of(*laws):
    return TableWorld(WORLD, robots=robots(*laws, reach_m=2.0), clearance_m=0.05)


def begun(world):
    """The first decision at the table."""
    return start(world.played_config, picked(world.layouts([SCENE]), 0), KEY)


def fitted(*laws, num_trajectories=300):
    logs = world_of(*laws).simulate([SCENE], UniformPolicy(), num_trajectories, seed=1, cut_share=0.2)
    return TeamTask(base=None).fitted(logs, 2 * WORLD.horizon)


@pytest.mark.slow
def test_robots_that_differ_are_distinguished_and_those_that_do_not_are_not():
    result = fitted(SURE, CLUMSY)
    assert isinstance(result.grasp, GraspByRobot)
    assert "own attempts" in result.chosen[-1]
    state, _ = begun(world_of(SURE, CLUMSY))
    # Of the object in full view before any attempt: the law, its hidden grip integrated out.
    offsets = LOGISTIC.offset_std * np.random.default_rng(0).standard_normal(100_000)
    for robot, law in enumerate((SURE, CLUMSY)):
        known = np.mean(1.0 / (1.0 + np.exp(-law.log_odds - offsets)))
        assert float(result.grasp.of(robot).probability(state)[-1]) == pytest.approx(known, abs=0.1)
    assert not isinstance(fitted(SURE, SURE).grasp, GraspByRobot)
    # Too few attempts tell nothing.
    assert not isinstance(fitted(SURE, CLUMSY, num_trajectories=5).grasp, GraspByRobot)


def by_robot():
    shared, *own = (
        GraspTable(np.full((3, 2, 2), chance, dtype=np.float32), np.float32(1.0)) for chance in (0.5, 0.9, 0.2)
    )
    return GraspByRobot(shared, stacked(own)), shared, own


def test_what_is_about_an_object_goes_by_who_is_at_it():
    model, shared, own = by_robot()
    world = world_of(None, None)
    state, hidden = begun(world)
    state, hidden, _ = step(world.played_config, state, hidden, np.int32(2), KEY)  # robot 0 washes 1, robot 1 decides
    assert int(state.decider) == 1
    of_0, of_1 = (table_columns(state, each).of_verb[Verb.WASH] for each in own)
    found, plain = (team_features(state, each) for each in (model, shared))
    # After WASH of 2 two are under way, each as its robot grasps; after FINISH that of robot 0.
    of_wash = slice(1, NUM_WASH)
    both = [one[1] + other[2] for one, other in zip(of_0, of_1, strict=True)]
    for action, known in ((1 + 2, both), (0, [each[1] for each in of_0])):
        np.testing.assert_allclose(found[action, of_wash], known, rtol=1e-5)
    # What the team can clear is the same, whichever robot decides.
    team = slice(NUM_WASH + NUM_LIFT, NUM_WASH + NUM_LIFT + 18)
    np.testing.assert_array_equal(found[:, team], plain[:, team])
    assert np.abs(found[:, of_wash] - plain[:, of_wash]).max() > 0.1
    # Where all grasp alike, nothing changes.
    alike = GraspByRobot(shared, stacked([shared, shared]))
    np.testing.assert_allclose(team_features(state, alike), plain, rtol=1e-6)


def test_it_comes_back_from_a_folder_and_what_does_not_fit_is_refused():
    model, _, _ = by_robot()
    arrays = grasp_arrays(model)
    check_shapes(arrays, grasp_shapes(arrays, 2), np.float32)
    again = grasp_of(arrays)
    assert isinstance(again, GraspByRobot)
    assert_same(again, model)
    without = {name: each for name, each in arrays.items() if name != "own.grasp.per_grip"}
    twos = {**arrays, "own.grasp.chances": arrays["own.grasp.chances"] * 0.0 + 2.0}
    for given, num_robots, message in (
        (arrays, 3, "the schema needs float32 of shape"),
        (without, 2, "'own.grasp.per_grip' is missing"),
        (twos, 2, "'own.grasp.chances' holds 2.0"),
    ):
        with pytest.raises(PolicyError, match=message):
            check_shapes(given, grasp_shapes(given, num_robots), np.float32)
