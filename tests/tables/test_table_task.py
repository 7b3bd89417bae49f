"""The task of tables: the prior that a log tells."""

import numpy as np
import pandas as pd
import pytest
from scipy.special import expit

from halfseen.errors import ArgumentError, LogError
from halfseen.learning import Task
from halfseen.logs import Logs
from halfseen.tables import TableTask
from halfseen.tables.prior import logged_dirty_share


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
