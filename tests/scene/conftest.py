import numpy as np
import pytest

from halfseen.scene import Capture, Table, capture, read_table


@pytest.fixture(scope="session")
def table() -> Table:
    """One that ships: drawing one takes long, as cups fall and come to rest."""
    return read_table(3)


@pytest.fixture(scope="session")
def picture(table: Table) -> Capture:
    return capture(table, 3)


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)
