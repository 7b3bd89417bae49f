"""Learning on tables: a policy that earns more than what it watched, whatever the names of objects; priors; blocks."""

import numpy as np
import pandas as pd
import pytest
from scipy.special import expit

from halfseen.arrays import record
from halfseen.censoring import Cox, stage_weights
from halfseen.errors import ArgumentError, LogError
from halfseen.learning import CensoredQLearner, Task, Weighted
from halfseen.logs import Logs
from halfseen.policies.folder import read_policy, write_policy
from halfseen.tables import TableTask
from halfseen.tables.encoding import table_covariates
from halfseen.tables.present import logged_dirty_share
from halfseen.world import ActionSpace, ExploringPolicy, Scene, TableWorld, UniformPolicy, Verb, WorldConfig, random
from halfseen.world.cuts import cut, cut_rate
from halfseen.world.logs import to_logs
from halfseen.world.policy import surely
from halfseen.world.rollout import evaluate, play
from halfseen.world.state import pad_scenes

CONFIG = WorldConfig()
NUM_OBJECTS = 4


@record
class Hasty:
    """WASH what looks dirtiest, FINISH when all looks clean; hidden things and grips are nothing to it."""

    def decide(self, state, key):
        worth = np.where(state.is_on_table, state.log_odds, -np.inf)
        return surely(np.where(worth.max(axis=-1) > 0, 1 + worth.argmax(axis=-1), 0))


@pytest.fixture(scope="module")
def scene():
    hides = np.zeros((NUM_OBJECTS, NUM_OBJECTS))
    hides[2, 0], hides[3, 1], hides[3, 2] = 0.7, 0.5, 0.4
    return Scene(hides, name="four")


@pytest.fixture(scope="module")
def watched(scene):
    logger = ExploringPolicy(Hasty(), 0.5)
    return play(CONFIG, pad_scenes([scene]), logger, random.key_of(0), 400)


@pytest.fixture(scope="module")
def logs(watched, scene):
    cuts = cut(watched, cut_rate(watched, 0.3, "independent"), "independent", np.random.default_rng(0))
    return to_logs(cuts, "independent", [scene])


@pytest.fixture(scope="module")
def learner(logs):
    return CensoredQLearner.for_table(horizon=10, laws=None).fit(logs)


@pytest.mark.slow
def test_what_was_learned_beats_chance_and_what_it_watched(learner, scene):
    key, layouts = random.key_of(9), pad_scenes([scene])
    earned = {
        name: np.asarray(evaluate(CONFIG, layouts, policy, key, 1500).reward, dtype=float)
        for name, policy in (
            ("learned", learner.policy_),
            ("watched", ExploringPolicy(Hasty(), 0.5)),
            ("uniform", ExploringPolicy(Hasty(), 1.0)),
        )
    }
    for other in ("watched", "uniform"):
        gain = earned["learned"] - earned[other]
        assert gain.mean() > 3.0 * gain.std() / np.sqrt(len(gain)), other


@pytest.mark.slow
def test_it_learns_the_same_from_the_same_log_whatever_the_names_of_objects(learner, logs):
    names = {k: f"cup {k}" for k in range(NUM_OBJECTS)}
    stages, objects = (table.assign(object=table["object"].map(names)) for table in (logs.stages, logs.objects))
    for same in (logs, Logs(stages, logs.trajectories, objects)):
        again = CensoredQLearner.for_table(horizon=10, laws=None).fit(same)
        assert np.array_equal(again.q_functions_.coefficients, learner.q_functions_.coefficients)
        assert again.policy_.coefficients.dtype == np.float32


def gone(logs):
    row = logs.stages[logs.stages["object"].notna()].iloc[0]
    acted = logs.objects[["trajectory", "stage", "object"]].eq(row[["trajectory", "stage", "object"]]).all(axis=1)
    return row, {"objects": logs.objects.assign(location=logs.objects["location"].mask(acted, "DISHWASHER"))}


def dropped(logs):
    stages = logs.stages.assign(action=logs.stages["action"].replace("LIFT", "DROP"))
    return stages[stages["action"] == "DROP"].iloc[0], {"stages": stages}


@pytest.mark.parametrize(("spoil", "message"), [(gone, ".* is not on the table"), (dropped, "action 'DROP'")])
def test_an_action_that_cannot_be_is_named(logs, spoil, message):
    row, changed = spoil(logs)
    tables = {"stages": logs.stages, "trajectories": logs.trajectories, "objects": logs.objects} | changed
    with pytest.raises(LogError, match=f"trajectory {row['trajectory']}, stage {row['stage']}: {message}"):
        CensoredQLearner.for_table(horizon=10, laws=None).fit(Logs(**tables))


@pytest.mark.slow
def test_cuts_may_depend_on_the_first_table(scene):
    open_table = Scene(np.zeros((NUM_OBJECTS + 1, NUM_OBJECTS + 1)), name="open")
    logs = TableWorld().simulate([scene, open_table], UniformPolicy(), episodes=200, seed=0, cut_share=0.4)
    columns = ("num_objects", "mean_occlusion")
    table = table_covariates(logs, columns)[(logs.stages["stage"] == 1).to_numpy()].reset_index(drop=True)
    assert logs.objects is not None
    objects = logs.objects[logs.objects["stage"] == 1]
    for row, trajectory in enumerate(logs.trajectory_ids[:20]):
        mine = objects[objects["trajectory"] == trajectory]
        assert table.loc[row, "num_objects"] == len(mine)
        assert table.loc[row, "mean_occlusion"] == pytest.approx(mine["occlusion"].mean())
    learner = CensoredQLearner.for_table(horizon=10, censoring=Cox(ridge=1.0), reg=1.0).fit(logs)
    expected = stage_weights(logs.elapsed_s(), logs.end_s, logs.is_finished, Cox(ridge=1.0), covariates=table)
    np.testing.assert_allclose(learner.weights_[:, : expected.shape[1]], expected)


@pytest.mark.slow
def test_cuts_at_a_table_may_depend_on_the_attempt():
    scene = Scene(np.array([[0.0, 0.6], [0.0, 0.0]]))
    logs = TableWorld().simulate(scene, UniformPolicy(), episodes=150, seed=0, cut_share=0.5, cut_kind="attempt")
    fitted = CensoredQLearner.for_table(10, censoring=Weighted(Cox(ridge=1.0), by="pooled"), reg=1.0).fit(logs)
    names = fitted.cut_model_.fitted[0].model.covariates_
    assert names == ["num_objects", "mean_occlusion", "action=FINISH", "action=WASH", "target_occlusion"]
    with pytest.raises(ArgumentError, match="'weather' is not one of a table's: num_objects, mean_occlusion, action"):
        CensoredQLearner.for_table(10, laws=None, censoring=Weighted("cox", covariates=["weather"])).fit(logs)


@pytest.mark.slow
def test_a_verb_that_was_never_completed_is_never_taken(scene, tmp_path):
    played = play(CONFIG, pad_scenes([scene]), Hasty(), random.key_of(3), 60)
    logs = to_logs(cut(played, 0.0, "independent", np.random.default_rng(0)), "independent", [scene])
    learner = CensoredQLearner.for_table(CONFIG.horizon).fit(logs)
    assert [result.split()[0] for result in learner.unseen_] == ["LIFT"]
    write_policy(learner, logs, tmp_path / "policy")
    for policy in (learner.policy_, read_policy(tmp_path / "policy").policy):
        assert np.asarray(policy.is_seen).tolist() == [True, True, False]
        again = play(CONFIG, pad_scenes([scene]), policy, random.key_of(4), 40)
        verbs = ActionSpace(NUM_OBJECTS).verb(again.action)[again.is_taken]
        assert Verb.LIFT not in set(verbs)
        assert Verb.WASH in set(verbs)


def log_of(log_odds=(0.4, -0.2, 1.0), **columns):
    """Two trajectories of two stages; the last object is of a second stage."""
    stages = pd.DataFrame({"trajectory": [0, 0, 1], "stage": [1, 2, 1], "elapsed_s": [1.0, 2.0, 1.0]})
    stages = stages.assign(action=["LIFT", "FINISH", "FINISH"], object=["a", None, None], reward=0.0)
    trajectories = pd.DataFrame({"trajectory": [0, 1], "end_s": [2.0, 1.0], "ending": "finished"} | columns)
    objects = pd.DataFrame({"trajectory": [0, 1, 0], "stage": [1, 1, 2], "object": "a", "location": "TABLE"})
    return Logs(stages, trajectories, objects.assign(log_odds=log_odds, occlusion=0.0))


@pytest.mark.parametrize(
    ("columns", "expected"),
    [
        ({"dirty_share": [0.3, 0.3]}, 0.3),
        ({}, expit([0.4, -0.2]).mean()),
        ({"dirty_share": [0.3, None]}, expit([0.4, -0.2]).mean()),
    ],
    ids=["a column", "no column", "a column with gaps"],
)
def test_the_prior_is_the_column_and_where_there_is_none_the_mean_of_the_first_stages(columns, expected):
    assert logged_dirty_share(log_of(**columns)) == pytest.approx(expected, rel=1e-12)


def test_what_tells_no_prior_is_refused():
    for shares in ([0.3, 0.5], [1.0, 1.0]):
        with pytest.raises(LogError, match=r"trajectories: dirty_share goes from \S+ to \S+; a policy has one prior"):
            logged_dirty_share(log_of(dirty_share=shares))
    logs = log_of()
    with pytest.raises(LogError, match="objects: the log has no objects table"):
        logged_dirty_share(Logs(logs.stages.drop(columns="object"), logs.trajectories))


def test_it_is_a_task_whose_blocks_are_verbs_and_whose_features_have_no_names():
    assert isinstance(TableTask(), Task)
    names = [Verb(block).name for block in TableTask().block_of_action(1 + 2 * NUM_OBJECTS)]
    assert [name.split()[0] for name in ActionSpace(NUM_OBJECTS).names] == names
    np.testing.assert_array_equal(TableTask().block_of_action(5), [0, 1, 1, 2, 2])
    with pytest.raises(ArgumentError, match="the outcome regression of a table uses all features; leave it out"):
        TableTask().outcome_features(["occlusion"])
