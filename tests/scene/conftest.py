import numpy as np
import pytest

from halfseen.scene import Capture, Pose, Table, capture, random_table
from halfseen.scene.camera import Camera


@pytest.fixture(scope="session")
def table() -> Table:
    return random_table(3)


@pytest.fixture(scope="session")
def picture(table: Table) -> Capture:
    return capture(table, 3)


@pytest.fixture
def small_camera() -> Camera:
    """A coarse camera at the world's origin whose frame is the world's: looks along z, y down."""
    return Camera(Pose((0.0, 0.0, 0.0)), (160.0, 160.0), (79.5, 59.5), 120, 160)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)
