import pytest
from example_map import TINY_MAP

from halfseen.scene import table_paths
from halfseen.study.design import StudyDesign
from halfseen.study.run import run_study

TINY = StudyDesign(
    repetitions=2,
    num_paths=(25, 50),
    cut_shares=(0.0, 1 / 2),
    table_num_paths=50,
    grasp_num_paths=(25, 50),
    episodes_per_scene=1,
    planning_horizons=(1, 2),
    planning_simulations=8,
    search_simulations=(("1 ms", 8, 2),),
    regret_tables=2,
    regret_horizon=3,
    regret_num_paths=(25, 50),
    clutter_map=TINY_MAP,
)


@pytest.fixture(scope="session")
def tiny_design():
    return TINY


@pytest.fixture(scope="session")
def two_clouds():
    return list(table_paths()[5:7])


@pytest.fixture(scope="session")
def study_folder(tiny_design, two_clouds, tmp_path_factory):
    """Where the tiny study was run from end to end, once."""
    folder = tmp_path_factory.mktemp("study") / "new" / "folder"
    run_study(tiny_design, two_clouds, folder)
    return folder
