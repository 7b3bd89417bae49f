"""Each kind of policy, learned and written once."""

import shutil

import pytest
from policy_folders import LEARNERS

from halfseen.policies.folder import read_policy, write_policy


@pytest.fixture(scope="session")
def logs():
    return {kind: make() for kind, (make, _) in LEARNERS.items()}


@pytest.fixture(scope="session")
def fitted(logs):
    return {kind: learner().fit(logs[kind]) for kind, (_, learner) in LEARNERS.items()}


@pytest.fixture(scope="session")
def kept(logs, fitted, tmp_path_factory):
    """A folder with a folder of each kind, which nobody changes."""
    folder = tmp_path_factory.mktemp("policies")
    for kind, learner in fitted.items():
        write_policy(learner, logs[kind], folder / kind)
    return folder


@pytest.fixture
def copied(kept, tmp_path):
    """Gives a copy of the folder of a kind, to be changed."""
    return lambda kind: shutil.copytree(kept / kind, tmp_path / "policy", dirs_exist_ok=True)


@pytest.fixture
def written(copied):
    return copied("flat")


@pytest.fixture
def stored(tmp_path):
    """Gives what is read back of a learner that was fitted to a log and written."""

    def store(learner, logs):
        write_policy(learner.fit(logs), logs, tmp_path / "stored")
        return read_policy(tmp_path / "stored")

    return store
