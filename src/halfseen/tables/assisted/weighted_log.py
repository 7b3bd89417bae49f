"""A log of tables with the weights of its stages, on which laws are tested; and the tables that it began with."""

from typing import NamedTuple

import numpy as np

from halfseen.errors import PositivityError
from halfseen.learning.rows import TrajectoryArrays, trajectory_arrays
from halfseen.learning.targets import Weighted
from halfseen.learning.task import Encoded
from halfseen.logs import Logs
from halfseen.shapes import Bool, Float, Int
from halfseen.tables.encoding import logged_actions
from halfseen.world.actions import ActionSpace
from halfseen.world.state import Layout, TableState


class WeightedLog(NamedTuple):
    """A log of tables, as far as it was seen."""

    states: TableState
    """Axes (n, T)."""
    action: Int[np.ndarray, "n T"]
    reward: Float[np.ndarray, "n T"]
    weight: Float[np.ndarray, "n T"]
    """δ / Ĝ(U⁻) by Kaplan and Meier's Ĝ."""
    is_last: Bool[np.ndarray, "n T"]
    """Completed stages after which the trajectory had come to its own end."""


def weighted_log(logs: Logs, states: TableState, *, is_team: bool = False) -> WeightedLog | str:
    """Weigh the stages of a log; or say why that cannot be.

    Parameters
    ----------
    logs
        The log.
    states
        Its tables, axes (n, T).
    is_team
        Whether several robots decided.
    """
    action = logged_actions(logs, states.horizon, states.num_objects, is_team=is_team)
    is_possible = np.ones((*action.shape, ActionSpace(states.num_objects).num_actions + is_team), dtype=bool)
    return weighed(trajectory_arrays(logs, Encoded(np.zeros((*action.shape, 1, 0)), is_possible, action), None), states)


def weighed(trajectories: TrajectoryArrays, states: TableState) -> WeightedLog | str:
    """Weigh the stages of a log that is laid out; or say why that cannot be."""
    targets = Weighted()
    try:
        weight = targets.weights(trajectories, targets.fit_cuts(trajectories.clocks))
    except PositivityError as error:
        return f"the laws are not tested on the log: {error}"
    return WeightedLog(states, trajectories.action, trajectories.reward, weight, trajectories.is_last)


def layouts_of(states: TableState) -> Layout:
    """Tables that trajectories began with, of states with axes (n, T)."""
    workspace = states.workspace
    if workspace is not None:
        workspace = type(workspace)(workspace.is_in_reach[:, 0], workspace.is_near[:, 0])
    return Layout(states.hides[:, 0], states.is_object[:, 0], states.grip[:, 0], workspace)
