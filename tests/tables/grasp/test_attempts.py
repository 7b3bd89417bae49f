"""Attempts of one robot, and of a team, against the episodes that the logs were made from, and a log by hand."""

import numpy as np
import pandas as pd
import pytest

from halfseen.errors import LogError
from halfseen.logs import Logs
from halfseen.tables import attempts
from halfseen.world import ActionSpace, Scene, UniformPolicy, WorldConfig, random
from halfseen.world.cuts import cut, cut_rate
from halfseen.world.logs import to_logs
from halfseen.world.rollout import play
from halfseen.world.state import attempt_counts, occlusion, pad_scenes
from played_teams import NUM_OBJECTS as TEAM_OBJECTS
from played_teams import SureGrasping, logged, played, team_of

CONFIG = WorldConfig()
NUM_OBJECTS = 3


@pytest.fixture(scope="module")
def scene():
    hides = np.zeros((NUM_OBJECTS, NUM_OBJECTS))
    hides[1, 0], hides[2, 1] = 0.6, 0.4
    return Scene(hides)


@pytest.fixture(scope="module")
def cuts(scene):
    episodes = play(CONFIG, pad_scenes([scene]), UniformPolicy(), random.key_of(0), 200)
    return cut(episodes, cut_rate(episodes, 0.5, "independent"), "independent", np.random.default_rng(0))


@pytest.fixture(scope="module")
def table(cuts, scene):
    return attempts(to_logs(cuts, "independent", [scene]), horizon=CONFIG.horizon)


def expected_rows(cuts):
    """Each attempt as the episodes have it: nothing here looks at a log."""
    states, rows = cuts.episodes.states, []
    seen = (occlusion(states), *attempt_counts(states))
    occluded, successes, failures = (np.asarray(leaf) for leaf in seen)
    last_state = np.asarray(states.attempt_succeeded)[:, -1]
    for trajectory, stage in np.argwhere(cuts.is_begun & (np.asarray(cuts.episodes.action) > 0)):
        if stage + 1 == CONFIG.horizon:
            continue
        target = (int(cuts.episodes.action[trajectory, stage]) - 1) % NUM_OBJECTS
        begun_s = float(np.sum(np.asarray(cuts.episodes.duration_s, dtype=float)[trajectory, :stage]))
        time_s, succeeded = cuts.end_s[trajectory] - begun_s, None
        is_finished = bool(cuts.is_completed[trajectory, stage])
        if is_finished:
            # States after the trajectory's own end are copies of its last one.
            time_s, succeeded = float(cuts.episodes.duration_s[trajectory, stage]), bool(last_state[trajectory, stage])
        seen_at = (share[trajectory, stage, target] for share in (occluded, successes, failures))
        rows.append((trajectory, stage + 1, *seen_at, succeeded, time_s, is_finished))
    names = ["trajectory", "stage", "occlusion", "successes", "failures", "succeeded", "time_s", "is_finished"]
    return pd.DataFrame(rows, columns=names)


def test_attempts_are_those_of_the_episodes(table, cuts):
    expected = expected_rows(cuts)
    assert len(expected) > 400
    for name in ("trajectory", "stage", "is_finished"):
        np.testing.assert_array_equal(table[name], expected[name])
    for name in ("occlusion", "successes", "failures", "time_s"):
        np.testing.assert_allclose(table[name], expected[name].astype(float), atol=1e-5)
    assert table["succeeded"].astype(object).where(table["succeeded"].notna(), None).tolist() == [
        None if value is None else bool(value) for value in expected["succeeded"]
    ]


def test_every_kind_of_end_is_there_and_objects_are_numbered_within_their_trajectories(table, cuts):
    """So that the comparison above has compared them."""
    is_cleared = cuts.is_finished & (cuts.is_completed.sum(axis=1) < CONFIG.horizon)
    action = np.asarray(cuts.episodes.action)
    last = action[np.arange(200), cuts.is_completed.sum(axis=1) - 1]
    cleared = np.flatnonzero(is_cleared & (last > 0))
    assert len(cleared) > 0
    assert table[table["trajectory"].isin(cleared)].groupby("trajectory")["succeeded"].last().all()
    assert (~table["is_finished"]).sum() > 20
    assert table["succeeded"].isna().equals(~table["is_finished"])
    assert (table.loc[table["succeeded"].fillna(True), "time_s"] <= 7.0 + 1e-4).all()
    np.testing.assert_allclose(table.loc[~table["succeeded"].fillna(True), "time_s"], 7.0, atol=1e-4)
    target = (action[table["trajectory"], table["stage"] - 1] - 1) % NUM_OBJECTS
    assert table.groupby(["trajectory", target])["object"].nunique().max() == 1
    assert table["object"].nunique() == len(table.assign(target=target).drop_duplicates(["trajectory", "target"]))


def by_hand():
    """Trajectory a: the mug is grasped and put back, the cup is missed, the jar's attempt is cut; b washes a jar."""
    stages = [
        ("a", 1, 2.0, "LIFT", "mug", -0.2),
        ("a", 2, 9.0, "WASH", "cup", -1.0),
        ("a", 3, None, "WASH", "jar", None),
        ("b", 1, 3.0, "WASH", "jar", 5.0),
    ]
    counts = {"cup": [(0, 0), (0, 0), (0, 1)], "jar": [(0, 0)] * 3, "mug": [(0, 0), (1, 0), (1, 0)]}
    objects = [("a", k + 1, name, 0.1, *of[k]) for name, of in counts.items() for k in range(3)]
    place = ["trajectory", "stage"]
    return (
        pd.DataFrame(stages, columns=[*place, "elapsed_s", "action", "object", "reward"]),
        pd.DataFrame({"trajectory": ["a", "b"], "end_s": [10.5, 3.0], "ending": ["cut", "finished"]}),
        pd.DataFrame(
            [*objects, ("b", 1, "jar", 0.0, 0, 0)], columns=[*place, "object", "occlusion", "successes", "failures"]
        ),
    )


def test_a_log_by_hand():
    stages, trajectories, objects = by_hand()
    table = attempts(Logs(stages, trajectories, objects), horizon=10)
    assert table["object"].tolist() == [0, 1, 2, 3]
    assert table["time_s"].tolist() == [2.0, 7.0, 1.5, 3.0]
    assert table["is_finished"].tolist() == [True, True, False, True]
    assert table["succeeded"].tolist() == [True, False, pd.NA, True]
    # The horizon leaves its last stage out, and so is an attempt that was cut as it began.
    assert attempts(Logs(stages, trajectories, objects))["stage"].tolist() == [1, 2, 1]
    assert len(attempts(Logs(stages, trajectories, objects), horizon=2)) == 2
    at_once = trajectories.assign(end_s=[9.0, 3.0])
    assert attempts(Logs(stages, at_once, objects), horizon=10)["is_finished"].all()


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda s, p, o: (s, p, None), "objects: the log has no objects table"),
        (lambda s, p, o: (s, p, o.drop(columns="failures")), "there is no column 'failures' among"),
        (
            lambda s, p, o: (s, p, o.assign(successes=0)),
            "trajectory 'a', stage 1: LIFT of object 'mug': successes and failures do not grow by this one attempt",
        ),
        (
            lambda s, p, o: (s.assign(action=s["action"].where(s["trajectory"] == "a", "LIFT")), p, o),
            "trajectory 'b', stage 1: LIFT of object 'jar': no later stage shows",
        ),
        (
            lambda s, p, o: (s, p, o[~((o["stage"] == 2) & (o["object"] == "mug") & (o["trajectory"] == "a"))]),
            "trajectory 'a', stage 1: LIFT of object 'mug': no later stage shows",
        ),
    ],
)
def test_logs_that_do_not_tell_are_refused(spoil, message):
    with pytest.raises(LogError, match=message):
        attempts(Logs(*spoil(*by_hand())), horizon=10)


SPACE = ActionSpace(TEAM_OBJECTS)


@pytest.mark.parametrize("cut_share", [0.0, 0.5])
def test_of_one_robot_they_are_those_of_one_robot(cut_share):
    team = team_of(1)
    trajectories = played(team, 120, seed=3)
    logs = logged(trajectories, cut_share)
    of_robots = [name for name in logs.stages if name == "robot" or name.startswith("0_")]
    alone = Logs(logs.stages.drop(columns=of_robots), logs.trajectories, logs.objects)
    ours, theirs = attempts(logs), attempts(alone, 5)
    assert len(theirs) > 100
    assert ours["is_finished"].tolist() == theirs["is_finished"].tolist()
    for name in ("trajectory", "stage", "successes", "failures", "succeeded"):
        pd.testing.assert_series_equal(ours[name], theirs[name], check_dtype=False)
    for name in ("occlusion", "grip", "time_s"):
        np.testing.assert_allclose(ours[name], theirs[name], rtol=1e-5, atol=1e-5)
    pairs = pd.DataFrame({"ours": ours["object"], "theirs": theirs["object"]}).drop_duplicates()
    assert pairs["ours"].is_unique
    assert pairs["theirs"].is_unique


def test_each_lasts_until_its_robot_is_free():
    world = WorldConfig(horizon=5, grasping=SureGrasping(), transport_s=1.0, speed=(1.0, 2.0))
    trajectories = played(world, 60, seed=4)
    logs = logged(trajectories, 0.0)
    found = attempts(logs)
    at = pd.Index(logs.trajectory_ids).get_indexer(found["trajectory"]), found["stage"].to_numpy() - 1
    speed = np.array([1.0, 2.0])[trajectories.states.decider[at]]
    target = SPACE.target(trajectories.action)[at]
    assert found["is_finished"].all()
    assert found["succeeded"].all()
    np.testing.assert_allclose(found["time_s"], (1.0 + 1.0 + 2.0 * target) / speed, rtol=1e-4)


def test_a_robot_that_drops_out_cuts_its_own_attempt():
    trajectories = played(team_of(2, drop_out_rate=(0.05, 0.0)), 80, seed=6)
    logs = logged(trajectories, 0.0)
    found = attempts(logs)
    out_s = logs.trajectories.set_index("trajectory")["0_out_s"]
    is_cut = ~found["is_finished"].to_numpy()
    assert 5 < is_cut.sum() < len(found)
    begun = logs.stages.set_index(["trajectory", "stage"])
    for trajectory, stage, time_s in found[is_cut][["trajectory", "stage", "time_s"]].itertuples(
        index=False, name=None
    ):
        assert begun.loc[(trajectory, stage), "robot"] == 0
        begun_s = 0.0 if stage == 1 else begun.loc[(trajectory, stage - 1), "elapsed_s"]
        assert time_s == pytest.approx(out_s[trajectory] - begun_s, abs=1e-4)
