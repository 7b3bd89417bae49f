import numpy as np

from halfseen.world import Scene


def random_scene(num_objects, seed, largest=0.6):
    """Some objects, each hidden by about half of the others."""
    rng = np.random.default_rng(seed)
    hides = rng.uniform(0.0, largest, (num_objects, num_objects)) * (rng.random((num_objects, num_objects)) < 0.5)
    np.fill_diagonal(hides, 0.0)
    return Scene(hides, name=f"random-{num_objects}")
