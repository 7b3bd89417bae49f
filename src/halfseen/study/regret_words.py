"""What the regrets on small tables say, in a sentence or two and a title, computed from their table."""

import pandas as pd

from halfseen.study.findings import LEARNED, Estimate, learned_curve
from halfseen.study.policies import HEURISTICS
from halfseen.study.regret_table import OPTIMUM
from halfseen.study.results import BASELINE_NAMES
from halfseen.study.wording import amount, interval, share_in_words


def regret_title(table: pd.DataFrame, cut_share: float) -> str:
    """Say in one sentence what the figure of regrets shows."""
    size, end = _learned(table, cut_share)[-1]
    planner, heuristic = best(table, is_planner=True), best(table, is_planner=False)
    return (
        f"On small tables the policy learned from {size} paths, {_cut(cut_share)}, earns {amount(end.mean)} less "
        f"than the best of all policies, the best planner {amount(_regret(table, planner))}, the best heuristic "
        f"{amount(_regret(table, heuristic))}"
    )


def regret_sentence(table: pd.DataFrame, cut_share: float, num_tables: int, horizon: int) -> str:
    """Say how far what was learned, the best planner and the best heuristic stay below the best of all policies.

    Parameters
    ----------
    table
        Of `halfseen.study.regret_table.regret_table`.
    cut_share
        Of the learned policies that are told of; one of the table's.
    num_tables, horizon
        Of the small tables.
    """
    curve = _learned(table, cut_share)
    largest, end = curve[-1]
    share_lost = end.mean / _scale(table)
    smaller = f"; from {curve[0][0]} paths, {_less(curve[0][1])}" if len(curve) > 1 else ""
    planner, heuristic = best(table, is_planner=True), best(table, is_planner=False)
    return (
        f"On {num_tables} small tables, of three cups and {horizon} steps each, the best of all policies is known: it "
        f"earns {amount(float(table['optimum'].iloc[0]))} a path. Learned from {largest} logged paths, "
        f"{_cut(cut_share)}, a policy earns {_less(end)}, which is {amount(100 * share_lost, 1)} % of what the best of "
        f"all policies gains over finishing at once{smaller}. Of those that know the world, the best planner "
        f"({BASELINE_NAMES.get(planner, planner)}) earns {amount(_regret(table, planner))} less and the best heuristic "
        f"({BASELINE_NAMES.get(heuristic, heuristic)}) {amount(_regret(table, heuristic))} less."
    )


def best(table: pd.DataFrame, is_planner: bool) -> str:
    """Planner or heuristic with the least regret; the first of equals."""
    names = [str(name) for name in table["policy"] if name not in (LEARNED, OPTIMUM)]
    return min(
        (name for name in names if (name not in HEURISTICS) == is_planner), key=lambda name: _regret(table, name)
    )


def _learned(table: pd.DataFrame, cut_share: float) -> list[tuple[int, Estimate]]:
    """Size of log and regret, smallest log first."""
    curve = learned_curve(table, cut_share)
    return [(int(row["num_paths"]), Estimate(float(row["regret"]), float(row["se"]))) for _, row in curve.iterrows()]


def _regret(table: pd.DataFrame, name: str) -> float:
    return float(table.loc[table["policy"] == name, "regret"].iloc[0])


def _scale(table: pd.DataFrame) -> float:
    """What the optimum earns above FINISH at once."""
    regret, of_all = (table[name].to_numpy(dtype=float) for name in ("regret", "regret_share"))
    return float(regret.max() / of_all.max())


def _less(regret: Estimate) -> str:
    return f"{amount(regret.mean)} less (95 % interval {interval(regret.low, regret.high)})"


def _cut(cut_share: float) -> str:
    return "none of them cut" if cut_share == 0 else f"of which about {share_in_words(cut_share)} were cut"
