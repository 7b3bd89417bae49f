"""Kernel ridge beside scikit-learn, what is too large, and a smooth Q that promises too much."""

from functools import partial

import numpy as np
import pandas as pd
import pytest
from sklearn.kernel_ridge import KernelRidge
from trials import log_of

from halfseen.errors import ArgumentError
from halfseen.learning import CensoredQLearner, DiscretePolicy, KernelQ, behaviour, promise
from halfseen.learning.q_space import LinearQ, fit_kernel_map
from halfseen.logs import Logs
from halfseen.world import Scene, TableWorld, UniformPolicy
from small_logs import flat_log

GAMMA, REG = 0.7, 1e-3


def one_stage(num_trajectories=80, seed=0):
    rng = np.random.default_rng(seed)
    x = rng.normal(size=(num_trajectories, 2)) * [1.0, 10.0] + [0.0, 5.0]
    action = rng.choice(["A", "B"], num_trajectories)
    reward = np.where(action == "A", np.sin(2.0 * x[:, 0]), np.cos(x[:, 1] / 5.0))
    return log_of(action, reward, ends_s=rng.uniform(1, 2, num_trajectories), x1=x[:, 0], x2=x[:, 1])


def test_with_all_rows_as_landmarks_it_is_kernel_ridge_with_a_free_offset():
    """Equal to scikit-learn's on targets and kernel that are centred in feature space."""
    logs = one_stage()
    learner = CensoredQLearner.of_paper(1, ["A", "B"], ["x1", "x2"], q_function=KernelQ(1000, GAMMA), reg=REG).fit(logs)
    x, n = logs.stages[["x1", "x2"]].to_numpy(), logs.num_trajectories
    scaled = (x - x.mean(axis=0)) / x.std(axis=0)
    gram = np.exp(-GAMMA * ((scaled[:, None] - scaled[None]) ** 2).sum(axis=-1))
    q = learner.q_values(logs.stages, 1)
    for column, name in enumerate(["A", "B"]):
        mine = (logs.stages["action"] == name).to_numpy()
        y = logs.stages["reward"].to_numpy()[mine]
        centred = gram[np.ix_(mine, mine)]
        mean = centred.mean(axis=0)
        asked = gram[:, mine] - mean - gram[:, mine].mean(axis=1, keepdims=True) + mean.mean()
        centred = centred - mean - mean[:, None] + mean.mean()
        ridge = KernelRidge(alpha=REG * n, kernel="precomputed").fit(centred, y - y.mean())
        np.testing.assert_allclose(q[:, column], ridge.predict(asked) + y.mean(), atol=1e-6)


def test_the_low_rank_form_is_near_the_exact_one():
    logs = one_stage(400)
    exact, few = (
        CensoredQLearner.of_paper(1, ["A", "B"], ["x1", "x2"], q_function=KernelQ(size, gamma=0.5), reg=REG).fit(logs)
        for size in (400, 60)
    )
    assert few.model_.kernel_map is not None
    assert few.model_.kernel_map.projection.shape[0] == 60
    difference = few.q_values(logs.stages, 1) - exact.q_values(logs.stages, 1)
    assert np.abs(difference).max() < 0.02 * np.ptp(exact.q_values(logs.stages, 1))


def test_a_covariate_that_never_varies_is_ignored():
    rows = np.random.default_rng(0).normal(size=(30, 3))
    rows[:, 1] = 4.2
    features = fit_kernel_map(rows, 30, None, np.random.default_rng(0))
    moved = rows + np.array([0.0, 3.0, 0.0])
    np.testing.assert_allclose(features(moved), features(rows))
    scaled = ((rows - rows.mean(axis=0)) / rows.std(axis=0))[:, [0, 2]]
    gram = np.exp(-((scaled[:, None] - scaled[None]) ** 2).sum(axis=-1) / 2.0)
    np.testing.assert_allclose(features(rows) @ features(rows).T, gram, atol=1e-6)


@pytest.mark.slow
def test_a_table_has_a_kernel_q_too():
    scene = Scene(np.array([[0.0, 0.5], [0.0, 0.0]]))
    logs = TableWorld().simulate(scene, UniformPolicy(), episodes=60, seed=0, cut_share=0.3)
    learner = CensoredQLearner.for_table(10, q_function=KernelQ(40)).fit(logs)
    played = TableWorld().simulate(scene, learner.policy_, episodes=60, seed=1)
    logged = TableWorld().simulate(scene, UniformPolicy(), episodes=60, seed=1)
    earned = [one.stages.groupby("trajectory")["reward"].sum().mean() for one in (played, logged)]
    assert earned[0] > earned[1] + 2.0


def wide_log(num_actions, num_covariates, num_texts=0, n=120):
    rng = np.random.default_rng(0)
    reward, covariates = rng.normal(size=n), {f"x{j}": rng.normal(size=n) for j in range(num_covariates)}
    covariates |= {f"t{j}": [f"c{k % 17}" for k in rng.permutation(n)] for j in range(num_texts)}
    return log_of([f"a{k % num_actions}" for k in range(n)], reward, **covariates), list(covariates)


def learner_of(num_actions, covariates, **how):
    return CensoredQLearner(1, [f"a{k}" for k in range(num_actions)], covariates, **how)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("num_actions", "num_covariates", "num_texts", "is_linear"),
    [(16, 8, 0, False), (3, 20, 0, False), (16, 32, 0, True), (16, 8, 2, True)],
)
def test_too_many_products_give_way_and_it_is_said(num_actions, num_covariates, num_texts, is_linear):
    log, covariates = wide_log(num_actions, num_covariates, num_texts)
    learner = learner_of(num_actions, covariates).fit(log)
    assert (learner.policy_.kernel_map is None) == is_linear
    assert any("Q is linear" in why for why in learner.chosen_) == is_linear


def test_what_is_asked_for_is_kept_or_refused_before_it_fills_the_memory():
    log, covariates = wide_log(16, 60)
    with pytest.raises(ArgumentError, match=r"1890 features for each of 16 actions take .* GB"):
        learner_of(16, covariates, q_function="quadratic").fit(log)
    assert learner_of(16, covariates, q_function=KernelQ(num_landmarks=20)).fit(log).policy_.kernel_map is not None


def test_a_choice_of_many_coefficients_is_found_without_its_curvature(monkeypatch):
    rng = np.random.default_rng(1)
    features = np.repeat(rng.normal(size=(300, 1, 5)), 4, axis=1)
    possible, taken, blocks = np.ones((300, 4), bool), rng.integers(0, 4, 300), np.arange(4)
    by_newton = behaviour.conditional_logit(features, possible, taken, blocks)
    monkeypatch.setattr(behaviour, "MOST_FOR_NEWTON", 1)
    np.testing.assert_allclose(behaviour.conditional_logit(features, possible, taken, blocks), by_newton, atol=1e-4)


LOG = flat_log()
BROUGHT = LOG.stages.groupby("trajectory")["reward"].sum().loc[LOG.trajectory_ids[LOG.is_finished]]
RARE = float(np.quantile(BROUGHT, 0.95))


def promising(value):
    """A policy whose Q is the same everywhere in the first stage, but for an impossible action."""
    return DiscretePolicy(("A", "B"), (), np.array([[True, False]]), np.array([[[value], [1e6]]]))


@pytest.mark.parametrize(("value", "is_reported"), [(RARE - 0.01, False), (RARE + 0.01, True)])
def test_what_is_promised_is_held_against_what_one_in_twenty_finished_trajectories_brought(value, is_reported):
    said = promise.too_hopeful(promising(value), LOG)
    assert bool(said) == is_reported
    assert not is_reported or f"{value:.3g} a trajectory" in said


def test_few_finished_trajectories_say_nothing():
    few = LOG.select(LOG.trajectory_ids[:5])
    assert promise.too_hopeful(promising(1e9), few) == ""


def learner(**changed):
    return CensoredQLearner(2, {1: ["A", "B"], 2: ["A", "C"]}, ["x1", "x2"], **changed)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("changed", "linear_hopes", "lead", "why"),
    [
        ({}, False, -1.0, "promises 9 a trajectory"),
        ({}, True, -1.0, None),
        ({}, True, 0.25, "held out, its policy earns 0.25 more a trajectory"),
        ({"q_function": "smooth"}, False, 1.0, None),
    ],
)
def test_of_many_stages_a_default_smooth_q_proves_itself_beside_a_linear_one(
    monkeypatch, changed, linear_hopes, lead, why
):
    def hope(policy, logs):
        assert isinstance(logs, Logs)
        return "9 a trajectory" if linear_hopes or policy.kernel_map is not None else ""

    monkeypatch.setattr(promise, "too_hopeful", hope)
    monkeypatch.setattr(promise, "held_out_lead", lambda model, other, logs: lead)
    monkeypatch.setattr(promise, "FEWEST_TRAJECTORIES", 10)
    assert isinstance(learner(**changed).fit(LOG).model_.space, KernelQ), "of two stages it is believed"
    monkeypatch.setattr(promise, "MANY_STAGES", 2)
    found = learner(**changed).fit(LOG)
    assert isinstance(found.model_.space, KernelQ if why is None else LinearQ)
    assert why is None or any(why in each for each in found.chosen_)
    if why is not None:
        plain = learner(q_function="linear").fit(LOG)
        np.testing.assert_array_equal(found.policy_.coefficients, plain.policy_.coefficients)


def test_a_date_that_a_linear_q_cannot_hold_keeps_the_smooth_one(monkeypatch):
    dated = LOG.stages.assign(x1=1.7e9 + 1e3 * LOG.stages["x1"])
    monkeypatch.setattr(promise, "MANY_STAGES", 2)
    found = learner().fit(Logs(dated, LOG.trajectories))
    assert isinstance(found.model_.space, KernelQ)


def test_the_held_out_lead_is_that_of_least_squares_stage_by_stage():
    """Oracle: backwards, V of the given policy by least squares for each stage and action, on the other half."""
    plain = flat_log(num_trajectories=400, cut_after_s=1e9)
    noisy = plain.stages.assign(reward=np.random.default_rng(1).normal(size=len(plain.stages)))
    log = Logs(noisy, plain.trajectories)
    settings = {"reg": 0.0, "censoring": "none", "pessimism": 0.0, "q_function": "linear"}
    separate, pooled = (partial(learner, **settings, stages=stages) for stages in ("separate", "pooled"))
    found = promise.held_out_lead(pooled().fit(log).model_, separate().fit(log).model_, log)
    fold = np.random.default_rng([0, 6]).permutation(400) % 2
    half = [log.select(log.trajectory_ids[fold == k]) for k in range(2)]

    def value(policy, of):
        stages = of.stages.set_index("trajectory")
        later = 0.0
        for stage, names in ((2, ["A", "C"]), (1, ["A", "B"])):
            rows = stages[stages["stage"] == stage]
            design = np.column_stack([np.ones(len(rows)), rows[["x1", "x2"]]])
            target = rows["reward"] + (0.0 if stage == 2 else later.reindex(rows.index).fillna(0.0))
            takes, q = policy.decide(rows, stage), np.zeros(len(rows))
            for name in names:
                is_it = (rows["action"] == name).to_numpy()
                beta = np.linalg.lstsq(design[is_it], target[is_it], rcond=None)[0]
                q = np.where(takes == name, design @ beta, q)
            later = pd.Series(q, index=rows.index)
        return later.mean()

    each = [[value(made().fit(half[1 - k]).policy_, half[k]) for k in range(2)] for made in (pooled, separate)]
    assert found == pytest.approx(np.mean(each[0]) - np.mean(each[1]), abs=1e-9)
    assert abs(found) > 1e-3
