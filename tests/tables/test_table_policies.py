"""Learning on tables: features that know neither N nor order, and a policy that earns more than what it watched."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy.special import expit

from halfseen.arrays import record
from halfseen.censoring import Cox, stage_weights
from halfseen.errors import ArgumentError, LogError
from halfseen.learning import CensoredQLearner, Task, Weighted
from halfseen.learning.rows import q_values
from halfseen.logs import Logs
from halfseen.policies.folder import read_policy, write_policy
from halfseen.tables import LinearTablePolicy, TableTask
from halfseen.tables.encoding import table_covariates
from halfseen.tables.features import (
    NUM_FEATURES,
    NUM_TABLE_FEATURES,
    WASH_DIRTY,
    WASH_EASE,
    table_features,
)
from halfseen.tables.prior import logged_dirty_share
from halfseen.world import ExploringPolicy, Scene, TableWorld, UniformPolicy, WorldConfig, random
from halfseen.world.actions import ActionSpace, Verb, possible_actions
from halfseen.world.cuts import cut, cut_rate
from halfseen.world.logs import to_logs
from halfseen.world.policy import surely
from halfseen.world.rollout import evaluate, play
from halfseen.world.state import occlusion, occlusion_by, pad_scenes
from picked import picked

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
    return CensoredQLearner.for_table(horizon=10).fit(logs)


def states_in(watched):
    path, stage = np.nonzero(np.asarray(watched.is_taken)[:60])
    return picked(watched.states, (path, stage))


PER_OBJECT = "is_object", "is_on_table", "grip", "log_odds", "seen", "lifts"


def permuted(states, order):
    """Object k of the result is object order[k] of the given states."""
    rank = np.argsort(order)
    tried = states.attempt_object
    return replace(
        states,
        hides=states.hides[:, order][:, :, order],
        **{name: getattr(states, name)[:, order] for name in PER_OBJECT},
        attempt_object=np.where(tried < 0, tried, rank[tried]),
    )


def padded(states, num_objects):
    more = num_objects - states.num_objects
    extra = {"is_object": False, "is_on_table": False, "grip": -3.0, "log_odds": 7.0, "seen": 0.4, "lifts": 3}
    grown = {
        name: np.pad(getattr(states, name), ((0, 0), (0, more)), constant_values=value) for name, value in extra.items()
    }
    return replace(states, hides=np.pad(states.hides, ((0, 0), (0, more), (0, more)), constant_values=0.9), **grown)


def by_verb(values, num_objects):
    """Values of WASH and LIFT by object, and of FINISH."""
    values = np.asarray(values)
    return values[:, 1 : 1 + num_objects], values[:, 1 + num_objects :], values[:, :1]


def random_policy():
    coefficients = np.random.default_rng(3).normal(size=(10, 3, NUM_FEATURES + 1))
    return LinearTablePolicy(coefficients.astype(np.float32))


def test_q_follows_the_objects_when_they_change_places(watched):
    states, order = states_in(watched), np.array([2, 0, 3, 1])
    q = random_policy().q_values
    before = by_verb(q(states), NUM_OBJECTS)
    after = by_verb(q(permuted(states, order)), NUM_OBJECTS)
    for k in (0, 1):
        np.testing.assert_allclose(after[k], before[k][:, order], rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(after[2], before[2], rtol=1e-4, atol=1e-4)
    assert (np.ptp(np.where(np.isfinite(before[0]), before[0], 0.0), axis=1) > 0.1).any()


def test_q_does_not_see_padding(watched):
    states = states_in(watched)
    q = random_policy().q_values
    before, after = by_verb(q(states), NUM_OBJECTS), by_verb(q(padded(states, 7)), 7)
    for left, right in zip(before, after, strict=True):
        np.testing.assert_allclose(right[:, : left.shape[1]], left, rtol=1e-4, atol=1e-4)
        assert (right[:, left.shape[1] :] == -np.inf).all()


def test_a_block_is_a_verb():
    blocks = TableTask().block_of_action(1 + 2 * NUM_OBJECTS)
    names = [Verb(block).name for block in blocks]
    assert [name.split()[0] for name in ActionSpace(NUM_OBJECTS).names] == names
    assert set(names) == {"FINISH", "WASH", "LIFT"}


def test_features_are_finite_whatever_happened(watched):
    features = table_features(states_in(watched))
    assert features.shape[1:] == (1 + 2 * NUM_OBJECTS, NUM_FEATURES)
    assert np.isfinite(features).all()


def test_a_policy_values_what_was_regressed_on(watched):
    states, policy = states_in(watched), random_policy()
    by_policy, features = policy.q_values(states), table_features(states)
    blocks, possible = ActionSpace(NUM_OBJECTS).verbs, possible_actions(states)
    by_features = q_values(policy.coefficients[states.steps_to_go - 1], features, blocks)
    np.testing.assert_allclose(by_policy[possible], by_features[possible], rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("hidden", [0.7, 1.0])
def test_what_is_laid_bare_is_the_occlusion_that_goes(watched, hidden):
    seen = states_in(watched)
    hides = seen.hides.copy()
    hides[:, 2, 0] = hidden
    states, others = replace(seen, hides=hides), ~np.eye(NUM_OBJECTS, dtype=bool)
    for k in range(20):
        state = picked(states, k)
        there, features = state.is_on_table, table_features(state)
        is_dirty = 1.0 / (1.0 + np.exp(-state.log_odds.astype(float)))
        without = occlusion_by(state.hides, there & others)
        gone = (occlusion(state) - without) * (there[:, None] & there) * others
        washed = features[1 : 1 + NUM_OBJECTS]
        laid_bare = washed[:, WASH_EASE] * (gone @ np.maximum(is_dirty - 0.5, 0.0))
        np.testing.assert_allclose(washed[there, NUM_TABLE_FEATURES], laid_bare[there], atol=1e-5)
        np.testing.assert_allclose(washed[there, WASH_DIRTY], is_dirty[there], atol=1e-5)


def test_the_policy_takes_the_best_possible_action(watched):
    states = states_in(watched)
    policy = random_policy()
    action = policy.decide(states, random.keys_of(random.key_of(0), len(states.lifts))).action
    q, possible = policy.q_values(states), possible_actions(states)
    assert possible[np.arange(len(action)), action].all()
    assert (q[np.arange(len(action)), action] == np.where(possible, q, -np.inf).max(axis=1)).all()
    assert not possible.all()


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


def test_it_learns_the_same_from_the_same_log(learner, logs):
    again = CensoredQLearner.for_table(horizon=10).fit(logs)
    assert np.array_equal(again.q_functions_.coefficients, learner.q_functions_.coefficients)
    assert again.policy_.coefficients.dtype == np.float32


def test_the_names_of_objects_do_not_matter(learner, logs):
    names = {k: f"cup {k}" for k in range(NUM_OBJECTS)}
    named = Logs(
        logs.stages.assign(object=logs.stages["object"].map(names)),
        logs.paths,
        logs.objects.assign(object=logs.objects["object"].map(names)),
    )
    again = CensoredQLearner.for_table(horizon=10).fit(named)
    assert np.array_equal(again.q_functions_.coefficients, learner.q_functions_.coefficients)


def test_an_action_on_what_is_gone_is_named(logs):
    objects = logs.objects.copy()
    row = logs.stages[logs.stages["object"].notna()].iloc[0]
    acted = objects[["path", "stage", "object"]].eq(row[["path", "stage", "object"]]).all(axis=1)
    objects.loc[acted, "location"] = "DISHWASHER"
    spoilt = Logs(logs.stages, logs.paths, objects)
    with pytest.raises(LogError, match=f"path {row['path']}, stage {row['stage']}: .* is not on the table"):
        CensoredQLearner.for_table(horizon=10).fit(spoilt)


def test_a_verb_that_no_table_knows_is_named(logs):
    stages = logs.stages.assign(action=logs.stages["action"].replace("LIFT", "DROP"))
    row = stages[stages["action"] == "DROP"].iloc[0]
    with pytest.raises(LogError, match=f"path {row['path']}, stage {row['stage']}: action 'DROP'"):
        CensoredQLearner.for_table(horizon=10).fit(Logs(stages, logs.paths, logs.objects))


def test_finish_is_possible_even_on_an_empty_table(watched):
    empty = replace(watched.states, is_on_table=np.zeros_like(watched.states.is_on_table))
    assert possible_actions(empty)[..., 0].all()
    assert not possible_actions(empty)[..., 1:].any()


@pytest.mark.slow
def test_cuts_may_depend_on_the_first_table(scene):
    open_table = Scene(np.zeros((NUM_OBJECTS + 1, NUM_OBJECTS + 1)), name="open")
    logs = TableWorld().simulate([scene, open_table], UniformPolicy(), episodes=200, seed=0, cut_share=0.4)
    columns = ("num_objects", "mean_occlusion")
    table = table_covariates(logs, columns)[(logs.stages["stage"] == 1).to_numpy()].reset_index(drop=True)
    assert logs.objects is not None
    objects = logs.objects[logs.objects["stage"] == 1]
    for row, path in enumerate(logs.path_ids[:20]):
        mine = objects[objects["path"] == path]
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
    with pytest.raises(ArgumentError, match="'weather' is none of a table's: num_objects, mean_occlusion, action"):
        CensoredQLearner.for_table(10, censoring=Weighted("cox", covariates=["weather"])).fit(logs)


@pytest.mark.slow
def test_a_verb_that_was_never_completed_is_never_taken(scene, tmp_path):
    played = play(CONFIG, pad_scenes([scene]), Hasty(), random.key_of(3), 60)
    logs = to_logs(cut(played, 0.0, "independent", np.random.default_rng(0)), "independent", [scene])
    learner = CensoredQLearner.for_table(CONFIG.horizon).fit(logs)
    assert [told.split()[0] for told in learner.unseen_] == ["LIFT"]
    write_policy(learner, logs, tmp_path / "policy")
    for policy in (learner.policy_, read_policy(tmp_path / "policy").policy):
        assert np.asarray(policy.is_seen).tolist() == [[True, True, False]] * CONFIG.horizon
        again = play(CONFIG, pad_scenes([scene]), policy, random.key_of(4), 40)
        verbs = ActionSpace(NUM_OBJECTS).verb(again.action)[again.is_taken]
        assert Verb.LIFT not in set(verbs)
        assert Verb.WASH in set(verbs)


def log_of(log_odds=(0.4, -0.2, 1.0), **columns):
    """Two paths of two stages; the last object is of a second stage."""
    stages = pd.DataFrame({"path": [0, 0, 1], "stage": [1, 2, 1], "elapsed_s": [1.0, 2.0, 1.0]})
    stages = stages.assign(action=["LIFT", "FINISH", "FINISH"], object=["a", None, None], reward=0.0)
    paths = pd.DataFrame({"path": [0, 1], "end_s": [2.0, 1.0], "ending": "finished"} | columns)
    objects = pd.DataFrame({"path": [0, 1, 0], "stage": [1, 1, 2], "object": "a", "location": "TABLE"})
    return Logs(stages, paths, objects.assign(log_odds=log_odds, occlusion=0.0))


def test_the_prior_is_the_column_where_there_is_one():
    assert logged_dirty_share(log_of(dirty_share=[0.3, 0.3])) == 0.3


@pytest.mark.parametrize("columns", [{}, {"dirty_share": [0.3, None]}], ids=["no column", "a column with gaps"])
def test_the_prior_is_the_mean_of_the_first_stages_where_there_is_none(columns):
    assert logged_dirty_share(log_of(**columns)) == pytest.approx(expit([0.4, -0.2]).mean())


@pytest.mark.parametrize("shares", [[0.3, 0.5], [1.0, 1.0]])
def test_priors_that_differ_or_are_none_are_refused(shares):
    with pytest.raises(LogError, match=r"paths: dirty_share goes from \S+ to \S+; one policy has one prior"):
        logged_dirty_share(log_of(dirty_share=shares))


def test_a_log_without_objects_is_no_tables():
    logs = log_of()
    with pytest.raises(LogError, match="objects: the log has none"):
        logged_dirty_share(Logs(logs.stages.drop(columns="object"), logs.paths))


def test_it_is_a_task():
    assert isinstance(TableTask(), Task)


def test_features_of_a_table_have_no_names_to_choose_by():
    with pytest.raises(ArgumentError, match="on a table the outcome regression uses all features"):
        TableTask().outcome_features(["occlusion"])


def test_blocks_are_verbs():
    np.testing.assert_array_equal(TableTask().block_of_action(5), [0, 1, 1, 2, 2])
