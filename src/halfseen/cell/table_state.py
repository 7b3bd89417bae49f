"""From what a robot knows of its table to the state that a policy decides in, and to the rows of a log."""

from collections.abc import Callable
from dataclasses import asdict
from typing import Any, NamedTuple

import numpy as np

from halfseen.cell.facts import Facts
from halfseen.cell.memory import Known, Memory
from halfseen.planners.belief import known_seeing
from halfseen.world.config import WorldConfig
from halfseen.world.log_checks import DISHWASHER, LOST, PLACE_COLUMNS, TABLE
from halfseen.world.seeing import label_evidence
from halfseen.world.state import NO_ATTEMPT, TableState

MOST_OBJECTS = 12
"""States are padded to so many objects, among which whoever explores draws; tables with more are padded to more."""


class Belief(NamedTuple):
    """What the robot believes of the world: it makes chances of what it was told."""

    config: WorldConfig
    """Prior, law of seeing, horizon."""
    grip: Callable[[Facts], float]
    """How well an object can be gripped, from what is seen of it."""


def no_grip(facts: Facts) -> float:
    """Give 0: nothing is known of what makes objects hard to grip."""
    return 0.0


def state_of(memory: Memory, belief: Belief, steps_to_go: int) -> TableState:
    """Give the state of the table as the robot knows it.

    Parameters
    ----------
    memory
        What it knows.
    belief
        What it believes of the world.
    steps_to_go
        Actions left, the next one included.
    """
    objects, horizon = memory.objects, belief.config.horizon
    size = max(MOST_OBJECTS, len(objects))
    hides = np.zeros((size, size), dtype=np.float32)
    hides[: len(objects), : len(objects)] = memory.hides
    tried = [(k, trial.occlusion, trial.is_held) for k, known in enumerate(objects) for trial in known.trials]
    empty = [(NO_ATTEMPT, 0.0, False)] * (horizon - len(tried))
    target, occluded, succeeded = zip(*tried[:horizon], *empty, strict=True)
    told = [_told(known, belief.config) for known in objects]

    def padded(values: list[Any], kind: Any) -> np.ndarray:
        return np.array([*values, *[0] * (size - len(values))], dtype=kind)

    leaves = {
        "hides": hides,
        "is_object": padded([True] * len(objects), bool),
        "grip": padded([belief.grip(known.facts) for known in objects], np.float32),
        "is_on_table": padded([not known.is_gone for known in objects], bool),
        "log_odds": padded([log_odds for log_odds, _ in told], np.float32),
        "seen": padded([seen for _, seen in told], np.float32),
        "lifts": padded([known.lifts for known in objects], np.int32),
        "attempt_object": np.array(target, dtype=np.int32),
        "attempt_occlusion": np.array(occluded, dtype=np.float32),
        "attempt_succeeded": np.array(succeeded, dtype=bool),
        "steps_to_go": np.int32(steps_to_go),
    }
    return TableState(**leaves)


def _told(known: Known, config: WorldConfig) -> tuple[float, float]:
    """Log-odds of DIRTY given all labels, and how much of the object counts as seen."""
    law, seen = known_seeing(config), 0.0
    log_odds = float(np.log(config.dirty_share) - np.log1p(-config.dirty_share))
    for glance in known.glances:
        chances = law.positive(np.float64(glance.occlusion), seen, glance.is_held)
        if not any(chances):
            continue  # what shows nothing new tells nothing, whatever it says
        log_odds += float(label_evidence(*chances, glance.says_dirty))
        seen = float(law.after(np.float64(glance.occlusion), seen, glance.says_dirty, glance.is_held))
    return log_odds, seen


def rows_of(memory: Memory, belief: Belief) -> list[dict[str, Any]]:
    """Rows of a log for the objects: what a policy saw, what looks and attempts told, and what may make it hard.

    Parameters
    ----------
    memory
        What the robot knows.
    belief
        What it believes of the world.
    """
    places = [dict(zip(PLACE_COLUMNS, place, strict=True)) for place in memory.places_m().tolist()]
    return [{**_row(number, known, memory, belief), **places[number]} for number, known in enumerate(memory.objects)]


def _row(number: int, known: Known, memory: Memory, belief: Belief) -> dict[str, Any]:
    held, hidden_by = [trial.is_held for trial in known.trials], memory.hides[number]
    log_odds, seen = _told(known, belief.config)
    return {
        "object": number,
        "location": DISHWASHER if known.is_racked else LOST if known.is_lost else TABLE,
        "occlusion": memory.occlusion(number),
        "grip": belief.grip(known.facts),
        "log_odds": log_odds,
        "seen": seen,
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
        **asdict(known.facts),
    }
