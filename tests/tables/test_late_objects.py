"""Logs of tables whose objects come into view one after the other, as those of a cell do."""

import numpy as np
import pandas as pd
import pytest

from halfseen.errors import LogError
from halfseen.learning import CensoredQLearner
from halfseen.logs import Logs
from halfseen.tables.encoding import logged_actions
from halfseen.tables.evidence import evidence_of
from halfseen.tables.features import table_features
from halfseen.world import ActionSpace, WorldConfig
from halfseen.world.actions import possible_actions
from halfseen.world.logs import states_of
from small_logs import table_log

LATE_HIDES = {"bowl": {"cup": 0.1, "fork": 0.2}, "cup": {"bowl": 0.3}, "fork": {"mug": 0.4}, "mug": {"cup": 0.5}}
TRIED_IN = {"cup": 1, "fork": 2, "mug": 3, "bowl": 4}


def late(listed):
    """One trajectory, with these objects at its stages; it tries cup, fork and mug in turn, and none holds."""
    rows = [
        {
            "trajectory": 0,
            "stage": stage,
            "object": name,
            "location": "TABLE",
            "occlusion": 0.3,
            "log_odds": float(len(name) + stage),
            "lifts": 0,
            "hidden_by": [LATE_HIDES[name].get(other, 0.0) for other in there],
            "successes": 0,
            "failures": int(stage > TRIED_IN[name]),
            "attempt_occlusions": [0.2] * (stage > TRIED_IN[name]),
            "attempt_succeeded": [False] * (stage > TRIED_IN[name]),
        }
        for stage, there in enumerate(listed, start=1)
        for name in there
    ]
    number = np.arange(1, len(listed) + 1)
    stages = pd.DataFrame({"trajectory": 0, "stage": number, "elapsed_s": 1.0 * number, "action": "LIFT"})
    stages = stages.assign(object=["cup", "fork", "mug"][: len(listed)], reward=-1.0)
    return Logs(stages, {"trajectory": [0], "end_s": [float(len(listed))], "ending": ["finished"]}, pd.DataFrame(rows))


def test_an_object_that_comes_into_view_late_is_padding_until_then():
    """The names of the late ones stand before those of the others, so that they do not keep their rank."""
    logs = late([["cup", "mug"], ["cup", "fork", "mug"], ["bowl", "cup", "fork", "mug"]])
    states = states_of(logs, 4)
    assert np.asarray(states.is_object)[0].tolist() == [
        [False, True, False, True],
        [False, True, True, True],
        [True, True, True, True],
        [False] * 4,
    ]
    np.testing.assert_array_equal(states.is_on_table, states.is_object)
    np.testing.assert_array_equal(np.asarray(states.log_odds)[0, :2], [[0.0, 4.0, 0.0, 4.0], [0.0, 5.0, 6.0, 5.0]])
    names = ["bowl", "cup", "fork", "mug"]
    full = np.array([[LATE_HIDES[i].get(j, 0.0) for j in names] for i in names])
    for stage in range(3):
        is_there = np.asarray(states.is_object)[0, stage]
        np.testing.assert_allclose(states.hides[0, stage], full * is_there[:, None] * is_there, rtol=1e-6)
    assert np.asarray(states.attempt_object)[0, 2].tolist() == [1, 2, -1, -1]
    actions = ActionSpace(4)
    chosen = logged_actions(logs, 4, 4)[0]
    assert [actions.names[action] for action in chosen] == ["LIFT 1", "LIFT 2", "LIFT 3", "FINISH"]
    assert np.isfinite(table_features(states)).all()
    assert possible_actions(states)[0, 0].tolist() == [True, *[False, True, False, True] * 2]


def test_what_is_not_in_view_yet_changes_nothing_of_what_is_decided():
    """Features of a stage are those of a log that ends there, and never lists the late ones."""
    listed = [["cup", "mug"], ["cup", "fork", "mug"]]
    whole, begun = (table_features(states_of(late(listed[:number]), 4)) for number in (2, 1))
    kept = [0, *(1 + k for k in (0, 2)), *(4 + k for k in (0, 2))]
    np.testing.assert_allclose(whole[0, 0, kept], begun[0, 0], rtol=1e-6)


def test_an_object_that_is_not_listed_again_is_named():
    with pytest.raises(
        LogError, match="trajectory 0, stage 2, object 'fork': stage 3 no longer lists it; list an object from"
    ):
        states_of(late([["cup", "mug"], ["cup", "fork", "mug"], ["cup", "mug"]]), 4)


def seen_later(logs, late):
    """The log, as if this object had come into view at the second stage, where nothing was done to it at the first."""
    stages, objects = logs.stages, logs.objects
    first = objects["stage"] == 1
    is_begun = stages[(stages["stage"] == 1) & (stages["object"] != late)]["trajectory"]
    is_late = first & objects["trajectory"].isin(is_begun)
    pairs = zip(objects["hidden_by"], is_late, strict=True)
    shorter = [[*each[:late], *each[late + 1 :]] if is_shorter else each for each, is_shorter in pairs]
    return Logs(stages, logs.trajectories, objects.assign(hidden_by=shorter)[~(is_late & (objects["object"] == late))])


def test_a_policy_is_learned_from_objects_that_come_late():
    hides = np.tril(np.full((3, 3), 0.3), -1)
    logs = seen_later(table_log(num_objects=3, hides=hides), 1)
    sizes = logs.objects.groupby(["trajectory", "stage"]).size()
    assert set(sizes.xs(1, level="stage")) == {2, 3}
    learner = CensoredQLearner.for_table(3, reg=0.1).fit(logs)
    assert np.isfinite(learner.policy_.coefficients).all()


def test_the_first_label_of_a_late_object_moves_it_from_the_prior():
    logs = late([["cup", "mug"], ["cup", "fork", "mug"]])
    at_even, high = (
        evidence_of(
            Logs(logs.stages, logs.trajectories.assign(dirty_share=share), logs.objects), WorldConfig(horizon=2)
        ).labels
        for share in (0.5, 0.9999)
    )
    # Cup and mug, then cup, fork and mug: the log-odds of the fork are 6, and those of a prior of 0.9999 are 9.2.
    assert at_even.object.tolist() == [0, 2, 0, 1, 2]
    assert at_even.says_dirty.tolist() == [True] * 5
    assert high.says_dirty.tolist() == [False, False, True, False, True]
