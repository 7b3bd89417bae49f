"""Planning one step ahead by its definition, in plain Python: every outcome in turn, one cup after the other."""

from dataclasses import dataclass, replace
from itertools import product
from math import exp, expm1, log

import numpy as np

from halfseen.world import WorldConfig

CONFIG = WorldConfig()
NODES, WEIGHTS = np.polynomial.hermite_e.hermegauss(7)


@dataclass(frozen=True)
class Cup:
    """What is believed of one cup; its attempts are (occlusion, whether it was grasped)."""

    is_dirty: float
    attempts: tuple[tuple[float, bool], ...] = ()
    is_on_table: bool = True
    grip: float = 0.0
    seen: float = 0.0

    @property
    def log_odds(self):
        return log(self.is_dirty / (1 - self.is_dirty))


def failure(occluded, offset):
    return exp(-CONFIG.grasping.limit_s / exp(CONFIG.grasping.log_time + 2.2 * occluded - offset))


def over_grips(cup, value, nodes=NODES, weights=WEIGHTS):
    """Mean of value(grip offset) over what the attempts say of it."""
    mass = total = 0.0
    for node, weight in zip(nodes, weights, strict=True):
        for occluded, is_grasped in cup.attempts:
            weight *= 1 - failure(occluded, node) if is_grasped else failure(occluded, node)
        mass, total = mass + weight, total + weight * value(node)
    return total / mass


def chance(cup, occluded):
    return over_grips(cup, lambda offset: 1 - failure(occluded, offset))


def attempt_s(cup, occluded):
    def seconds(offset):
        scale = exp(CONFIG.grasping.log_time + 2.2 * occluded - offset)
        return -scale * expm1(-CONFIG.grasping.limit_s / scale)

    return 1.0 + over_grips(cup, seconds)


def occlusion(cups, hides, i):
    seen = 1.0
    for j, other in enumerate(cups):
        if other.is_on_table:
            seen *= 1 - hides[i][j]
    return 1 - seen


def leaf_value(cups, hides, steps_to_go):
    left, gains = 0.0, []
    for i, cup in enumerate(cups):
        if cup.is_on_table:
            grasped = chance(cup, occlusion(cups, hides, i))
            left += -5 * cup.is_dirty
            worth = grasped * (10 * cup.is_dirty - 10 * (1 - cup.is_dirty)) - (1 - grasped)
            gains += [worth] if worth > 0 else []
    return left + min(1, steps_to_go / max(len(gains), 1)) * sum(gains)


def labelled(cup, occluded, says_dirty):
    """Chance of this label, and the cup after it."""
    right = 0.5 + 0.3 * (1 - occluded) ** 1.5
    if_dirty, if_clean = (right, 1 - right) if says_dirty else (1 - right, right)
    chance_of_label = cup.is_dirty * if_dirty + (1 - cup.is_dirty) * if_clean
    return chance_of_label, replace(cup, is_dirty=cup.is_dirty * if_dirty / chance_of_label)


def after_labels(cups, seen_at):
    """Every way in which the cups on the table may be labelled: (chance, cups)."""
    there = [i for i, cup in enumerate(cups) if cup.is_on_table]
    for labels in product([False, True], repeat=len(there)):
        total, after = 1.0, list(cups)
        for i, says_dirty in zip(there, labels, strict=True):
            chance_of_label, after[i] = labelled(cups[i], seen_at[i], says_dirty)
            total *= chance_of_label
        yield total, after


def successors(cups, hides, verb, target):
    """Every outcome of an attempt: (chance, reward, cups after)."""
    occluded = occlusion(cups, hides, target)
    cup = cups[target]
    for is_grasped in (False, True):
        of_grasp = chance(cup, occluded) if is_grasped else 1 - chance(cup, occluded)
        is_washed = verb == "WASH" and is_grasped
        after = list(cups)
        after[target] = replace(cup, attempts=(*cup.attempts, (occluded, is_grasped)), is_on_table=not is_washed)
        seen_at = [occlusion(after, hides, i) for i in range(len(cups))]
        if verb == "LIFT" and is_grasped:
            gone = [replace(one, is_on_table=one.is_on_table and i != target) for i, one in enumerate(after)]
            seen_at = [0.0 if i == target else occlusion(gone, hides, i) for i in range(len(cups))]
        if verb == "LIFT":
            reward = -0.1 * attempt_s(cup, occluded)
        else:
            reward = 5 * cup.is_dirty - 10 * (1 - cup.is_dirty) if is_grasped else -1.0
        for of_labels, result in after_labels(after, seen_at):
            yield of_grasp * of_labels, reward, result


def q_values(cups, hides, steps_to_go, depth):
    """Q_depth of FINISH, then WASH and LIFT of every cup, by their definition."""
    q = [sum(-5 * cup.is_dirty for cup in cups if cup.is_on_table)]
    for verb in ("WASH", "LIFT"):
        for target, cup in enumerate(cups):
            outcomes = successors(cups, hides, verb, target) if cup.is_on_table else [(1.0, -np.inf, cups)]
            q.append(sum(p * (r + value(after, hides, steps_to_go - 1, depth - 1)) for p, r, after in outcomes))
    return q


def value(cups, hides, steps_to_go, depth):
    if depth == 0 or steps_to_go == 0 or not any(cup.is_on_table for cup in cups):
        return leaf_value(cups, hides, steps_to_go)
    return max(q_values(cups, hides, steps_to_go, depth))
