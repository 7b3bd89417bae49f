import numpy as np
import pytest
from sklearn.kernel_ridge import KernelRidge
from trials import log_of

from halfseen.learning import CensoredQLearner, KernelQ
from halfseen.learning.q_space import fit_kernel_map
from halfseen.world import Scene, TableWorld, UniformPolicy

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
    assert few.kernel_map_ is not None
    assert few.kernel_map_.projection.shape[0] == 60
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
