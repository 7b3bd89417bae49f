"""What tells a team the probability of a grasp, in its folder: as for one robot, and more where robots differ."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from halfseen.errors import PolicyError
from halfseen.policies.folder.arrays import GRASP, PER_GRIP, Arrays
from halfseen.policies.folder.table_parts import grasp_arrays, grasp_of
from halfseen.tables.grasp_table import GraspByRobot, GraspTable
from halfseen.world.policy import GraspModel

_OWN = "own."
"""What stands before the names of the arrays of all robots, axis K first."""


def team_grasp_arrays(grasp: GraspModel | None) -> dict[str, np.ndarray]:
    """Name the arrays of a grasp model.

    Raises
    ------
    ArgumentError
        It is no table of numbers.
    """
    if not isinstance(grasp, GraspByRobot):
        return grasp_arrays(grasp)
    own = {f"{_OWN}{name}": array for name, array in grasp_arrays(grasp.own).items()}
    return grasp_arrays(grasp.shared) | own


def split_grasp(arrays: Arrays, num_robots: int) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Tell the arrays of the team apart from those of each robot's own grasps, and check these.

    Raises
    ------
    PolicyError
        They are not as many as robots, of another size than those of the team, or hold no probabilities.
    """
    own = {name.removeprefix(_OWN): array for name, array in arrays.items() if name.startswith(_OWN)}
    rest = {name: array for name, array in arrays.items() if not name.startswith(_OWN)}
    if not own:
        return rest, own
    for name in own.keys() | {GRASP, PER_GRIP}:
        if name not in own or name not in rest:
            raise PolicyError(f"array {_OWN + name!r} or {name!r} is missing; learn the policy anew")
        array, wanted = own[name], (num_robots, *rest[name].shape)
        if name not in (GRASP, PER_GRIP) or array.dtype != np.float32 or array.shape != wanted:
            raise PolicyError(
                f"array {_OWN + name!r} is {array.dtype} of shape {list(array.shape)}, and the policy asks for float32 "
                f"of shape {list(wanted)}; learn the policy anew"
            )
        is_right = np.isfinite(array) & ((name != GRASP) | ((array >= 0.0) & (array <= 1.0)))
        if not is_right.all():
            raise PolicyError(f"array {_OWN + name!r} holds {array[~is_right][0]}; learn the policy anew")
    return rest, own


def team_grasp_of(arrays: Mapping[str, Any], own: Mapping[str, np.ndarray]) -> GraspTable | GraspByRobot | None:
    """Put a grasp model together again; None for the rule of succession."""
    shared = grasp_of(arrays)
    if shared is None or not own:
        return shared
    return GraspByRobot(shared, GraspTable(own[GRASP], own[PER_GRIP]))
