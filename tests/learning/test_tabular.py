"""A table of states by actions: by a naive loop, without cuts ordinary averages, and through the learner."""

import numpy as np
import pandas as pd
import pytest

from halfseen.errors import ArgumentError, LogError
from halfseen.evaluation import evaluate, held_out_verdict
from halfseen.learning import CensoredQLearner
from halfseen.learning.q_space import TabularQ
from halfseen.learning.resampling import bootstrap
from halfseen.learning.rows import Transitions
from halfseen.learning.tabular import STAGES_OF_VARIANCE, fit_table
from halfseen.logs import Logs
from halfseen.logs.stream import opened
from halfseen.policies.folder import read_policy, write_policy
from halfseen.policies.folder.promised_parts import promised_parts
from halfseen.policies.learner_choice import learner_for
from text_logs import ACTIONS, text_log

COLOURS = (*(f"c{k:02d}" for k in range(29)), "red")
NUM_STATES, NUM_ACTIONS, HORIZON = 4, 3, 3


@pytest.fixture(scope="module")
def logs():
    return text_log(400, colours=COLOURS)


def learner_of(**changed):
    return CensoredQLearner(2, ACTIONS, ["colour"], **changed)


def transitions(seed=0, num=40, is_cut=True):
    """Trajectories among four states, of which some end early and some are cut."""
    rng = np.random.default_rng(seed)
    shape = num, HORIZON
    begun = np.arange(HORIZON) < rng.integers(1, HORIZON + 1, num)[:, None]
    last = begun & ~np.pad(begun[:, 1:], ((0, 0), (0, 1)))
    cut = last & (rng.random((num, 1)) < 0.3) if is_cut else np.zeros(shape, dtype=bool)
    done = begun & ~cut
    weight = np.cumprod(np.where(done, rng.uniform(1.0, 2.0, shape), 1.0), axis=1) if is_cut else np.ones(shape)
    return Transitions(
        features=np.where(begun, rng.integers(1, NUM_STATES + 1, shape), 0.0)[..., None, None],
        is_possible=np.ones((*shape, NUM_ACTIONS), dtype=bool),
        action=rng.integers(NUM_ACTIONS, size=shape),
        reward=np.where(done, rng.normal(size=shape), 0.0),
        weight=np.where(done, weight, 0.0),
        is_last=last & done,
        fold=np.zeros(num, dtype=np.int64),
    )


def rows_of(log, value, to_go):
    """(state, action, target, weight) of each completed stage."""
    rows = []
    for i, t in zip(*np.nonzero(log.weight > 0), strict=True):
        own = log.weight[i, t] / (log.weight[i, t - 1] if t else 1.0)
        at_horizon = t == HORIZON - 1
        if at_horizon and to_go > 1:
            continue
        after = 0.0 if log.is_last[i, t] else value[int(log.features[i, t + 1, 0, 0]) - 1]
        rows.append((int(log.features[i, t, 0, 0]) - 1, log.action[i, t], log.reward[i, t] + after, own))
    return rows


def naive_cells(rows):
    """Mean, effective number and squares of each cell."""
    cells = {}
    for key in {row[:2] for row in rows}:
        x, w = np.array([row[2:] for row in rows if row[:2] == key]).T
        mean, n = np.average(x, weights=w), w.sum() ** 2 / (w**2).sum()
        cells[key] = mean, n, n * np.average((x - mean) ** 2, weights=w)
    return cells


def naive_table(rows, kappa):
    """Q, each cell shrunk towards the mean of its state as it is said."""
    cells, table = naive_cells(rows), np.full((NUM_STATES, NUM_ACTIONS), np.nan)
    for state in range(NUM_STATES):
        own = {a: cell for (s, a), cell in cells.items() if s == state}
        middle = np.average([m for m, *_ in own.values()], weights=[n for _, n, _ in own.values()])
        for a, (mean, n, _) in own.items():
            table[state, a] = middle + (mean - middle) * n / (n + kappa)
    return table


def q_of(fits):
    """Q by steps to go, state and action."""
    q = fits.coefficients.copy()
    q[..., 1:] += q[..., :1]
    return q.swapaxes(-1, -2)


@pytest.mark.parametrize("kappa", [0.0, 5.0])
@pytest.mark.parametrize("is_cut", [True, False])
def test_each_step_is_that_of_a_naive_loop(kappa, is_cut):
    log = transitions(is_cut=is_cut)
    found, value = q_of(fit_table(log, NUM_STATES, kappa)), np.zeros(NUM_STATES)
    for to_go in range(1, HORIZON + 1):
        wanted = naive_table(rows_of(log, value, to_go), kappa)
        seen = ~np.isnan(wanted)
        np.testing.assert_allclose(found[to_go - 1][seen], wanted[seen])
        value = np.nanmax(wanted, axis=1)


def test_without_cuts_and_pooling_the_last_step_is_an_ordinary_average():
    log = transitions(is_cut=False)
    rows = pd.DataFrame({"s": log.features[..., 0, 0].ravel(), "a": log.action.ravel(), "r": log.reward.ravel()})[
        (log.weight > 0).ravel() & (log.features[..., 0, 0] > 0).ravel()
    ]
    found = q_of(fit_table(log, NUM_STATES, 0.0))[0]
    for (s, a), mean in rows.groupby(["s", "a"])["r"].mean().items():
        assert found[int(s) - 1, a] == pytest.approx(mean)


def test_kappa_and_what_the_log_prefers_are_found_by_moments():
    log = transitions(num=300)
    fits = fit_table(log, NUM_STATES)
    cells = naive_cells(rows_of(log, np.zeros(NUM_STATES), 1))
    pooled = sum(ss for *_, ss in cells.values()) / sum(n - 1 for _, n, _ in cells.values())
    chance = squares = of_n = cross = spread = 0.0
    apart = {}
    for state in range(NUM_STATES):
        mean, n, ss = np.array([cell for (s, _), cell in sorted(cells.items()) if s == state]).T
        noise = (ss.sum() + STAGES_OF_VARIANCE * pooled) / ((n - 1).sum() + STAGES_OF_VARIANCE)
        x, m = (each - np.average(each, weights=n) for each in (np.log(n), mean))
        apart[state] = x, m, n, noise
        cross, spread = cross + (n * x * m / noise).sum(), spread + (n * x * x / noise).sum()
    gamma = max(cross / spread, 0.0)
    for x, m, n, noise in apart.values():
        rest = 1.0 - n / n.sum()
        chance, of_n = chance + rest.sum(), of_n + (n * rest).sum()
        squares += (n * (m - gamma * x) ** 2 / noise).sum()
    assert fits.reg[0, 0] == pytest.approx(of_n / max(squares - chance, np.sqrt(2.0 * chance)))


def test_what_differs_for_sure_is_hardly_shrunk_and_a_cell_that_was_never_seen_is_worth_least():
    log = transitions(num=200, is_cut=False)
    log = log._replace(reward=10.0 * log.action, is_last=np.ones_like(log.is_last))
    log.action[log.features[..., 0, 0] == 2] %= 2
    q = q_of(fit_table(log, NUM_STATES))[0]
    np.testing.assert_allclose(q[[0, 2, 3]] - q[[0, 2, 3], :1], np.tile([0.0, 10.0, 20.0], (3, 1)), rtol=0.01)
    assert q[1, 2] < q[1, :2].min()


def test_a_state_that_was_never_completed_is_worth_what_others_are_on_average():
    log = transitions(num=200, is_cut=False)
    q = q_of(fit_table(log, NUM_STATES + 1))[0]
    np.testing.assert_allclose(q[-1], q[-1, 0])
    assert q[:-1].min() < q[-1, 0] < q[:-1].max()


def test_a_log_whose_stages_all_were_cut_at_once_is_refused():
    log = transitions()
    with pytest.raises(ArgumentError, match="no stage was completed"):
        fit_table(log._replace(weight=0.0 * log.weight), NUM_STATES)


def test_text_of_many_categories_makes_q_a_table_by_itself_and_nothing_else_does(logs):
    learner = learner_of().fit(logs)
    assert learner.model_.space == TabularQ()
    assert learner.chosen_ == ("Q is a table: colour holds the states",)
    assert learner.decide(pd.DataFrame({"colour": ["red", "c00"]}), 1).tolist() == ["B", "A"]
    assert learner.policy_.coefficients.shape == (2, 2, 30)
    assert not isinstance(learner_of().compose(text_log()).space, TabularQ)
    with pytest.raises(LogError, match="more than 20 categories"):
        learner_of(q_function="linear").fit(logs)
    of_trajectory = logs.stages.assign(colour=logs.stages["trajectory"].map("order {}".format))
    with pytest.raises(LogError, match="more than 20 categories"):
        learner_of().fit(type(logs)(of_trajectory, logs.trajectories))


def test_numbers_are_names_where_a_table_is_asked_for(logs):
    numbered = logs.stages.assign(colour=logs.stages["colour"].map(COLOURS.index))
    by_number = learner_of(q_function="tabular").fit(type(logs)(numbered, logs.trajectories))
    by_name = learner_of().fit(logs)
    for stage in (1, 2):
        frame = pd.DataFrame({"colour": [29, 3]})
        named = frame.assign(colour=frame["colour"].map(COLOURS.__getitem__))
        np.testing.assert_allclose(by_number.q_values(frame, stage), by_name.q_values(named, stage))


def test_the_order_of_trajectories_does_not_matter(logs):
    other = logs.select(logs.trajectory_ids[::-1])
    frame = pd.DataFrame({"colour": list(COLOURS)})
    one, two = (learner_of().fit(each).q_values(frame, 1) for each in (logs, other))
    np.testing.assert_allclose(one, two)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"pessimism": 1.0}, "pessimism 1.0; leave them out"),
        ({"stages": "separate"}, "stages is 'separate'"),
        ({"censoring": "buckley-james"}, "'buckley-james' imputes"),
        ({"half_life": 100.0}, "half_life is 100.0; select those since a change"),
    ],
)
def test_what_a_table_cannot_do_is_refused(logs, changed, message):
    with pytest.raises(ArgumentError, match=message):
        learner_of(**changed).fit(logs)


def test_a_table_needs_one_covariate_and_a_log_in_memory(logs, tmp_path):
    with pytest.raises(ArgumentError, match="one covariate"):
        CensoredQLearner(2, ACTIONS, ["colour", "x"], q_function="tabular").fit(logs)
    logs.write(tmp_path / "log")
    with pytest.raises(ArgumentError, match="leave --streaming out"):
        learner_of(q_function="tabular").fit(opened(tmp_path / "log", True))


def test_states_are_names_or_numbers(logs):
    states = logs.stages["colour"]
    structs = Logs(logs.stages.assign(colour=[{"is": each} for each in states]), logs.trajectories)
    with pytest.raises(ArgumentError, match="'tabular', but colour holds mixed; give names or numbers"):
        learner_of(q_function="tabular").fit(structs)
    with pytest.raises(LogError, match="holds mixed, neither numbers nor text"):
        learner_of(q_function="linear").fit(structs)


@pytest.mark.slow
def test_its_verdict_is_better_where_that_is_so_and_says_by_how_much(logs):
    few = held_out_verdict(learner_of().fit(logs), logs)
    assert few.verdict == "inconclusive"
    assert "times a state, but 10 are needed" in few.reason
    logs = text_log(2500, colours=COLOURS)
    verdict = held_out_verdict(learner_of().fit(logs), logs)
    assert verdict.verdict == "better"
    # B is worth 2 more than A where it is right, and the log chose by a coin, in two stages.
    assert "more than the logging policy (95% interval 1." in verdict.reason
    with_nothing = type(logs)(logs.stages.assign(reward=logs.stages["reward"] * 0.0 + 1.0), logs.trajectories)
    assert held_out_verdict(learner_of().fit(with_nothing), with_nothing).verdict == "inconclusive"


def test_a_folder_holds_a_table_and_the_command_line_makes_one_of_a_log_of_nothing_but_states(logs, tmp_path):
    alone = type(logs)(logs.stages.drop(columns=["x", "is_heavy"]), logs.trajectories)
    choice = learner_for(alone)
    assert (list(choice.learner.covariates), choice.notes) == (["colour"], ())
    learner = choice.learner.fit(alone)
    write_policy(learner, alone, tmp_path / "policy")
    frame = pd.DataFrame({"colour": ["red", "c07"]})
    read = read_policy(tmp_path / "policy").policy
    np.testing.assert_array_equal(read.q_values(frame, 1), learner.q_values(frame, 1))
    assert learner_for(logs).learner.covariates == ["x", "is_heavy"]


def test_of_a_state_that_is_one_of_hundreds_no_regression_of_what_it_earns_is_kept():
    names = tuple(f"s{k:03d}" for k in range(250))
    logs = text_log(1500, colours=names)
    learner = learner_of().fit(logs)
    assert promised_parts(logs, learner.policy_)["parts"] == []


def test_indicators_that_would_fill_the_memory_are_refused(logs, monkeypatch):
    monkeypatch.setattr("halfseen.learning.named_task.MOST_MEMORY", 1e5)
    with pytest.raises(ArgumentError, match="30 features of 2 actions, in 400 trajectories of up to 2 stages, take"):
        evaluate(learner_of().fit(logs).policy_, logs)


def test_bootstrap_learns_tables_again_whose_spread_is_that_of_the_mean_of_a_cell():
    logs = text_log(3000, colours=COLOURS)
    learner, frame = CensoredQLearner(2, ACTIONS, ["colour"], reg=0.0).fit(logs), pd.DataFrame({"colour": ["red"]})
    low, high = bootstrap(learner, logs, 60, 0, is_quiet=True).q_interval(frame, 2)
    cell = logs.stages.query("colour == 'red' and action == 'A' and reward.notna()")["reward"]
    assert (high - low)[0, 0] == pytest.approx(2 * 1.96 * cell.std() / np.sqrt(len(cell)), rel=0.35)
    assert low[0, 0] < cell.mean() < high[0, 0]
