"""From what a robot knows of its table to the state that a policy decides in, and to the rows of a log."""

from typing import Any

import jax.numpy as jnp
import numpy as np

from halfseen.cell.memory import Known, Memory
from halfseen.world.config import WorldConfig
from halfseen.world.state import NO_ATTEMPT, TableState
from halfseen.world.table_checks import DISHWASHER, TABLE

MOST_OBJECTS = 12
"""States are padded to so many objects, so that a policy is compiled once; tables with more are padded to more."""


def state_of(memory: Memory, config: WorldConfig, steps_to_go: int) -> TableState:
    """Give the state of the table as the robot knows it.

    Parameters
    ----------
    memory
        What it knows.
    config
        The world that it believes in: what labels and the look of an object tell.
    steps_to_go
        Actions left, the next one included.
    """
    size = max(MOST_OBJECTS, len(memory.objects))
    hides = np.zeros((size, size), dtype=np.float32)
    hides[: len(memory.objects), : len(memory.objects)] = memory.hides
    tried = [(k, trial.occlusion, trial.is_held) for k, known in enumerate(memory.objects) for trial in known.trials]
    empty = [(NO_ATTEMPT, 0.0, False)] * (config.horizon - len(tried))
    target, occluded, succeeded = zip(*tried[: config.horizon], *empty, strict=True)
    return TableState(
        hides=jnp.asarray(hides),
        is_object=_padded([True] * len(memory.objects), size, bool),
        is_on_table=_padded([not known.is_gone for known in memory.objects], size, bool),
        log_odds=_padded([log_odds(known, config) for known in memory.objects], size, np.float32),
        lifts=_padded([known.lifts for known in memory.objects], size, np.int32),
        attempt_object=jnp.asarray(np.array(target, dtype=np.int32)),
        attempt_occlusion=jnp.asarray(np.array(occluded, dtype=np.float32)),
        attempt_succeeded=jnp.asarray(np.array(succeeded, dtype=bool)),
        steps_to_go=jnp.asarray(np.int32(steps_to_go)),
    )


def log_odds(known: Known, config: WorldConfig) -> float:
    """Log-odds of DIRTY of an object given all labels, as a law of seeing has it."""
    total = float(np.log(config.dirty_share) - np.log1p(-config.dirty_share))
    for glance in known.glances:
        right = float(config.seeing.accuracy(glance.occlusion))
        total += (2 * glance.says_dirty - 1) * float(np.log(right) - np.log1p(-right))
    return total


def rows_of(memory: Memory, config: WorldConfig) -> list[dict[str, Any]]:
    """Rows of a log for the objects: what a policy saw, what each look and attempt told, and what may make it hard.

    Parameters
    ----------
    memory
        What the robot knows.
    config
        The world that it believes in.
    """
    return [_row(number, known, memory, config) for number, known in enumerate(memory.objects)]


def _row(number: int, known: Known, memory: Memory, config: WorldConfig) -> dict[str, Any]:
    held = [trial.is_held for trial in known.trials]
    hidden_by = memory.hides[number]
    return {
        "object": number,
        "location": DISHWASHER if known.is_gone else TABLE,
        "occlusion": float(1.0 - np.prod(1.0 - hidden_by)),
        "log_odds": log_odds(known, config),
        "successes": sum(held),
        "failures": len(held) - sum(held),
        "lifts": known.lifts,
        "hidden_by": hidden_by.tolist(),
        "attempt_occlusions": [trial.occlusion for trial in known.trials],
        "attempt_succeeded": held,
        "attempt_s": [trial.duration_s for trial in known.trials],
        "glance_occlusions": [glance.occlusion for glance in known.glances],
        "glance_held": [glance.is_held for glance in known.glances],
        "glance_dirty": [glance.says_dirty for glance in known.glances],
        "is_lying": known.facts.is_lying,
        "width_m": known.facts.width_m,
        "room_m": known.facts.room_m,
    }


def _padded(values: list[Any], size: int, kind: Any) -> Any:
    padded = np.zeros(size, dtype=kind)
    padded[: len(values)] = values
    return jnp.asarray(padded)
