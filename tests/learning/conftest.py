import pytest
from trials import two_stage_trial, with_known_actions


@pytest.fixture(scope="package")
def trial():
    return two_stage_trial()


@pytest.fixture(scope="package")
def known(trial):
    return with_known_actions(trial)
