import subprocess
import sys

import numpy as np
import pandas as pd
import pyarrow as pa
import pytest
from sklearn.base import clone
from sklearn.exceptions import NotFittedError
from threadpoolctl import threadpool_info, threadpool_limits
from trials import ACTIONS, FULL, REDUCED, cell_means, indicators, log_of

from halfseen.censoring import KaplanMeier, stage_weights
from halfseen.errors import ArgumentError, HalfseenWarning, LogError, PositivityError
from halfseen.learning import (
    CensoredQLearner,
    CrossValidation,
    DoublyRobust,
    KernelQ,
    NamedActions,
    Weighted,
    q_model,
)
from halfseen.learning.behaviour import fit_choice
from halfseen.logs import Logs
from halfseen.policies.folder.specification import described
from refusals import refused_type


@pytest.fixture(scope="module")
def logs(trial):
    return trial


def learner(**changed):
    return CensoredQLearner.of_paper(**{"horizon": 2, "actions": ACTIONS, "covariates": FULL, "reg": 0, **changed})


def states_of(stage):
    return pd.DataFrame([indicators(stage, state) for state in range(4 - stage)])


@pytest.mark.parametrize("covariates", [FULL, REDUCED])
def test_a_saturated_q_is_the_weighted_mean_of_each_cell(logs, covariates):
    fitted = learner(covariates=covariates).fit(logs)
    for stage, means in enumerate(cell_means(logs), start=1):
        assert fitted.q_values(states_of(stage), stage) == pytest.approx(means.to_numpy(), abs=1e-8)
        assert fitted.decide(states_of(stage), stage).tolist() == means.idxmax(axis=1).tolist()


def test_the_trial_has_ties_and_cuts_in_both_stages(logs):
    last = logs.stages.groupby("trajectory").tail(1)
    cut = last[last["elapsed_s"].isna()]
    assert set(cut["stage"]) == {1, 2}
    assert set(logs.stages[logs.stages["stage"] == 1]["trajectory"]) != set(
        logs.stages[logs.stages["stage"] == 2]["trajectory"]
    )
    assert set(logs.end_s[logs.is_finished]) & set(logs.end_s[~logs.is_finished])
    assert logs.stages["action"].isna().any()


def test_a_model_given_is_used_and_not_changed(logs):
    unfitted, fitted = KaplanMeier(), KaplanMeier().fit([1.0, 9.5], [False, True])
    assert learner(censoring=unfitted).fit(logs).weights_ == pytest.approx(learner().fit(logs).weights_)
    assert not hasattr(unfitted, "times_")
    weights = learner(censoring=fitted).fit(logs).weights_
    assert set(np.unique(weights)) == {0.0, 1.0, 2.0}


@pytest.mark.parametrize("name", ["cox", "kernel"])
def test_cuts_may_depend_on_what_a_trajectory_begins_with(logs, name):
    first = logs.stages[logs.stages["stage"] == 1].set_index("trajectory").loc[logs.trajectory_ids, ["s1_1", "s1_2"]]
    elapsed_s = logs.elapsed_s()
    weights = stage_weights(elapsed_s, logs.end_s, logs.is_finished, name, covariates=first.reset_index(drop=True))
    fitted = learner(covariates=REDUCED, censoring=name).fit(logs)
    assert fitted.weights_ == pytest.approx(weights)
    assert not np.allclose(fitted.weights_, learner(covariates=REDUCED).fit(logs).weights_)


def test_a_weight_that_is_not_identified_names_trajectory_and_stage():
    # The last cut comes before trajectory 1 finishes, and trajectory 1 stands for nobody else who was watched that
    # long.
    logs = log_of(["A"] * 3, np.ones(3), ends_s=[1.0, 3.0, 3.5], is_seen=[True, True, False])
    gone = KaplanMeier().fit([0.5, 2.0], [True, False])
    with pytest.raises(PositivityError, match=r"trajectory 1, stage 1: completed at 3 s"):
        learner(horizon=1, covariates=[], censoring=gone).fit(logs)


def test_an_unknown_action_is_named(logs):
    strange = logs.stages.assign(action=logs.stages["action"].where(logs.stages.index != 5, "C"))
    row = strange.iloc[5]
    with pytest.raises(
        LogError, match=f"trajectory {row['trajectory']}, stage {row['stage']}: action 'C' was not possible"
    ):
        learner().fit(Logs(strange, logs.trajectories))


@pytest.mark.parametrize(
    ("changed", "error", "message"),
    [
        (
            {"covariates": ["weight_kg"]},
            LogError,
            "covariate 'weight_kg' is missing; the columns are trajectory, stage",
        ),
        ({"covariates": ["action"]}, LogError, "covariate 'action' is not numeric"),
        (
            {"covariates": ["s2_1"], "censoring": "cox"},
            ArgumentError,
            "none of those of a trajectory's first stage differs between trajectories",
        ),
        ({"horizon": 0}, ArgumentError, "horizon is 0; give a whole number of stages, at least 1"),
        ({"reg": -1.0}, ArgumentError, "reg is -1.0; give a λ ≥ 0, or 'cv'"),
        ({"reg": float("nan")}, ArgumentError, "reg is nan"),
        ({"reg": "ridge"}, ArgumentError, "reg is 'ridge'"),
        ({"q_function": "forest"}, ArgumentError, "q_function is 'forest'"),
        ({"stages": "merged"}, ArgumentError, "stages is 'merged'; give 'separate', 'pooled' or 'trend'"),
        (
            {"censoring": "weibull"},
            ArgumentError,
            "'kaplan-meier', 'cox', 'kernel', 'buckley-james', 'none', Weighted(…), DoublyRobust(…) or a",
        ),
        ({"actions": "tables"}, ArgumentError, "actions is 'tables'"),
        ({"actions": []}, ArgumentError, "name at least one"),
        ({"actions": ["A", "A"]}, ArgumentError, "none twice"),
        ({"actions": {1: ["A", "B"]}}, ArgumentError, "actions: none for stage 2"),
    ],
)
def test_what_cannot_be_is_refused_in_words(logs, changed, error, message):
    with pytest.raises(error) as refusal:
        learner(**changed).fit(logs)
    assert message in str(refusal.value)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"actions": pd.Series(["A", "B"])}, "actions is a Series; give a list of names"),
        ({"actions": [["A"], ["B"]]}, r"actions are \[\['A'\], \['B'\]\]; give a list of names, or one for each"),
        ({"covariates": None}, "covariates is None; give a list of names"),
        ({"covariates": (name for name in ("s1_1",))}, "covariates is <generator.*; give a list of names"),
        ({"actions": {0: ["A"], 1: ACTIONS, 2: ACTIONS}}, "actions: stage 0 does not exist; name the stages 1 to"),
        ({"half_life": [3]}, r"half_life is \[3\]; give a number of trajectories above 0"),
    ],
)
def test_parameters_of_another_type_are_refused_in_one_line(logs, changed, message):
    with refused_type(message):
        learner(**changed).fit(logs)


@pytest.mark.parametrize("value", [None, -1, 1.5, np.random.default_rng(0), np.random.RandomState(0)])
def test_a_random_state_is_a_seed(logs, value):
    with pytest.raises(ArgumentError, match=r"random_state is .*; it is a seed, a whole number ≥ 0"):
        learner().set_params(random_state=value).fit(logs)


@pytest.mark.parametrize("states", [np.zeros((2, 1)), {"s1_1": [0.0]}, pa.table({"s1_1": [0.0]})])
def test_states_that_are_no_frame_are_refused(logs, states):
    policy = learner().fit(logs).policy_
    with pytest.raises(ArgumentError, match=f"the states are a {type(states).__name__}; give a pandas DataFrame"):
        policy.decide(states, 1)


@pytest.mark.parametrize(
    ("written", "message"),
    [
        (lambda: CrossValidation(1), "num_folds is 1; cross-validation needs at least 2"),
        (lambda: CrossValidation(float("inf")), "num_folds is inf"),
        (lambda: KernelQ(trend=3.0), "trend is 3.0; give two finite numbers > 0"),
        (lambda: NamedActions(3), "actions is 3; give a list of names, or one for each stage"),
        (lambda: KernelQ(num_landmarks=1.5), r"num_landmarks is 1\.5"),
        (lambda: Weighted("cox", covariates=iter("x")), "covariates is <str_ascii_iterator.*; give a list of names"),
        (
            lambda: NamedActions(ACTIONS, ["x"]).outcome_features(iter("x")),
            "outcome_covariates is <str_ascii_iterator.*; give a list of names",
        ),
        (lambda: Weighted(by="stage", truncate_at=0.5), r"truncate_at is 0\.5; weights are at least 1"),
        (lambda: DoublyRobust("cox", covariates="clutter"), "covariates is 'clutter'; give a list of names"),
        (lambda: NamedActions(ACTIONS, "x"), "covariates is 'x'; give a list of names"),
        (
            lambda: NamedActions(ACTIONS, ["x", "elapsed_s"]),
            "'elapsed_s', which is known only once the action is chosen",
        ),
        (lambda: NamedActions(ACTIONS, ["x", "y", "x"]), "covariates names 'x' twice; name it once"),
        (lambda: KernelQ(gamma=-1), "gamma is -1; give a finite number > 0"),
        (lambda: KernelQ(num_landmarks=0), "num_landmarks is 0"),
    ],
)
def test_specifications_refuse_what_they_cannot_mean_where_they_are_written(written, message):
    with refused_type(message):
        written()


def test_one_trajectory_cannot_be_held_out():
    logs = log_of(["A"], [2.0])
    one = learner(horizon=1, covariates=[], reg="cv")
    with pytest.raises(ArgumentError, match="1 of 1 completed a stage; give a number for reg"):
        one.fit(logs)
    fitted = learner(horizon=1, covariates=[]).fit(logs)
    assert fitted.q_values(pd.DataFrame(index=[0]), 1)[0, 0] == pytest.approx(2.0)


def test_only_possible_actions_are_chosen_and_maximised_over(logs):
    # B pays in stage 2 where s2_1, so forbidding it there lowers what stage 1 is worth.
    no_b = logs.stages[(logs.stages["stage"] == 1) | (logs.stages["action"] != "B")]
    kept = no_b.groupby("trajectory")["stage"].size()
    trajectories = logs.trajectories[
        logs.trajectories["trajectory"].isin(kept.index[kept == logs.stages.groupby("trajectory")["stage"].size()])
    ]
    part = Logs(no_b[no_b["trajectory"].isin(trajectories["trajectory"])], trajectories)
    by_stage = learner(actions={1: ["A", "B"], 2: ["A"]}).fit(part)
    assert set(by_stage.decide(states_of(2), 2)) == {"A"}
    assert set(by_stage.decide(states_of(1), 1)) <= {"A", "B"}
    first, second = cell_means(part)
    assert by_stage.q_values(states_of(2), 2)[:, 0] == pytest.approx(second["A"].to_numpy(), abs=1e-8)
    assert by_stage.q_values(states_of(1), 1) == pytest.approx(first.to_numpy(), abs=1e-8)
    with pytest.raises(LogError, match="stage 2: action 'B' was not possible there"):
        learner(actions={1: ["A", "B"], 2: ["A"]}).fit(logs)


def test_an_impossible_action_that_looks_best_is_not_in_the_maximum(logs):
    # C is possible in stage 1 only; its Q in stage 2 would be 0, above a stage 2 that costs 100.
    dear = logs.stages.assign(
        reward=logs.stages["reward"].where(logs.stages["stage"] == 1, logs.stages["reward"] - 100)
    )
    dear = Logs(dear.assign(reward=dear["reward"].where(dear["elapsed_s"].notna())), logs.trajectories)
    fitted = learner(actions={1: ["A", "B", "C"], 2: ["A", "B"]}).fit(dear)
    first, _ = cell_means(dear)
    assert fitted.q_values(states_of(1), 1)[:, :2] == pytest.approx(first.to_numpy(), abs=1e-8)
    assert set(fitted.decide(states_of(2), 2)) <= {"A", "B"}


@pytest.fixture(scope="module")
def one_stage():
    """Stages and trajectories of one stage, of which a fifth was cut."""
    rng, ids = np.random.default_rng(1), np.arange(300)
    x, action, is_cut = rng.random(300), rng.choice(["a", "b"], 300), rng.random(300) < 0.2
    reward = np.where(action == "b", x, 1.0 - x) + 0.2 * rng.normal(size=300)
    stages = pd.DataFrame(
        {"trajectory": ids, "stage": 1, "elapsed_s": 1.0 + x, "action": action, "reward": reward, "x": x}
    )
    stages.loc[is_cut, ["elapsed_s", "reward"]] = np.nan
    return stages, pd.DataFrame({"trajectory": ids, "end_s": 1.0 + x, "ending": np.where(is_cut, "cut", "finished")})


def test_a_constant_in_all_rewards_changes_no_choice(one_stage):
    stages, trajectories = one_stage

    def gains(added):
        moved = Logs(stages.assign(reward=stages["reward"] + added), trajectories)
        policy = CensoredQLearner(1, ["a", "b"], ["x"]).fit(moved).policy_
        return np.diff(policy.q_values(pd.DataFrame({"x": np.linspace(0.0, 1.0, 9)}), 1))

    np.testing.assert_allclose(gains(1e5), gains(0.0), atol=1e-4)
    with pytest.raises(LogError, match=r"rewards are about 1e\+08 and differ by 0\.\d+, which rounding would erase"):
        gains(1e8)


@pytest.mark.parametrize("reward", [3.3, np.resize([0.3, 0.1 + 0.2], 42), 0.0, -1e9])
def test_equal_rewards_are_no_rounding_that_would_be_erased(reward):
    policy = CensoredQLearner(1, ["A", "B"], reg=0.0).fit(log_of(["A", "B"] * 21, np.broadcast_to(reward, 42))).policy_
    q = policy.q_values(pd.DataFrame(index=[0]), 1)
    np.testing.assert_allclose(q, np.broadcast_to(np.mean(reward), (1, 2)), rtol=1e-12)


def test_a_half_life_warns_of_names_that_are_sorted_as_text(one_stage):
    renamed = (each.assign(trajectory=each["trajectory"].map("run-{}".format)) for each in one_stage)
    with pytest.warns(HalfseenWarning, match="half_life: trajectories are sorted by name as text, where 'run-1"):
        CensoredQLearner(1, ["a", "b"], ["x"], half_life=10).fit(Logs(*renamed))


def test_it_follows_scikit_learn(logs):
    original = learner(censoring=DoublyRobust("cox", by="pooled"), reg=CrossValidation(3), q_function=KernelQ(50))
    copy = clone(original)
    assert copy.get_params() == original.get_params()
    assert copy.set_params(reg=0.5).reg == 0.5
    assert copy.set_params(censoring=Weighted(truncate_at=4.0)).compose().targets == Weighted(truncate_at=4.0)
    assert original.censoring == DoublyRobust("cox", by="pooled"), "the copy is its own"
    assert len(original.get_params()) <= 10
    plain = learner()
    assert plain.fit(logs) is plain
    with pytest.raises(NotFittedError):
        clone(plain).q_values(states_of(1), 1)
    with pytest.raises(ArgumentError, match="stage is 3; give a whole number, 1 to the horizon, 2"):
        plain.q_values(states_of(1), 3)
    for stage in ("1", 1.5, True):
        with refused_type("give a whole number, 1 to the horizon, 2"):
            plain.decide(states_of(1), stage)


@pytest.mark.parametrize("given", [None, "logs", pd.DataFrame({"x": [1.0]})])
def test_what_is_no_log_is_refused(given):
    with refused_type(f"logs is a {type(given).__name__}; give Logs, as read_logs returns"):
        learner().fit(given)


def test_the_actions_cannot_be_forgotten(logs):
    with pytest.raises(TypeError, match=r"missing .* 'actions'"):
        CensoredQLearner.of_paper(2)
    with pytest.raises(ArgumentError, match="actions is 'A'; give a list of names, or one for each stage"):
        learner(actions="A").fit(logs)
    for no_task in (NamedActions, None):
        forgotten = learner()
        forgotten.actions = no_task
        with pytest.raises(ArgumentError, match="or an object that is a Task"):
            forgotten.fit(logs)


def test_a_task_says_itself_what_q_looks_at(logs):
    by_task = learner(actions=NamedActions(ACTIONS, FULL), covariates=()).fit(logs)
    np.testing.assert_array_equal(by_task.q_functions_.coefficients, learner().fit(logs).q_functions_.coefficients)
    with pytest.raises(ArgumentError, match="the task sets the covariates of Q; leave it out"):
        learner(actions=NamedActions(ACTIONS, FULL)).fit(logs)
    with pytest.raises(ArgumentError, match="NamedActions decides by its own policy; use policy_"):
        by_task.decide(states_of(1), 1)


def test_the_random_state_deals_the_folds_and_nothing_else_does(logs):
    few = logs.select(range(30))
    first = learner(reg="cv", random_state=1).fit(few).q_functions_
    np.random.seed(99)  # noqa: NPY002
    again = learner(reg="cv", random_state=1).fit(few).q_functions_
    assert np.array_equal(first.coefficients, again.coefficients)
    others = [learner(reg="cv", random_state=seed).fit(few).q_functions_.reg for seed in range(2, 6)]
    assert any(not np.array_equal(first.reg, reg) for reg in others)


def test_the_order_of_rows_is_irrelevant(logs):
    shuffled = Logs(logs.stages.sample(frac=1.0, random_state=0), logs.trajectories.sample(frac=1.0, random_state=1))
    assert learner(reg=0.1).fit(shuffled).q_functions_.coefficients == pytest.approx(
        learner(reg=0.1).fit(logs).q_functions_.coefficients, abs=1e-12
    )


def test_pooled_stages_index_by_steps_to_go(logs):
    fitted = learner(stages="pooled", covariates=["s1_1"]).fit(logs)
    frame = states_of(1)
    assert fitted.q_values(frame, 2) == pytest.approx(
        fitted.q_functions_.coefficients[0][:, 0]
        + frame[["s1_1"]].to_numpy() * fitted.q_functions_.coefficients[0][:, 1]
    )
    assert not np.allclose(fitted.q_values(frame, 1), fitted.q_values(frame, 2))


def test_learning_runs_in_one_thread(logs, monkeypatch):
    # Where other programs keep the cores busy, products of small matrices in two threads take fifty times as long.
    threads = []

    def spied(*given):
        threads.extend(each["num_threads"] for each in threadpool_info() if each["user_api"] == "blas")
        return fit_choice(*given)

    monkeypatch.setattr(q_model, "fit_choice", spied)
    with threadpool_limits(2):
        CensoredQLearner(2, ACTIONS, FULL).fit(logs)
    assert set(threads) == {1}


@pytest.mark.slow
def test_a_fit_of_named_actions_loads_what_it_needs():
    code = """
import sys
from halfseen.learning import CensoredQLearner
from halfseen.logs import Logs
names = list(range(8))
stages = {"trajectory": names, "stage": [1] * 8, "elapsed_s": [1.0] * 8, "action": [*"AB"] * 4, "reward": names}
ends = {"trajectory": names, "end_s": [1.0] * 8, "ending": ["finished"] * 8}
logs = Logs(stages | {"x": names}, ends)
CensoredQLearner.of_paper(1, ["A", "B"], ["x"], reg=0.1).fit(logs)
print(*[name for name in ("jax", "scipy", "sklearn") if name in sys.modules])
CensoredQLearner(1, ["A", "B"], ["x"]).fit(logs)
heavy = ("jax", "scipy.special", "scipy.spatial", "scipy.stats", "sklearn")
print(*[name for name in heavy if name in sys.modules])
"""
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout == "\n\n"


def staged(num_trajectories, suits, seed=0):
    """Stages in which A suits a positive x and B a negative one (1), the other way round (−1), or neither (0)."""
    rng = np.random.default_rng(seed)
    sign = np.tile(suits, num_trajectories)
    x = rng.normal(size=len(sign))
    action = rng.choice(["A", "B"], len(sign))
    reward = np.where(action == "A", 1.0, -1.0) * sign * x + 0.3 * rng.normal(size=len(sign))
    return log_of(action, reward, num_stages=len(suits), x=x)


@pytest.mark.parametrize(
    ("suits", "why", "stages"),
    [
        ((1, 1), "stages are pooled: held out, ", "pooled"),
        ((1, 0, -1), "stages are pooled with a trend over them: held out, ", "trend"),
        ((1, -1, 1), "stages are separate: held out, ", "separate"),
    ],
)
def test_stages_are_separate_or_have_a_trend_where_they_differ(suits, why, stages):
    learner = CensoredQLearner(len(suits), ["A", "B"], ["x"]).fit(staged(200, suits))
    assert learner.chosen_[0].startswith(why)
    assert described(learner.model_)["stages"] == stages
    states = pd.DataFrame({"x": [-1.0, 1.0]})
    for stage, suit in enumerate(suits, start=1):
        if suit:
            assert learner.decide(states, stage).tolist() == (["B", "A"] if suit > 0 else ["A", "B"])


@pytest.mark.parametrize(
    ("num_trajectories", "said"), [(60, {"stages": "pooled"}), (10, {})], ids=["said", "too few trajectories"]
)
def test_there_is_not_always_a_choice(num_trajectories, said):
    learner = CensoredQLearner(2, ["A", "B"], ["x"], **said).fit(staged(num_trajectories, (1, -1)))
    assert (learner.model_.stages, learner.chosen_) == ("pooled", ())
