"""The belief over attributes and grips of a table, and its update.

Given the observations, objects are independent of one another, and an object's labels are independent of its grip. So
the belief factors exactly into the log-odds of DIRTY and a one-dimensional posterior of each grip offset, by
Gauss–Hermite quadrature. Sampled futures draw particles from it.
"""

from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from halfseen.arrays import Array, first_last, library_of, softmax
from halfseen.errors import ArgumentError
from halfseen.shapes import Float, Int
from halfseen.world.config import WorldConfig
from halfseen.world.grasping import GraspingByRobot, KnownGrasping
from halfseen.world.seeing import KnownSeeing
from halfseen.world.state import TableState

NUM_NODES = 7
_NODES, _WEIGHTS = np.polynomial.hermite_e.hermegauss(NUM_NODES)
_LOG_PRIOR = np.log(_WEIGHTS / _WEIGHTS.sum()).astype(np.float32)


class GripPosterior(NamedTuple):
    """Posterior of grip offsets, each its mean plus a hidden u."""

    mean: Float[Array, "*S"]
    log_weights: Float[Array, "*S G"]
    """Unnormalised log posterior weights of u on `offset_nodes`."""


_KNOWN: set[type] = set()
"""Cache of law types with known probabilities: the protocol check is as slow as a step."""


def known_grasping(config: WorldConfig) -> KnownGrasping:
    """Return the law of grasping, with its probabilities.

    Raises
    ------
    ArgumentError
        The law of the world, or of a robot, can only be sampled from.
    """
    law: Any = config.grasping
    for each in law.laws if isinstance(law, GraspingByRobot) else (law,):
        _check_known("grasping", each, KnownGrasping, "AssumedGrasping")
    return law


def known_seeing(config: WorldConfig) -> KnownSeeing:
    """Return the law of seeing, with its probabilities.

    Raises
    ------
    ArgumentError
        The world's law can only be sampled from.
    """
    law: Any = config.seeing
    _check_known("seeing", law, KnownSeeing, "AssumedSeeing")
    return law


def _check_known(name: str, law: object, protocol: Any, known: str) -> None:
    if type(law) not in _KNOWN and not isinstance(law, protocol):
        raise ArgumentError(
            f"{name} of the config is {type(law).__name__}, which can be sampled but has no known "
            f"probabilities, which planners need; plan with a config whose {name} models it, such as {known}"
        )
    _KNOWN.add(type(law))


def offset_nodes(config: WorldConfig) -> Float[Array, "*R G"]:
    """Quadrature nodes of u, the hidden part of a grip offset; per robot, if the law has an array of robots."""
    std = known_grasping(config).offset_std
    xp = library_of(std)
    return (xp.asarray(std)[..., None] * _NODES).astype(np.float32)


def latent_at(config: WorldConfig, node: Int[Array, "*B N"]) -> Any:
    """Latent variable of the law of grasping, with u of each object at one of `offset_nodes`, by index."""
    law = known_grasping(config)
    drawn = library_of(node).asarray(_NODES, dtype=np.float32)[node]
    if isinstance(law, GraspingByRobot):
        return tuple(replace(law, robot=k).offset_std * drawn for k in range(len(law.laws)))
    return law.offset_std * drawn


def offset_prior() -> tuple[Float[np.ndarray, " G"], Float[np.ndarray, " G"]]:
    """Quadrature nodes of u for a standard deviation of 1, with their prior probabilities."""
    return _NODES.copy(), _WEIGHTS / _WEIGHTS.sum()


def prior_grip(mean: Float[Array, "*S"]) -> GripPosterior:
    """Grip before any attempt: u ~ N(0, std²)."""
    xp = library_of(mean)
    return GripPosterior(mean, xp.broadcast_to(xp.asarray(_LOG_PRIOR), (*mean.shape, NUM_NODES)))


def grip_offsets(config: WorldConfig, mean: Float[Array, "*S"]) -> Float[Array, "*S G"]:
    """Grip offsets at each of `offset_nodes`."""
    nodes = offset_nodes(config)
    if nodes.ndim > 1:
        # Nodes of many robots have the robots' axes first.
        between = (1,) * max(mean.ndim + 1 - nodes.ndim, 0)
        return mean[..., None] + nodes.reshape(nodes.shape[:-1] + between + nodes.shape[-1:])
    # Nodes first, so that in memory their axis is not between those of objects and tables.
    return first_last(nodes.reshape(-1, *(1,) * mean.ndim) + mean)


def failure_log_probability(
    config: WorldConfig, occluded: Float[Array, "*#S"], mean: Float[Array, "*#S"]
) -> Float[Array, "*S G"]:
    """Log P(an attempt fails | occ, u) at each of `offset_nodes`."""
    return known_grasping(config).log_failure(occluded[..., None], grip_offsets(config, mean))


def grip_posterior(config: WorldConfig, state: TableState) -> GripPosterior:
    """Posterior grip of each object given its attempts, each under the law of the robot that made it."""
    xp, prior = library_of(state.attempt_object), prior_grip(state.grip)
    if xp is np and (state.attempt_object < 0).all():
        return prior
    tried = xp.take_along_axis(state.grip, xp.maximum(state.attempt_object, 0), axis=-1)
    world = config if state.attempt_robot is None else config.as_robot(state.attempt_robot)
    failed = failure_log_probability(world, state.attempt_occlusion, tried)
    # The floor guards log(0) where success is impossible; no such attempt succeeded.
    held = xp.log(xp.maximum(-xp.expm1(failed), np.finfo(np.float32).tiny))
    evidence = xp.where(state.attempt_succeeded[..., None], held, failed)
    is_mine = state.attempt_object[..., None, :] == xp.arange(state.num_objects)[:, None]
    return prior._replace(log_weights=prior.log_weights + is_mine.astype(evidence.dtype) @ evidence)


def grasp_probability(config: WorldConfig, occluded: Float[Array, "*S"], grip: GripPosterior) -> Float[Array, "*S"]:
    """P(an attempt succeeds), with the grip offset integrated out."""
    failed = failure_log_probability(config, occluded, grip.mean)
    xp = library_of(failed)
    return 1.0 - xp.sum(softmax(grip.log_weights) * xp.exp(failed), axis=-1)


def expected_attempt_s(config: WorldConfig, occluded: Float[Array, "*S"], grip: GripPosterior) -> Float[Array, "*S"]:
    """Expected duration of an attempt with its transport [s], with the grip offset integrated out."""
    attempt_s = known_grasping(config).expected_s(occluded[..., None], grip_offsets(config, grip.mean))
    xp = library_of(attempt_s)
    return config.transport_s + xp.sum(softmax(grip.log_weights) * attempt_s, axis=-1)
