import numpy as np

from halfseen.perception import XTION, DepthSensor


def test_noise_grows_with_the_square_of_the_distance_from_a_floor_on():
    assert isinstance(XTION, DepthSensor)
    np.testing.assert_allclose(XTION.noise_m(np.array([0.1, 1.0, 2.0])), [0.001, 0.003, 0.012])
