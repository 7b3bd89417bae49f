import numpy as np
import pytest

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
