"""Two arms at the two ends of the table, each the other's mirror image, with a rack behind its end.

The camera looks along the table's short side, so that neither arm stands before it; each waits over its own rack, out
of the way of the other, and reaches its own half of the table and a little more.
"""

import numpy as np

from halfseen.cell.model import Rack, Robot, Station

_BASE_M, _RACK_M, _RACK_SIZE_M = (0.55, 0.05, 0.68), (0.45, 0.56, 0.55), (0.40, 0.40, 0.06)
_REACH_M = 0.68  # to where it comes down from above, and can lift straight up
_RIGHT_HOME_RAD = (-1.622, 3.547, 1.463, -2.797, -1.244, 1.864)
_LEFT_HOME_RAD = (-1.520, 2.736, 4.820, 2.797, 1.244, -1.864)


def _station(name: str, side: float, home_rad: tuple[float, ...]) -> Station:
    (x_m, *base_m), (rack_x_m, *rack_m) = _BASE_M, _RACK_M
    turn_rad = 0.0 if side < 0 else np.pi
    robot = Robot(name, (side * x_m, base_m[0], base_m[1]), float(turn_rad), home_rad=home_rad)
    return Station(robot, Rack((side * rack_x_m, rack_m[0], rack_m[1]), _RACK_SIZE_M), _REACH_M)


PAIR = (_station("left", -1.0, _LEFT_HOME_RAD), _station("right", 1.0, _RIGHT_HOME_RAD))
"""Left and right, as the camera sees them."""
