"""What planning time and planning horizon are worth, in a sentence and a title each, computed from their tables."""

from typing import Any

import numpy as np
import pandas as pd

from halfseen.study.findings import LEARNED
from halfseen.study.planning import HORIZON_PREFIX, SEARCH_PREFIX
from halfseen.study.planning_table import PLANNER_KIND
from halfseen.study.results import BASELINE_NAMES
from halfseen.study.wording import amount, interval, listed


def policy_name(policy: str) -> str:
    """Name for people of a policy of Figures 2 and 3."""
    for prefix, before, one, many in (
        (HORIZON_PREFIX, "POMDP, ", "step ahead", "steps ahead"),
        (SEARCH_PREFIX, "search, ", "simulation", "simulations"),
    ):
        if policy.startswith(prefix):
            number = int(policy.removeprefix(prefix))
            return f"{before}{number} {one if number == 1 else many}"
    return "learned policy" if policy == LEARNED else BASELINE_NAMES.get(policy, policy)


def figure2_title(figure2: pd.DataFrame) -> str:
    """Say in one sentence what Figure 2 shows."""
    planners, own = _planners(figure2), f"the learned policy takes {_ms(_learned(figure2))} ms"
    ahead = [row for row in planners if row["over_low"] > 0]
    if ahead:
        fastest, best = min(ahead, key=_decision_ms), max(planners, key=_mean_reward)
        also = "" if fastest is best else f", the strongest {_ms(best)} ms"
        return f"The fastest planner seen to earn more than was learned takes {_ms(fastest)} ms a decision{also}; {own}"
    slowest = f"With up to {_ms(max(planners, key=_decision_ms))} ms a decision"
    if any(row["over_high"] >= 0 for row in planners):
        return f"{slowest}, no planner is seen to earn more than the learned policy; {own}"
    return f"{slowest}, every planner earns less than the learned policy; {own}"


def figure3_title(figure3: pd.DataFrame) -> str:
    """Say in one sentence what Figure 3 shows."""
    hurts = _steps(figure3, -1)
    added = _from_first(figure3)
    if hurts:
        return f"A longer planning horizon costs reward {listed([_step(row) for row in hurts])}; {added}"
    return f"A longer planning horizon costs no reward beyond noise; {added}"


def planning_sentence(figure2: pd.DataFrame) -> str:
    """Say whether a planner earns more than the learned policy at any decision time.

    Parameters
    ----------
    figure2
        Of `halfseen.study.planning_table.figure2`.
    """
    planners, own = _planners(figure2), _learned(figure2)
    best = max(planners, key=_mean_reward)
    ahead = [row for row in planners if row["over_low"] > 0]
    note = f"The learned policy decides in {_ms(own)} ms; intervals are of 95 %, of paired differences, not adjusted."
    if ahead:
        fastest = min(ahead, key=_decision_ms)
        also = "" if fastest is best else f", the strongest ({_named(best)}) {_over(best)}"
        return (
            f"Planning with the true model is seen to earn more than the learned policy: the fastest planner that does "
            f"({_named(fastest)}) earns {_over(fastest)}{also}. {note}"
        )
    if any(row["over_high"] >= 0 for row in planners):
        verdict = "a difference within noise" if best["over_high"] >= 0 else "less than what was learned"
        return (
            f"At no decision budget is a planner, which knows the true model, seen to earn more than the learned "
            f"policy: the strongest ({_named(best)}) earns {_over(best)}, {verdict}. {note}"
        )
    return (
        f"At every decision budget planners, which know the true model, earn less than the learned policy: the "
        f"strongest ({_named(best)}) earns {_over(best)}. {note}"
    )


def horizon_sentence(figure3: pd.DataFrame) -> str:
    """Say whether looking further ahead costs reward anywhere.

    Parameters
    ----------
    figure3
        Of `halfseen.study.planning_table.figure3`.
    """
    hurts, helps = _steps(figure3, -1), _steps(figure3, 1)
    said = [
        f"{_step(row)} it {word} {_change(row)}" for word, rows in (("costs", hurts), ("adds", helps)) for row in rows
    ]
    simulations = int(figure3["simulations"].dropna().max())
    opening = "costs reward somewhere" if hurts else "costs no reward beyond noise"
    parts = f": {listed(said)}" if said else ", and no single step more adds any"
    return (
        f"Looking further ahead, with {simulations} simulations a decision, {opening}{parts}; {_from_first(figure3)} "
        f"(paired differences with 95 % intervals, not adjusted)."
    )


def _from_first(figure3: pd.DataFrame) -> str:
    rows = _records(figure3)
    first, last = rows[0]["planning_horizon"], rows[-1]["planning_horizon"]
    mean, low, high = (float(rows[-1][name]) for name in ("over_first", "over_first_low", "over_first_high"))
    looked = f"{last} steps in place of {first}"
    if low <= 0 <= high:
        return f"{looked} make no difference beyond noise ({interval(low, high)})"
    if mean > 0:
        return f"{looked} add {amount(mean)} ({interval(low, high)})"
    return f"{looked} cost {amount(-mean)} ({interval(-high, -low)})"


def _steps(figure3: pd.DataFrame, sign: int) -> list[dict[str, Any]]:
    """Horizons whose difference from the next shorter one has this sign beyond noise."""
    return [
        row for row in _records(figure3) if sign * row["over_previous_low"] > 0 and sign * row["over_previous_high"] > 0
    ]


def _step(row: dict[str, Any]) -> str:
    return f"at {row['planning_horizon']} steps"


def _change(row: dict[str, Any]) -> str:
    mean, low, high = (float(row[name]) for name in ("over_previous", "over_previous_low", "over_previous_high"))
    return f"{amount(abs(mean))} ({interval(low, high) if mean > 0 else interval(-high, -low)})"


def _over(row: dict[str, Any]) -> str:
    mean, low, high = (float(row[name]) for name in ("over_cql", "over_low", "over_high"))
    if mean >= 0:
        return f"{amount(mean)} more ({interval(low, high)})"
    return f"{amount(-mean)} less ({interval(-high, -low)})"


def _named(row: dict[str, Any]) -> str:
    return f"{policy_name(row['policy'])}, {_ms(row)} ms a decision"


def milliseconds(value: float) -> str:
    """Write a time with two digits: ``0.021``, ``4.2``, ``810``."""
    return np.format_float_positional(float(f"{value:.2g}"), trim="-")


def _ms(row: dict[str, Any]) -> str:
    return milliseconds(_decision_ms(row))


def _decision_ms(row: dict[str, Any]) -> float:
    return float(row["decision_ms"])


def _mean_reward(row: dict[str, Any]) -> float:
    return float(row["mean_reward"])


def _planners(figure2: pd.DataFrame) -> list[dict[str, Any]]:
    return [row for row in _records(figure2) if row["kind"] == PLANNER_KIND]


def _learned(figure2: pd.DataFrame) -> dict[str, Any]:
    return next(row for row in _records(figure2) if row["policy"] == LEARNED)


def _records(table: pd.DataFrame) -> list[dict[str, Any]]:
    return [{str(name): value for name, value in row.items()} for row in table.to_dict("records")]
