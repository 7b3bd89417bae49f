"""The world of design §3 once more, in plain Python: slow, scalar, and written from the text alone."""

import math


def hidden_share(hides, is_present, i):
    """occ_i = 1 − Π_j (1 − hides[i, j]·present_j)."""
    visible = 1.0
    for j, present in enumerate(is_present):
        if present:
            visible *= 1.0 - hides[i][j]
    return 1.0 - visible


def mean_grasp_s(occlusion, offset):
    return math.exp(0.6 + 2.2 * occlusion - offset)


def accuracy(occlusion):
    return 0.5 + 0.3 * (1.0 - occlusion) ** 1.5


def naive_step(table, verb, target, exponential, label_uniforms):
    """One action; `table` is a dict of lists (hides, on_table, log_odds, dirty, offset) and steps_to_go.

    `exponential` is the draw of E, `label_uniforms` that of each label. Returns reward, duration [s], whether the
    trajectory is over, and the table after it.
    """
    after = {key: list(value) if isinstance(value, list) else value for key, value in table.items()}
    after["steps_to_go"] -= 1
    reward, attempt_s, held = 0.0, 0.0, None
    if verb != "FINISH":
        occlusion = hidden_share(table["hides"], table["on_table"], target)
        grasp_s = mean_grasp_s(occlusion, table["offset"][target]) * exponential
        succeeded = grasp_s <= 6.0
        attempt_s = grasp_s if succeeded else 6.0
        after["attempts"] = [*table["attempts"], (target, occlusion, succeeded)]
        if verb == "WASH" and succeeded:
            reward = 5.0 if table["dirty"][target] else -10.0
            after["on_table"][target] = False
        elif verb == "WASH":
            reward = -1.0
        else:
            reward = -0.1 * (attempt_s + 1.0)
            if succeeded:
                held = target
                after["lifts"][target] += 1
    duration_s = attempt_s + 1.0

    hiding = [on and j != held for j, on in enumerate(after["on_table"])]
    for i, on in enumerate(after["on_table"]):
        if not on:
            continue
        right = accuracy(0.0 if i == held else hidden_share(table["hides"], hiding, i))
        says_dirty = table["dirty"][i] == (label_uniforms[i] < right)
        after["log_odds"][i] += math.log(right / (1.0 - right)) * (1 if says_dirty else -1)

    is_over = verb == "FINISH" or after["steps_to_go"] == 0 or not any(after["on_table"])
    if is_over:
        reward -= 5.0 * sum(on and dirty for on, dirty in zip(after["on_table"], table["dirty"], strict=True))
    return reward, duration_s, is_over, after
