"""What policies of tables and of teams hold alike: the verbs that have a value, and the grasp model."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from halfseen.errors import ArgumentError, PolicyError
from halfseen.policies.folder.arrays import GRASP, PER_GRIP
from halfseen.policies.folder.json_values import horizon_of, typed
from halfseen.shapes import Bool
from halfseen.tables.grasp_table import GraspTable
from halfseen.world.policy import GraspModel


def seen_verbs(verbs: Sequence[str], is_seen: Bool[np.ndarray, "T V"] | None, horizon: int) -> list[list[str]]:
    """Verbs that have a value, by steps to go; where none has, as in a stage never reached, all may be taken."""
    every = list(verbs)
    if is_seen is None:
        return [every] * horizon
    rows = np.asarray(is_seen)
    return [[verb for verb, is_it in zip(verbs, row, strict=True) if is_it] or every for row in rows]


def is_seen_of(verbs: Sequence[str], record: Mapping[str, Any]) -> Any:
    """Which verbs have a value; None for all, as in a folder that does not say.

    Raises
    ------
    PolicyError
        The record does not list some of `verbs` for each number of steps to go.
    """
    if "seen" not in record["schema"]:
        return None
    seen = typed(record["schema"], "seen", list, "a list of verbs for each number of steps to go")
    is_right = len(seen) == horizon_of(record) and all(isinstance(row, list) and row for row in seen)
    if not is_right or not all(verb in verbs for row in seen for verb in row):
        raise PolicyError(f"seen is {seen}; it lists verbs for each number of steps to go: learn the policy anew")
    rows = np.array([[verb in row for verb in verbs] for row in seen])
    return None if rows.all() else rows


def grasp_arrays(grasp: GraspModel | None) -> dict[str, np.ndarray]:
    """Name the arrays of a grasp model; none for the rule of succession.

    Raises
    ------
    ArgumentError
        It is no table of numbers.
    """
    if grasp is None:
        return {}
    if not isinstance(grasp, GraspTable):
        raise ArgumentError(
            f"grasp is a {type(grasp).__name__}, whose code a folder cannot hold; learn with BetaGrasp() or SVMGrasp()"
        )
    return {GRASP: np.asarray(grasp.probabilities), PER_GRIP: np.asarray(grasp.per_grip, dtype=np.float32)}


def grasp_of(arrays: Mapping[str, Any]) -> GraspTable | None:
    """Put a grasp model together again; None for the rule of succession."""
    return GraspTable(arrays[GRASP], arrays.get(PER_GRIP, 1.0)) if GRASP in arrays else None
