"""What stands for what cuts took: what each kind weighs and imputes, and which combinations cannot be written."""

import numpy as np
import pandas as pd
import pytest
from trials import ACTIONS, FULL, log_of, two_stage_trial, with_known_actions

from halfseen.censoring import CENSORING_NAMES, Cox
from halfseen.errors import ArgumentError, LogError
from halfseen.learning import BuckleyJames, CensoredQLearner, DoublyRobust, KernelQ, NamedActions, Unweighted, Weighted
from halfseen.learning.imputation import fit_duration_model, fit_durations, imputation
from halfseen.learning.q_model import QModel
from halfseen.learning.targets import named_targets, targets_of
from halfseen.logs import Logs

NUM_PATIENTS, NUM_LOGS = 600, 24
ASKED = pd.DataFrame({"x": [-1.0, 0.0, 1.0]})


def one_stage(seed, gain=1.2):
    """The longer it takes the more it brings, and x hastens both the end and the cut."""
    rng = np.random.default_rng(seed)
    x = rng.normal(size=NUM_PATIENTS)
    action = rng.choice(["A", "B"], NUM_PATIENTS)
    duration = rng.exponential(np.exp(-0.5 * x + 0.3 * (action == "B")))
    cut = rng.exponential(1.2 * np.exp(-gain * x))
    reward = 2.0 * duration + x + (action == "B") + 0.3 * rng.normal(size=NUM_PATIENTS)
    return log_of(action, reward, ends_s=np.minimum(duration, cut), is_seen=duration <= cut, x=x)


def truth(x, is_b):
    return 2.0 * np.exp(-0.5 * x + 0.3 * is_b) + x + is_b


def best_line():
    """What a Q that is linear in x converges to at `ASKED` when nothing is cut, x standard normal."""
    x, weight = np.polynomial.hermite_e.hermegauss(30)
    lines = [np.polyfit(x, truth(x, is_b), 1, w=np.sqrt(weight)) for is_b in (0.0, 1.0)]
    return np.column_stack([np.polyval(line, ASKED["x"]) for line in lines])


def errors(**options):
    """Mean error of Q over logs in standard errors, for each x and action."""
    found = []
    for seed in range(NUM_LOGS):
        learner = CensoredQLearner.of_paper(1, ["A", "B"], ["x"], reg=0.0, **options)
        found.append(learner.fit(one_stage(seed)).q_values(ASKED, 1) - best_line())
    return np.mean(found, axis=0) / (np.std(found, axis=0, ddof=1) / np.sqrt(NUM_LOGS))


@pytest.mark.slow
def test_the_wrong_weights_alone_are_biased():
    assert np.abs(errors()).max() > 5.0
    assert np.abs(errors(censoring="none")).max() > 5.0


@pytest.mark.slow
@pytest.mark.parametrize(
    "censoring",
    [DoublyRobust(), DoublyRobust("cox", outcome_covariates=[]), DoublyRobust("cox"), "buckley-james"],
    ids=["wrong Ĝ, right m", "right Ĝ, wrong m", "both right", "Buckley–James, right m"],
)
def test_one_right_model_is_enough(censoring):
    assert np.abs(errors(censoring=censoring)).max() < 3.5


@pytest.mark.slow
def test_with_both_wrong_nothing_helps():
    # The regression of X weighs by Ĝ, which makes it less wrong than the one of Buckley and James.
    assert np.abs(errors(censoring=DoublyRobust(outcome_covariates=[]))).max() > 3.0
    assert np.abs(errors(censoring=BuckleyJames(outcome_covariates=[]))).max() > 4.0


@pytest.mark.slow
def test_pseudo_outcomes_narrow_what_weights_leave_wide():
    spread = {}
    for targets in (Weighted, DoublyRobust):
        learner = CensoredQLearner.of_paper(1, ["A", "B"], ["x"], reg=0.0, censoring=targets("cox"))
        found = [learner.fit(one_stage(seed)).q_values(ASKED, 1) for seed in range(NUM_LOGS)]
        spread[targets] = np.std(found, axis=0).mean()
    assert spread[DoublyRobust] < spread[Weighted]


@pytest.mark.parametrize("censoring", [DoublyRobust(), BuckleyJames()], ids=["doubly robust", "Buckley–James"])
def test_without_cuts_nothing_is_imputed(censoring):
    trial = two_stage_trial(last_cut=40, cut_from=20)
    assert trial.is_finished.all()
    imputed, plain = (
        CensoredQLearner.of_paper(2, ACTIONS, FULL, reg=0.0, censoring=each).fit(trial).q_functions_.coefficients
        for each in (censoring, "kaplan-meier")
    )
    np.testing.assert_allclose(imputed, plain, atol=1e-8)


def imputed_for(trajectories, cut_model):
    every, blocks = np.ones(2), np.arange(2)
    return imputation(trajectories, cut_model, every, blocks, fit_duration_model(trajectories, every, blocks))


@pytest.mark.parametrize("truncate_at", [None, 1.5])
@pytest.mark.parametrize("by", ["trajectory", "stage", "pooled"])
def test_what_a_constant_is_worth_adds_up_to_it(known, by, truncate_at, monkeypatch):
    """With g = 1 the sums telescope: Y of a target that is always 1 is 1, ties, truncated weights and all."""
    module = "halfseen.learning.imputation.duration_terms"
    monkeypatch.setattr(module, lambda duration_s, knots: np.ones((*np.shape(duration_s), len(knots))))
    learner = CensoredQLearner.of_paper(
        2, ACTIONS, ["s1_1", "s2_1"], censoring=Weighted(by=by, truncate_at=truncate_at), reg=0.0
    )
    learner.fit(known)
    trajectories = learner.model_.lay_out(known)
    imputed = imputed_for(trajectories, learner.cut_model_)
    begun = trajectories.is_begun
    np.testing.assert_allclose(imputed.share[begun] + imputed.expected[begun][:, 0], 1.0, atol=1e-9)
    assert (imputed.share[~trajectories.is_completed] == 0.0).all()


def test_the_share_of_a_seen_target_is_what_the_stage_adds_to_the_weight(known):
    learner = CensoredQLearner.of_paper(2, ACTIONS, ["s1_1", "s2_1"], reg=0.0).fit(known)
    trajectories = learner.model_.lay_out(known)
    cuts, seen = learner.cut_model_, trajectories.is_completed
    imputed = imputed_for(trajectories, cuts)
    weights, begun = cuts.weights(trajectories.clocks), cuts.begun_weights(trajectories.clocks)
    np.testing.assert_allclose(imputed.share[seen] * begun[seen], weights[seen])


@pytest.mark.parametrize("durations", [(2.0,), (2.0, 3.0)], ids=str)
@pytest.mark.parametrize("censoring", [DoublyRobust(), BuckleyJames()], ids=["doubly robust", "Buckley–James"])
def test_tied_durations_are_no_bends(censoring, durations):
    """All stages last alike, or short or long; those that were cut early pay what the others pay on average."""
    trajectory = np.arange(120)
    lasts = np.array(durations)[trajectory // 2 % len(durations)]
    is_cut = trajectory % 5 == 0
    pays = 1.0 + 3.0 * (lasts - 2.0)
    logs = log_of(np.array(ACTIONS)[trajectory % 2], pays, ends_s=np.where(is_cut, 1.0, lasts), is_seen=~is_cut, x=0.0)
    learner = CensoredQLearner.of_paper(1, ACTIONS, ["x"], reg=0.0, censoring=censoring).fit(logs)
    mean = pays[~is_cut].mean()
    np.testing.assert_allclose(learner.q_values(pd.DataFrame({"x": [0.0]}), 1), mean, atol=0.15)


def test_what_durations_are_to_be_expected_by_a_loop():
    """Without covariates: the Kaplan–Meier curve of durations beyond an age, completions before cuts."""
    watched = np.array([1.0, 2.0, 2.0, 3.0, 3.0, 5.0])
    is_completed = np.array([True, True, False, True, False, True])
    durations = fit_durations(watched, is_completed, np.zeros((6, 1)))
    mass, survival = {}, 1.0
    for at in (1.0, 2.0, 3.0, 5.0):
        at_risk = np.sum(watched >= at)
        hazard = np.sum((watched == at) & is_completed) / at_risk
        mass[at], survival = survival * hazard, survival * (1.0 - hazard)
    terms = durations.at_s[:, None]
    for age in (0.0, 1.0, 1.5, 2.0, 4.9):
        beyond = {at: share for at, share in mass.items() if at > age}
        expected = sum(at * share for at, share in beyond.items()) / sum(beyond.values())
        assert durations.expected(np.zeros((1, 1)), np.array([[age]]), terms)[0, 0, 0] == pytest.approx(expected)
    assert durations.expected(np.zeros((1, 1)), np.array([[9.0]]), terms)[0, 0, 0] == pytest.approx(5.0)


def test_what_cannot_be_imputed_is_refused(known):
    unknown = Logs(
        known.stages.assign(action=known.stages["action"].where(known.stages["elapsed_s"].notna())), known.trajectories
    )
    for censoring in (DoublyRobust(), "buckley-james"):
        with pytest.raises(ArgumentError, match=r"trajectory \d+, stage \d: its action is null, and .* learning needs"):
            CensoredQLearner.of_paper(2, ACTIONS, FULL, censoring=censoring).fit(unknown)
    with pytest.raises(ArgumentError, match="outcome_covariates names 'age'"):
        CensoredQLearner.of_paper(2, ACTIONS, FULL, censoring=DoublyRobust(outcome_covariates=["age"])).fit(known)


KINDS = [Weighted(), DoublyRobust(), BuckleyJames(), Unweighted()]


@pytest.fixture(scope="module")
def logs():
    return with_known_actions(two_stage_trial(num_trajectories=80))


def weighed(logs, targets, **options):
    model, trajectories = QModel(2, NamedActions(ACTIONS, ["s1_1", "s2_1"]), targets, **options).fitted(logs)
    return model, trajectories, *model.weights_and_imputation(trajectories)


@pytest.mark.parametrize(
    ("targets", "weights"),
    [
        (Weighted(truncate_at=1.5), lambda model, trajectories: model.cut_model.weights(trajectories.clocks)),
        (
            DoublyRobust(outcome_covariates=["s2_1"]),
            lambda model, trajectories: model.cut_model.begun_weights(trajectories.clocks),
        ),
        (BuckleyJames(), lambda model, trajectories: trajectories.is_begun),
        (Unweighted(), lambda model, trajectories: trajectories.is_completed),
    ],
    ids=lambda each: getattr(type(each), "__name__", ""),
)
def test_what_stages_weigh_and_what_is_imputed(logs, targets, weights):
    model, trajectories, weight, imputed = weighed(logs, targets)
    np.testing.assert_array_equal(weight, weights(model, trajectories))
    assert (imputed is None) == isinstance(targets, Weighted | Unweighted)
    assert (model.cut_model is None) == isinstance(targets, BuckleyJames | Unweighted)
    if isinstance(targets, Weighted):
        assert weight.max() == pytest.approx(1.5)
    if isinstance(targets, DoublyRobust):
        assert imputed.is_used.tolist() == [0.0, 1.0]
        assert imputed.share[trajectories.is_completed].max() > 1.0
        inverse = np.minimum(np.where(trajectories.is_completed, imputed.share, 0.0), 3.0)
        np.testing.assert_allclose(imputed.outcome_weight, inverse)
    if isinstance(targets, BuckleyJames):
        np.testing.assert_array_equal(imputed.share, trajectories.is_completed)
        assert imputed.is_used.tolist() == [1.0, 1.0]


def test_the_outcome_regression_chooses_among_the_covariates_of_a_linear_q_only(logs):
    with pytest.raises(ArgumentError, match="but selects covariates of a linear Q only"):
        weighed(logs, DoublyRobust(outcome_covariates=["s2_1"]), space=KernelQ(10))
    _, _, _, imputed = weighed(logs, DoublyRobust(), space=KernelQ(10))
    assert imputed.is_used.all()


def test_names_and_models_are_shorthands():
    assert [targets_of(name) for name in CENSORING_NAMES] == [Weighted(name) for name in CENSORING_NAMES]
    assert targets_of("buckley-james") == BuckleyJames()
    assert targets_of("none") == Unweighted()
    model = Cox(ridge=1.0)
    assert targets_of(model) == Weighted(model)
    assert all(targets_of(kind) is kind for kind in KINDS)


def test_plain_settings_make_the_same():
    settings = {"by": "pooled", "covariates": ["x"], "truncate_at": 9.0}
    assert named_targets("cox", **settings) == Weighted("cox", "pooled", ["x"], 9.0)
    robust = named_targets("cox", **settings, is_doubly_robust=True, outcome_covariates=["z"])
    assert robust == DoublyRobust("cox", "pooled", ["x"], 9.0, ["z"])
    assert named_targets("buckley-james", outcome_covariates=["z"]) == BuckleyJames(["z"])
    assert named_targets("none") == Unweighted()


@pytest.mark.parametrize("name", ["none", "buckley-james"])
def test_what_needs_a_model_of_the_cuts_is_refused_where_there_is_none(name):
    weighs = "{} is .*, but censoring '" + name + "' uses no weights; leave it out"
    for said, message in (
        ({"by": "stage"}, weighs.format("by")),
        ({"covariates": ["z"]}, weighs.format("covariates")),
        ({"truncate_at": 9.0}, weighs.format("truncate_at")),
        ({"is_doubly_robust": True}, f"doubly robust targets need a model of the cuts, but censoring is '{name}'"),
    ):
        with pytest.raises(ArgumentError, match=message):
            named_targets(name, **said)
    with pytest.raises(ArgumentError, match=f"censoring is '{name}'; give 'kaplan-meier'"):
        DoublyRobust(name)


def learner(**options):
    return CensoredQLearner.of_paper(2, ACTIONS, ["s1_1", "s2_1"], reg=0.1, **options)


def ages(logs):
    """Path, stage, how long the stage was watched, and whether it was completed."""
    rows = []
    for trajectory, stages in logs.stages.groupby("trajectory"):
        before, end_s = 0.0, logs.trajectories.set_index("trajectory").loc[trajectory, "end_s"]
        for stage, elapsed_s in zip(stages["stage"], stages["elapsed_s"], strict=True):
            is_completed = not np.isnan(elapsed_s)
            # A stage that is cut as it begins is watched for no time at all.
            age = max((elapsed_s if is_completed else end_s) - before, 1e-9)
            rows.append((trajectory, stage - 1, age, is_completed))
            before = elapsed_s
    return pd.DataFrame(rows, columns=["trajectory", "stage", "age", "is_completed"])


def test_actions_can_hasten_cuts(known):
    fitted = learner(censoring=Weighted(Cox(ridge=0.1), by="pooled")).fit(known).cut_model_
    model, columns = fitted.fitted[0]
    assert [name for name, _ in zip(model.covariates_, columns, strict=True)] == ["s1_1", "s2_1", "action=B"]
    rows = ages(known)
    frame = known.stages[["s1_1", "s2_1"]].assign(b=(known.stages["action"] == "B").astype(float))
    by_hand = Cox(ridge=0.1).fit(rows["age"], rows["is_completed"], frame.to_numpy())
    np.testing.assert_allclose(model.coefficients_, by_hand.coefficients_, atol=1e-9)


def test_what_cuts_cannot_depend_on_is_refused(trial, known):
    with pytest.raises(
        ArgumentError, match=r"trajectory \d+, stage \d: action=B is not known, but the model of the cuts uses it"
    ):
        learner(censoring=Weighted("cox", by="stage")).fit(trial)
    with pytest.raises(ArgumentError, match="none of those of all stages differs between trajectories"):
        learner(censoring=Weighted("cox", by="pooled", covariates=[])).fit(known)
    texts = Logs(known.stages.assign(colour="red"), known.trajectories)
    with pytest.raises(ArgumentError, match="censoring covariate 'colour' is 'red' in every stage"):
        learner(censoring=Weighted("cox", covariates=["colour"])).fit(texts)
    with pytest.raises(LogError, match="the stages have no column 'weather'"):
        learner(censoring=Weighted("cox", covariates=["weather"])).fit(known)
