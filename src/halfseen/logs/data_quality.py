"""Warnings about logs that violate no rule but are probably not as intended.

Each check is a small function from `Logs` to sentences; most logs yield none. A warning is a question to the people
who recorded the logs, never a reason to refuse them.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np

from halfseen.arrays import Rows
from halfseen.logs.columns import shown
from halfseen.logs.copied_columns import (
    actions_as_covariates,
    constant_covariates,
    is_copy_of,
    rewards_as_covariates,
    stuck_sensors,
)
from halfseen.logs.grouping import can_be_counted, coded, grouped_covariates, is_number, rows_with
from halfseen.logs.logs import Logs
from halfseen.logs.mixed_units import clocks_of_robots, long_clocks, mixed_clocks, mixed_covariates, short_clocks
from halfseen.logs.odd_texts import dates_among_names, listed, missing_as_text, numbers_as_text, spelling
from halfseen.logs.plausibility import (
    MOST_EXPLAINED,
    copied_trajectories,
    cuts_called_finished,
    leaks,
    outcomes_among_covariates,
    untrue_probabilities,
)
from halfseen.logs.stand_ins import mixed_truths, stand_ins
from halfseen.suggestions import as_counted

FEWEST_ROWS, FEWEST_CUTS, FEWEST_TRAJECTORIES = 10, 5, 30
FEWEST_IN_STATE, FEWEST_STAGES, RARE_SHARE = 50, 200, 0.01
SAME_END, NEARLY_ALL, MOST_COUNTED = 0.01, 0.99, 20
NAMES_OF_ENDS = {
    *("finished", "finish", "done", "success", "succeeded", "complete", "completed"),
    *("goal", "goal-reached", "cleared", "terminated", "terminal", "ok"),
}
"""Causes that name the task's own end."""


@dataclass(frozen=True)
class DataWarning:
    """A finding in a log that looks wrong."""

    kind: str
    """Name of the check, for programs."""
    sentence: str
    """The finding and where to look, for people."""


def data_warnings(logs: Logs) -> tuple[DataWarning, ...]:
    """Run all checks on valid logs; empty if nothing was found."""
    return tuple(DataWarning(kind, sentence) for kind, check in _CHECKS.items() for sentence in check(logs))


def _all_cut(logs: Logs) -> Iterator[str]:
    if not logs.is_finished.any():
        number = logs.num_trajectories
        which = "the only trajectory was" if number == 1 else f"all {number} trajectories were"
        yield f"{which} cut: none was observed to its own end, and no weighting corrects for that"


def _ends_among_causes(logs: Logs) -> Iterator[str]:
    """Find causes of cuts that are the task's own end, whatever it is called."""
    for cause, num_trajectories in logs.trajectories["cause"].dropna().value_counts().sort_index().items():
        if str(cause).casefold().strip() in NAMES_OF_ENDS:
            yield (
                f"{num_trajectories} {'trajectory is' if num_trajectories == 1 else 'trajectories are'} cut by "
                f"{str(cause)!r}: if that is how the task ends, the ending is 'finished', without a cause"
            )


def _horizons(logs: Logs) -> Iterator[str]:
    """Find cuts at one time. A time limit of the task is its own end; no importance weight reaches beyond such cuts."""
    for cause, ends in logs.trajectories[~logs.is_finished].groupby("cause")["end_s"]:
        middle_s = float(ends.median())
        num_same = int(((ends - middle_s).abs() <= SAME_END * middle_s).sum())
        if num_same >= max(FEWEST_CUTS, 0.9 * len(ends)):
            yield (
                f"{num_same} of {len(ends)} cuts by {cause} fall at {middle_s:.4g} s: if that limit belongs to the "
                "task, it is a horizon, and those trajectories finished"
            )


def _one_stage(logs: Logs) -> Iterator[str]:
    last = logs.stages.groupby("trajectory")["stage"].max().reindex(logs.trajectory_ids).to_numpy()[~logs.is_finished]
    if len(last) >= 2 * FEWEST_CUTS and logs.horizon > 1 and (last == last[0]).all():
        yield f"all {len(last)} cuts fall in stage {last[0]}: does the task itself end trajectories there?"


def _running_clocks(logs: Logs) -> Iterator[str]:
    """Find one clock for all trajectories: each has its first stage after the ends of all earlier ones."""
    stages: Any = logs.stages
    clocks = stages.groupby("trajectory")["elapsed_s"].agg(["min", "max", "count"])
    clocks = clocks[clocks["count"] > 1].sort_values("max")
    first_s, before_s = clocks["min"].to_numpy()[1:], clocks["max"].to_numpy()[:-1]
    if len(clocks) >= FEWEST_CUTS and (first_s > before_s).all():
        one, other = map(shown, clocks.index[:2])
        yield (
            f"elapsed_s continues across trajectories: the first stage of {other} ends at {first_s[0]:.4g} s, after "
            f"the last of {one} at {before_s[0]:.4g} s; count seconds since each trajectory began"
        )


def text_order(trajectory_ids: Iterable[Any]) -> Iterator[str]:
    """Find names of trajectories that contain numbers but are sorted as text."""
    names = [name for name in trajectory_ids if isinstance(name, str)]
    for one, other in pairwise(names):
        if as_counted(one) > as_counted(other):
            yield (
                f"trajectories are sorted by name as text, where {one!r} comes before {other!r}, and that order "
                "decides which came later: write their numbers with equally many digits"
            )
            return


def _identifiers(logs: Logs) -> Iterator[str]:
    """Find serial numbers and clocks among covariates: a policy that uses them meets only values outside its log."""
    if logs.num_trajectories < FEWEST_TRAJECTORIES:
        return
    stages: Any = logs.stages
    is_first, began_s = stages["stage"].to_numpy() == 1, logs.begun_s()
    row = np.cumsum(is_first) - 1
    for name in logs.stage_covariates:
        if not is_number(stages[name]) or stages[name].isna().any():
            continue
        values = stages[name].to_numpy(dtype=np.float64)
        first = values[is_first]
        numbered = next((what for what, of in {"trajectories": first, "rows": values}.items() if _is_count(of)), None)
        if numbered is not None:
            yield f"covariate {name} numbers the {numbered}, which predicts nothing about the next one: leave it out"
        elif _is_clock(values - first[row], began_s):
            yield f"covariate {name} increases with the clock, so later trajectories have unseen values: leave it out"


def _is_count(values: Rows) -> bool:
    is_dense = (values % 1 == 0).all() and np.ptp(values) < 3.0 * len(values)
    return bool(is_dense and len(np.unique(values)) >= NEARLY_ALL * len(values))


def _is_clock(since_first: Rows, began_s: Rows) -> bool:
    later = began_s > 0.0
    since, seconds = since_first[later], began_s[later]
    if later.sum() < FEWEST_TRAJECTORIES or not np.ptp(since) > 0.0 or not np.ptp(seconds) > 0.0:
        return False
    return bool(np.corrcoef(since, seconds)[0, 1] > NEARLY_ALL)


def _one_action(logs: Logs) -> Iterator[str]:
    actions = logs.stages["action"].dropna()
    if len(actions) >= FEWEST_ROWS and actions.nunique() == 1:
        yield f"only one action, {actions.iloc[0]}, was ever taken: there is nothing to choose, and nothing to learn"


def _no_alternative(logs: Logs) -> Iterator[str]:
    """Find states in which only one action was ever tried, though others were tried elsewhere."""
    stages = rows_with(logs.stages, "action")
    action, names = coded(stages["action"])
    if len(names) < 2 or logs.has_objects:
        return
    for each in grouped_covariates(logs, stages):
        if is_copy_of(stages[each.name], stages["action"]):
            continue
        size = num_groups, num_actions = each.num_groups, len(names)
        taken = np.bincount(each.group * num_actions + action, minlength=num_groups * num_actions).reshape(size)
        alone = (np.count_nonzero(taken, axis=1) == 1) & (taken.max(axis=1) >= FEWEST_IN_STATE)
        for group in np.flatnonzero(alone):
            yield (
                f"where {each.name} is {each.words[group]}, all {taken[group].max()} stages took "
                f"{names[taken[group].argmax()]}: no other action is known there; try others occasionally"
            )


def _rare_actions(logs: Logs) -> Iterator[str]:
    counts = logs.stages.loc[logs.stages["elapsed_s"].notna(), "action"].value_counts()
    number = {name: int(counts.get(name, 0)) for name in sorted(logs.stages["action"].dropna().unique(), key=str)}
    never = [str(name) for name in number if number[name] == 0]
    if never:
        yield f"{_were('action', never)} begun and never completed: nothing can be learned from that"
    total = int(counts.sum())
    rare = [f"{name} ({number[name]})" for name in number if 0 < number[name] < RARE_SHARE * total]
    if rare and total >= FEWEST_STAGES:
        yield f"{_were('action', rare)} taken in less than 1 % of {total} stages: too few to learn from"


def _never_completed(logs: Logs) -> Iterator[str]:
    """Find categories, and one of two numbers, that only stages show in which a trajectory was cut."""
    is_done = logs.stages["elapsed_s"].notna()
    for name in logs.stage_covariates:
        values: Any = logs.stages[name].dropna()
        if not can_be_counted(values):
            continue
        kinds = values.unique()
        most = 2 if is_number(values) else MOST_COUNTED
        if len(kinds) <= most and (lost := {*kinds} - {*values[is_done].unique()}):
            yield (
                f"where {name} is {listed(sorted(map(str, lost)))}, every stage was cut: what follows is unknown, and "
                "what a policy does there is a guess"
            )


def _no_probability(logs: Logs) -> Iterator[str]:
    """Warn only if there were several actions to choose from."""
    actions = logs.stages["action"].dropna()
    if "probability" not in logs.stages.columns and len(actions) >= FEWEST_ROWS and actions.nunique() > 1:
        yield (
            "no action has a probability: learning does not need it, but evaluation does, or estimates it with "
            "--propensity estimated"
        )


def _no_exploration(logs: Logs) -> Iterator[str]:
    if "probability" not in logs.stages.columns or logs.stages["action"].nunique() < 2:
        return
    probability = logs.stages.loc[logs.stages["elapsed_s"].notna(), "probability"]
    if len(probability) >= FEWEST_ROWS and (probability == 1).all():
        yield "all probabilities are 1: the policy never explored, so nothing can be learned of other actions"


def _equal_rewards(logs: Logs) -> Iterator[str]:
    rewards = logs.stages["reward"].dropna()
    if len(rewards) >= FEWEST_ROWS and rewards.nunique() == 1:
        yield f"all {len(rewards)} rewards are {rewards.iloc[0]:g}: no action is better than another"


def _later_rewards(logs: Logs) -> Iterator[str]:
    """Find rewards that seem to come a stage late: 0 in all first stages, and nowhere else, not even in the middle."""
    completed: Any = rows_with(logs.stages, "elapsed_s")
    is_first, is_zero = completed["stage"] == 1, completed["reward"] == 0
    is_middle = ~is_first & (completed["trajectory"] == completed["trajectory"].shift(-1))
    if min(is_first.sum(), is_middle.sum()) >= FEWEST_ROWS and (is_first == is_zero).all():
        yield (
            f"the reward is 0 in all {is_first.sum()} first stages, and in no other: if each came with the observation "
            "after its action, all are one stage late"
        )


def _were(what: str, names: list[str]) -> str:
    return f"{what} {listed(names)} was" if len(names) == 1 else f"{what}s {listed(names)} were"


_CHECKS: dict[str, Callable[[Logs], Iterable[Any]]] = {
    "all-cut": _all_cut,
    "untrue-probability": untrue_probabilities,
    "leak": leaks,
    "outcome-as-covariate": partial(outcomes_among_covariates, untested=MOST_EXPLAINED),
    "cut-called-finished": cuts_called_finished,
    "text-order": lambda logs: text_order(logs.trajectory_ids),
    "identifier": _identifiers,
    "number-as-text": numbers_as_text,
    "missing-as-text": missing_as_text,
    "stand-in": stand_ins,
    "truths-mixed": mixed_truths,
    "one-action": _one_action,
    "no-alternative": _no_alternative,
    "end-among-causes": _ends_among_causes,
    "horizon-as-cut": _horizons,
    "cuts-in-one-stage": _one_stage,
    "mixed-clock-units": mixed_clocks,
    "clock-of-robot": clocks_of_robots,
    "long-clock": long_clocks,
    "short-clock": short_clocks,
    "running-clock": _running_clocks,
    "mixed-covariate-units": mixed_covariates,
    "action-as-covariate": actions_as_covariates,
    "reward-as-covariate": rewards_as_covariates,
    "spelling": spelling,
    "date-among-names": dates_among_names,
    "rare-action": _rare_actions,
    "never-completed": _never_completed,
    "no-probability": _no_probability,
    "no-exploration": _no_exploration,
    "equal-rewards": _equal_rewards,
    "later-rewards": _later_rewards,
    "constant-covariate": constant_covariates,
    "stuck-sensor": stuck_sensors,
    "duplicated-trajectories": copied_trajectories,
}
