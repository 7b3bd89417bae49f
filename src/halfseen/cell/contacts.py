"""What makes a simulated grasp behave as a real one: step, solver and contact values, in one place.

They were found by trial: with them a cup that is gripped around stays where the pads hold it, slippery or not. They are
a simulation's, not a material's.
"""

# MuJoCo's names come from compiled modules without stubs, which pyright cannot look into.
# pyright: reportAttributeAccessIssue=false

from dataclasses import dataclass
from typing import Any

import mujoco

from halfseen.scene.rays import ROBOT_GROUP

FURNITURE, WALLS, OBSTACLES, FIRST_ROBOT = 1, 2, 4, 8
"""Contact bits: cups' hulls and furniture meet on the first; robots meet cups' walls and furniture on the next two, and
one another on one for each robot, from the last on."""

ROBOT: dict[str, Any] = {"contype": 0, "conaffinity": WALLS | OBSTACLES, "group": ROBOT_GROUP}
"""A robot's geoms meet what shows itself to robots, and nothing of their own; cameras tell them from cups."""


@dataclass(frozen=True)
class Contacts:
    """Values of the solver and of the contact of pads and cups.

    Parameters
    ----------
    timestep_s
        Length of a step [s].
    friction_to_normal
        How much stiffer friction is than the normal force (``impratio``) [-]: what is held does not creep out.
    pad_stiffness
        Time constant [s] and damping ratio [-] of a pad.
    pad_impedance
        Of a pad: least, largest [-], and the depth over which it grows [m].
    pad_friction
        Of pads on cups: sliding [-], spinning [m] and rolling [m].
    """

    timestep_s: float = 0.002
    friction_to_normal: float = 10.0
    pad_stiffness: tuple[float, float] = (0.008, 1.0)
    pad_impedance: tuple[float, float, float] = (0.9, 0.97, 0.001)
    pad_friction: tuple[float, float, float] = (0.9, 0.01, 0.0002)

    def solve(self, spec: mujoco.MjSpec) -> None:
        """Set a model's solver; what rests sleeps, and costs nothing."""
        spec.option.timestep = self.timestep_s
        spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
        spec.option.impratio = self.friction_to_normal
        spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
        spec.option.enableflags |= int(mujoco.mjtEnableBit.mjENBL_SLEEP)

    def of_pad(self, friction: float | None = None) -> dict[str, Any]:
        """Contact of a pad, or of a cup's wall with its own sliding friction [-], as a geom takes it."""
        sliding = self.pad_friction[0] if friction is None else friction
        return {
            "condim": 4,
            "friction": [sliding, *self.pad_friction[1:]],
            "solref": list(self.pad_stiffness),
            "solimp": [*self.pad_impedance, 0.5, 2],
        }
