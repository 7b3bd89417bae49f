"""S_t as arrays for agents that learn while they act: what Gymnasium's and PettingZoo's faces show of a table."""

from typing import Any

import numpy as np
from gymnasium import spaces

from halfseen.arrays import mapped
from halfseen.world.actions import TARGETED, VERB_NAMES, WAIT
from halfseen.world.config import WorldConfig
from halfseen.world.seeing import KnownSeeing, is_independent, label_evidence
from halfseen.world.state import Layout, TableState, attempt_counts, initial_state, occlusion

Observation = dict[str, Any]
"""Arrays by name; see `envs.CupsEnv`."""
_OF_TABLE = ("is_object", "is_on_table", "grip", "seen", "lifts", "hides")
_OF_TABLE += ("attempt_object", "attempt_occlusion", "attempt_succeeded")
_ROUNDED = 1e-5


def observed(config: WorldConfig, state: TableState, robot: int | None = None) -> Observation:
    """S_t of one table as arrays, as the robot that decides sees it, or another; padding, and who is idle, read 0."""
    successes, failures = attempt_counts(state)
    seen = {name: getattr(state, name) for name in _OF_TABLE}
    seen |= {
        "occlusion": occlusion(state),
        "log_odds": np.where(state.is_object, state.log_odds, np.float32(0.0)),
        "successes": successes.astype(np.int32),
        "failures": failures.astype(np.int32),
        "steps_to_go": np.asarray(state.steps_to_go)[None],
    }
    robots, space, decider = state.robots, state.workspace, state.decider
    if robots is not None and space is not None and decider is not None:
        at_work = {name: getattr(robots, name) for name in ("verb", "target", "since_s")}
        seen |= {name: np.where(robots.is_busy, each, 0).astype(each.dtype) for name, each in at_work.items()}
        seen |= {
            "decider": np.array([decider if robot is None else robot], dtype=np.int32),
            "is_busy": robots.is_busy,
            "is_parked": robots.is_parked,
            "is_out": np.zeros_like(robots.is_busy) if robots.is_out is None else robots.is_out,
            "decisions_to_go": robots.decisions_to_go,
            "is_in_reach": space.is_in_reach,
            "is_near": space.is_near,
            **({"attempt_robot": state.attempt_robot} if config.has_own_laws else {}),
        }
    return {name: each.astype(np.int8) if each.dtype == bool else each for name, each in seen.items()}


def space_of(config: WorldConfig, layouts: Layout) -> spaces.Space[Observation]:
    """Space of the observations of some tables: their shapes and types, and how far their numbers reach."""
    example = observed(config, initial_state(config, mapped(lambda leaf: leaf[0], layouts)))
    firmest, surest = float(np.nanmax(np.abs(layouts.grip), initial=1.0)), _largest_log_odds(config)
    last_object, last_robot = layouts.is_object.shape[-1] - 1, config.num_robots - 1
    usual: dict[Any, tuple[Any, Any]] = {np.float32: (0.0, 1.0), np.int32: (0, config.num_stages)}
    bounds: dict[str, tuple[Any, Any]] = {
        "grip": (-firmest, firmest),
        "log_odds": (-surest, surest),
        "attempt_object": (-1, last_object),
        "decider": (0, last_robot),
        "verb": (0, WAIT),
        "target": (0, last_object),
        "since_s": (0.0, _longest_s(config)),
        "decisions_to_go": (0, config.horizon),
        "attempt_robot": (0, last_robot),
    }

    def space(name: str, value: np.ndarray) -> spaces.Space[Any]:
        if value.dtype == np.int8:
            return spaces.MultiBinary(value.shape if value.ndim > 1 else len(value))
        low, high = bounds.get(name, usual[value.dtype.type])
        return spaces.Box(low, high, value.shape, dtype=value.dtype.type)

    return spaces.Dict({name: space(name, value) for name, value in example.items()})


def _longest_s(config: WorldConfig) -> float:
    """Bound on what a robot may be at: the longest attempt of one, or a wait for it [s]."""
    worlds = (config.as_robot(robot) for robot in range(config.num_robots))
    longest_s = (float(world.grasping.limit_s + world.transport_s) for world in worlds)
    bound_s = np.ceil(max(each / float(speed) for each, speed in zip(longest_s, config.speed, strict=True)))
    # Seconds are added up event by event, and rounded.
    return float(bound_s * (1.0 + _ROUNDED))


def _largest_log_odds(config: WorldConfig) -> float:
    """Bound on |log-odds|: the prior's, and as many labels as there are, each the surest that a label can be.

    There is none where it is not known how sure a label can be, or labels are not independent.
    """
    if not (isinstance(config.seeing, KnownSeeing) and is_independent(config.seeing)):
        return np.inf
    in_full_view = config.seeing.positive(0.0, 0.0)
    surest = max(abs(label_evidence(*in_full_view, says_dirty)) for says_dirty in (False, True))
    prior = np.abs(np.log(config.dirty_share) - np.log1p(-config.dirty_share))
    return float(np.ceil(prior + (config.num_stages + 1) * surest))


def object_lines(seen: Observation) -> list[str]:
    """A line an object: how dirty it seems, and where it is."""
    dirty = 1.0 / (1.0 + np.exp(-seen["log_odds"]))
    where = [
        f"hidden {hidden:.0%}" if is_there else "in the dishwasher"
        for hidden, is_there in zip(seen["occlusion"], seen["is_on_table"], strict=True)
    ]
    return [f"cup {i}: dirty {dirty[i]:.0%}, {where[i]}" for i in np.flatnonzero(seen["is_object"])]


def doing_of(seen: Observation, robot: int) -> str:
    """What a robot is at, in words."""
    if not seen["is_busy"][robot]:
        return "out" if seen["is_out"][robot] else "parked" if seen["is_parked"][robot] else "free"
    verb = int(seen["verb"][robot])
    what = f" {seen['target'][robot]}" if verb in TARGETED else ""
    return f"{VERB_NAMES[verb]}{what} for {seen['since_s'][robot]:.1f} s"
