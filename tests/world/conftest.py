import pytest

from halfseen.world import UniformPolicy, WorldConfig, random
from halfseen.world.rollout import play
from halfseen.world.state import pad_scenes
from world.world_cases import random_scene

NUM_EPISODES = 3000


@pytest.fixture(scope="session")
def scenes():
    return [random_scene(1, 0), random_scene(3, 1), random_scene(5, 2)]


@pytest.fixture(scope="session")
def played(scenes):
    return play(WorldConfig(), pad_scenes(scenes), UniformPolicy(), random.key_of(7), NUM_EPISODES)


@pytest.fixture(scope="session")
def played_again(scenes):
    return play(WorldConfig(), pad_scenes(scenes), UniformPolicy(), random.key_of(8), NUM_EPISODES)
