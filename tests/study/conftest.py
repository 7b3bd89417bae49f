import pytest
from tiny import SETTING, TINY

from halfseen.study.runner import run_study
from halfseen.workers import Workers


@pytest.fixture(scope="session")
def study_folder(tmp_path_factory):
    """Where the tiny study was run from end to end, once."""
    folder = tmp_path_factory.mktemp("study") / "new" / "folder"
    run_study(SETTING, folder, TINY, workers=Workers(1))
    return folder
