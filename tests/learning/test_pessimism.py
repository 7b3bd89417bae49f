"""Q at its lower confidence bound, and what actions have in common: by hand, in eq. 3 and in what the policy takes."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from naive_q_learning import naive_q, naive_ridge
from random_logs import random_log
from trials import log_of

from halfseen.errors import ArgumentError
from halfseen.evaluation.held_out import learn_by_folds
from halfseen.learning import CensoredQLearner, QuadraticQ, q_learner
from halfseen.learning.recursion import SHRUNK_MEANS, fit_q
from halfseen.learning.ridge import ridge_of, solve
from halfseen.learning.sums import Regression

REG = 0.02
COVARIATES = ["x1", "x2"]


def trial(num_trajectories=60, seed=0, horizon=1):
    """Two stages or one; A is common, B is rare, and rewards are noisy."""
    rng = np.random.default_rng(seed)
    rows = []
    for _ in range(num_trajectories * horizon):
        x1, x2 = rng.normal(size=2) * [1.0, 5.0]
        action = "B" if rng.random() < 0.25 else "A"
        reward = (x1 if action == "A" else 0.3 * x2) + rng.normal()
        rows.append((action, reward, x1, x2))
    return log_of(**pd.DataFrame(rows, columns=["action", "reward", *COVARIATES]), num_stages=horizon)


def fitted_by_hand(x, y, reg, num_trajectories):
    """Ridge with a free offset on scaled features: its predictions, and its standard errors as Bayes has them."""
    mean, scale = x.mean(axis=0), x.std(axis=0)
    z = (x - mean) / scale
    penalised = z.T @ z + reg * num_trajectories * np.eye(z.shape[1])
    beta = np.linalg.solve(penalised, z.T @ (y - y.mean()))
    used = 1.0 + np.trace(np.linalg.solve(penalised, z.T @ z))
    variance = ((y - y.mean() - z @ beta) ** 2).sum() / (len(y) - used)

    def at(new):
        apart = (new - mean) / scale
        leverage = 1.0 / len(y) + np.einsum("if,fg,ig->i", apart, np.linalg.inv(penalised), apart)
        return y.mean() + apart @ beta, np.sqrt(variance * leverage)

    return at


def by_hand(logs, strength, reg=REG):
    """Lower bounds of both actions in the last stage, and Q of the stage before by the largest of them."""
    frame, n = logs.stages, logs.num_trajectories
    horizon, after = logs.horizon, np.zeros(n)
    for stage in range(horizon, 0, -1):
        rows = frame[frame["stage"] == stage]
        x, y = rows[COVARIATES].to_numpy(), rows["reward"].to_numpy() + after
        q, s = np.empty((n, 2)), np.empty((n, 2))
        for column, name in enumerate("AB"):
            mine = (rows["action"] == name).to_numpy()
            q[:, column], s[:, column] = fitted_by_hand(x[mine], y[mine], reg, n)(x)
        after = (q - strength * s).max(axis=1)
    return q, q - strength * s


@pytest.mark.parametrize("horizon", [1, 2])
@pytest.mark.parametrize("strength", [0.5, 2.0])
def test_bounds_are_those_of_a_bayesian_ridge_in_every_stage(horizon, strength):
    logs = trial(horizon=horizon)
    learner = CensoredQLearner.of_paper(horizon, ["A", "B"], COVARIATES, reg=REG, pessimism=strength).fit(logs)
    first = logs.stages[logs.stages["stage"] == 1]
    q, low = by_hand(logs, strength)
    np.testing.assert_allclose(learner.q_values(first, 1), q, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(learner.policy_.lower_bounds(first, 1), low, rtol=1e-9, atol=1e-9)
    by_bounds = replace(learner.policy_, behaviour=None)
    np.testing.assert_array_equal(by_bounds.decide(first, 1), np.where(low[:, 0] >= low[:, 1], "A", "B"))


def test_without_pessimism_equation_three_is_as_it_stands():
    logs = trial(horizon=2)
    fixed, plain = (
        CensoredQLearner.of_paper(2, ["A", "B"], COVARIATES, reg=REG, **given).fit(logs)
        for given in ({"pessimism": 0.0}, {"pessimism": "auto"})
    )
    np.testing.assert_array_equal(fixed.q_functions_.coefficients, plain.q_functions_.coefficients)
    assert fixed.policy_.margin is fixed.policy_.behaviour is None
    first = logs.stages[logs.stages["stage"] == 1]
    np.testing.assert_array_equal(fixed.policy_.lower_bounds(first, 1), fixed.q_values(first, 1))


def test_what_one_lucky_stage_speaks_for_is_not_taken():
    """B was tried three times, and brought much by luck; A is well known."""
    rng = np.random.default_rng(0)
    n = 100
    action = np.where(np.arange(n) < 3, "B", "A")
    reward = np.where(action == "B", [1.5, -3.0, 4.5, *[0.0] * (n - 3)], rng.normal(size=n) * 0.1 + 0.5)
    bold, wary = (
        CensoredQLearner(1, ["A", "B"], pessimism=each, q_function="linear").fit(log_of(action, reward))
        for each in (0, "auto")
    )
    here = pd.DataFrame(index=[0])
    assert bold.decide(here, 1).tolist() == ["B"]
    assert wary.decide(here, 1).tolist() == ["A"]


def test_cut_stages_count_as_nothing_seen():
    """Imputed targets of cut stages make the bound no narrower than the completed stages alone."""
    logs = trial(200)
    is_cut = (logs.stages["action"] == "B").to_numpy() & (np.arange(200) % 2 == 0)
    cut = log_of(**logs.stages[["action", "reward", *COVARIATES]], ends_s=np.where(is_cut, 0.5, 1.0), is_seen=~is_cut)
    imputed, completed = (
        CensoredQLearner.of_paper(1, ["A", "B"], COVARIATES, reg=REG, pessimism=1.0, censoring=each).fit(cut)
        for each in ("buckley-james", "none")
    )
    here = logs.stages.iloc[:20]
    gaps = [each.q_values(here, 1) - each.policy_.lower_bounds(here, 1) for each in (imputed, completed)]
    np.testing.assert_allclose(gaps[0], gaps[1], rtol=0.05)


@pytest.mark.parametrize("strength", [-1.0, np.nan, "much", True])
def test_a_strength_that_is_none_is_refused(strength):
    with pytest.raises(ArgumentError, match="pessimism is"):
        CensoredQLearner(1, ["A", "B"], pessimism=strength).fit(trial())


def test_a_quadratic_q_is_least_squares_on_products():
    logs = trial(200)
    learner = CensoredQLearner.of_paper(1, ["A", "B"], COVARIATES, reg=0.0, q_function=QuadraticQ()).fit(logs)
    x = logs.stages[COVARIATES].to_numpy()
    design = np.column_stack([np.ones(200), x, x[:, 0] ** 2, x[:, 0] * x[:, 1], x[:, 1] ** 2])
    mine = (logs.stages["action"] == "B").to_numpy()
    answer = np.linalg.lstsq(design[mine], logs.stages["reward"].to_numpy()[mine], rcond=None)[0]
    np.testing.assert_allclose(learner.q_values(logs.stages, 1)[:, 1], design @ answer, rtol=1e-8, atol=1e-8)


BLOCKS = (0, 1, 1, 2)


def regression(stages, regs, num_folds=1):
    regs = np.atleast_1d(np.asarray(regs, dtype=float))
    return Regression(np.array(BLOCKS), 3, regs, num_folds, stages, is_partially_pooled=True)


def naive_step(log, rows, reg, before):
    """One regression of (trajectory, stage, target) triples; `before` is the common Q and those of blocks."""
    n, common, of_blocks = len(log.action), *before
    x = np.array([log.features[i, t, log.action[i, t]] for i, t, _ in rows])
    w, y = np.array([log.weight[i, t] for i, t, _ in rows]), np.array([target for *_, target in rows])
    block = np.array([BLOCKS[log.action[i, t]] for i, t, _ in rows])
    now = common + naive_ridge(x, y - common[0] - x @ common[1:], w, reg, n)
    fitted = []
    for k in range(3):
        mine, centre = block == k, now + of_blocks[k] - common
        rest = y[mine] - centre[0] - x[mine] @ centre[1:]
        found = naive_ridge(x[mine], rest, w[mine], reg, n)
        if w[mine].sum():
            mean = np.average(rest, weights=w[mine])
            found[0] += mean * w[mine].sum() / (w[mine].sum() + SHRUNK_MEANS * reg * n) - mean
        fitted.append(centre + found)
    return now, np.array(fitted)


@pytest.mark.parametrize("reg", [0.0, 0.1, 1.0])
@pytest.mark.parametrize("stages", ["separate", "pooled"])
def test_equation_three_by_loops(stages, reg):
    log = random_log(0, blocks=BLOCKS, ends_with=None)
    log = log._replace(fold=log.fold * 0)
    n, horizon = log.action.shape
    completed = [(i, t) for i in range(n) for t in range(horizon) if log.weight[i, t] > 0]
    nothing = np.zeros(log.features.shape[-1] + 1), np.zeros((3, log.features.shape[-1] + 1))

    def value(beta, i, t):
        if beta is None or log.is_last[i, t] or t == horizon - 1:
            return 0.0
        q = naive_q(beta, log.features[i, t + 1], BLOCKS)
        return max(q[a] for a in range(len(BLOCKS)) if log.is_possible[i, t + 1, a])

    expected, before, after = [], nothing, None
    for step in range(horizon):
        here = [(i, t) for i, t in completed if t == horizon - 1 - step]
        if stages == "pooled":
            here = [(i, t) for i, t in completed if step == 0 or t < horizon - 1]
        rows = [(i, t, log.reward[i, t] + value(after, i, t)) for i, t in here]
        before = naive_step(log, rows, reg, before if stages == "pooled" else nothing)
        after = before[1]
        expected.append(after)
    expected = expected[::-1] if stages == "separate" else expected
    assert fit_q(log, regression(stages, reg)).coefficients == pytest.approx(np.array(expected), abs=1e-8)


def test_one_reg_serves_all_blocks():
    log = random_log(2, blocks=BLOCKS, ends_with=None)
    log = log._replace(fold=log.fold % 4)
    found = fit_q(log, regression("separate", [1e-3, 0.03, 0.3, 3.0], num_folds=4))
    assert (found.reg == found.reg[:, :1]).all()


def test_the_joint_reg_has_the_smallest_error_of_all_blocks():
    rng = np.random.default_rng(0)
    regs, x = (
        np.array([0.01, 0.1, 1.0, 10.0]),
        np.concatenate([np.ones((3, 2, 30, 1)), rng.normal(size=(3, 2, 30, 4))], -1),
    )
    y = x @ rng.normal(size=5) + 2.0 * rng.normal(size=(3, 2, 30))
    gram, cross = np.einsum("vkrf,vkrg->vkfg", x, x), np.einsum("vkrf,vkr->vkf", x, y)

    def error(reg):
        total = 0.0
        for fold in range(3):
            rest = [v for v in range(3) if v != fold]
            for k in range(2):
                ridge = ridge_of(gram[rest].sum(axis=0)[None, k : k + 1], np.array([reg]), 40, is_scaled=False)
                beta = solve(ridge, cross[rest].sum(axis=0)[None, k : k + 1])[0][0]
                total += ((y[fold, k] - x[fold, k] @ beta) ** 2).sum()
        return total

    _, chosen = solve(ridge_of(gram, regs, 60, is_scaled=False), cross, is_joint=True)
    assert (chosen == regs[np.argmin([error(reg) for reg in regs])]).all()


def one_stage(seed, num_actions=10, n=60):
    """All actions but the fourth are worth the same; a covariate says most of the reward."""
    rng = np.random.default_rng(seed)
    x, action = rng.normal(size=n), rng.permutation(np.arange(n) % num_actions)
    reward = 3.0 * x + 0.5 * (action == 3) + 0.3 * rng.normal(size=n)
    return log_of([f"a{a}" for a in action], reward, x=x)


def learner_of(num_actions=10, **changed):
    return CensoredQLearner(1, [f"a{a}" for a in range(num_actions)], ["x"], **changed)


@pytest.mark.parametrize(
    ("num_actions", "changed", "is_pooled"),
    [(8, {}, True), (7, {}, False), (8, {"pessimism": 1.0}, True), (8, {"pessimism": 0.0}, False)],
)
def test_many_actions_are_pooled_where_there_is_pessimism(num_actions, changed, is_pooled):
    assert learner_of(num_actions, **changed).compose().has_many_actions == is_pooled
    assert not CensoredQLearner.of_paper(1, [f"a{a}" for a in range(10)], ["x"]).compose().has_many_actions


@pytest.mark.slow
def test_policies_of_folds_are_learned_the_same_way():
    log = one_stage(0)
    folds = learn_by_folds(learner_of().fit(log), log, num_folds=2)
    for k, policy in enumerate(folds.policies):
        own = learner_of().fit(log.select(log.trajectory_ids[folds.fold != k])).policy_
        np.testing.assert_allclose(policy.coefficients, own.coefficients, rtol=1e-12)
        np.testing.assert_allclose(policy.margin, own.margin, rtol=1e-12)


@pytest.mark.slow
def test_q_of_few_rows_of_many_actions_is_nearer_to_the_truth(monkeypatch):
    def error():
        squares = []
        for log in (one_stage(seed) for seed in range(40)):
            frame = log.stages[["x"]]
            truth = 3.0 * frame.to_numpy() + 0.5 * (np.arange(10) == 3)
            squares.append(np.mean((learner_of().fit(log).policy_.q_values(frame, 1) - truth) ** 2))
        return np.sqrt(np.mean(squares))

    pooled = error()
    monkeypatch.setattr(q_learner, "MANY_ACTIONS", 11)
    assert pooled < 0.5 * error()
