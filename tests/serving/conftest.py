import json

import numpy as np
import pytest
from asking import written

from halfseen.learning import CensoredQLearner
from halfseen.policies.folder import write_policy
from small_logs import HIDES, table_log


@pytest.fixture(scope="session")
def tables(tmp_path_factory):
    """A policy of tables of three objects, of four stages."""
    logs = table_log(horizon=4, num_objects=3, hides=np.pad(HIDES, (0, 1)))
    folder = tmp_path_factory.mktemp("serving") / "tables"
    write_policy(CensoredQLearner.for_table(4, reg=0.1).fit(logs), logs, folder)
    return folder


@pytest.fixture(scope="session")
def flat(tmp_path_factory):
    """A policy of named actions, of two stages."""
    return written(tmp_path_factory.mktemp("serving") / "flat")


@pytest.fixture(scope="session")
def objects():
    """The first stage of a table, as a log has it."""
    logs = table_log(num_trajectories=1, num_objects=3, hides=np.pad(HIDES, (0, 1)), seed=2)
    rows = logs.objects[(logs.objects["trajectory"] == 0) & (logs.objects["stage"] == 1)]
    return json.loads(rows.drop(columns=["trajectory", "stage"]).to_json(orient="records"))
