import jax
import numpy as np
import pytest

from halfseen.world import Scene, UniformPolicy, WorldConfig
from halfseen.world.episodes import play
from halfseen.world.state import pad_scenes

NUM_EPISODES = 3000


def random_scene(num_objects, seed, largest=0.6):
    rng = np.random.default_rng(seed)
    hides = rng.uniform(0.0, largest, (num_objects, num_objects)) * (rng.random((num_objects, num_objects)) < 0.5)
    np.fill_diagonal(hides, 0.0)
    return Scene(hides, name=f"random-{num_objects}")


@pytest.fixture(scope="session")
def scenes():
    return [random_scene(1, 0), random_scene(3, 1), random_scene(5, 2)]


@pytest.fixture(scope="session")
def played(scenes):
    return play(WorldConfig(), pad_scenes(scenes), UniformPolicy(), jax.random.key(7), NUM_EPISODES)


@pytest.fixture(scope="session")
def played_again(scenes):
    return play(WorldConfig(), pad_scenes(scenes), UniformPolicy(), jax.random.key(8), NUM_EPISODES)
