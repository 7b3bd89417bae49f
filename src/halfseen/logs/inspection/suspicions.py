"""What looks wrong in logs that break no rule: legal, and probably not meant.

Each check is a small function from `Logs` to sentences; most logs give none. A finding is a question to whoever
recorded the logs, never a reason to refuse them.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import pandas as pd
from pandas.util import hash_pandas_object

from halfseen.logs.inspection.choices import no_alternative, one_action
from halfseen.logs.inspection.endings import cuts_called_finished
from halfseen.logs.inspection.foretelling import outcomes_among_covariates
from halfseen.logs.inspection.identifiers import identifiers, numbers_as_text
from halfseen.logs.inspection.probabilities import leaks, untrue_probabilities
from halfseen.logs.inspection.units import covariates, long_clocks, mixed_clocks, mixed_covariates
from halfseen.logs.logs import Logs
from halfseen.logs.refusal import shown

FEWEST_CUTS = 5
SAME_END = 0.01
FEWEST_STAGES, RARE_SHARE = 200, 0.01
FEWEST_ROWS = 10
NUM_NAMED = 3
NAMES_OF_ENDS = {
    *("finished", "finish", "done", "success", "succeeded", "complete", "completed"),
    *("goal", "goal-reached", "cleared", "terminated", "terminal", "ok"),
}
"""Of what a task does by itself."""


@dataclass(frozen=True)
class Suspicion:
    """Something that looks wrong.

    Parameters
    ----------
    kind
        Which check found it, for programs.
    sentence
        What was found, and what to look at, for people.
    """

    kind: str
    sentence: str


def suspicions(logs: Logs) -> tuple[Suspicion, ...]:
    """Look for what is legal in logs and probably not meant; empty where nothing was found."""
    return tuple(Suspicion(kind, sentence) for kind, check in _CHECKS.items() for sentence in check(logs))


def _all_cut(logs: Logs) -> Iterator[str]:
    if not logs.is_finished.any():
        which = (
            "the only trajectory was"
            if logs.num_trajectories == 1
            else f"all {logs.num_trajectories} trajectories were"
        )
        yield f"{which} cut: nobody saw one come to its own end, which no weight makes up for"


def _ends_among_causes(logs: Logs) -> Iterator[str]:
    """What the task itself does is its end, whatever it is called."""
    for cause, num_trajectories in logs.trajectories["cause"].dropna().value_counts().sort_index().items():
        if str(cause).casefold().strip() in NAMES_OF_ENDS:
            yield (
                f"{num_trajectories} {'trajectory is' if num_trajectories == 1 else 'trajectories are'} cut by "
                f"{str(cause)!r}: if that is how the task ends, the ending is 'finished', without a cause"
            )


def _horizons(logs: Logs) -> Iterator[str]:
    """A time limit of the task is its own end, not a cut: cuts at one time leave nothing to weigh what is later by."""
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
        yield f"all {len(last)} cuts fall in stage {last[0]}: does something of the task itself end trajectories there?"


def _spelling(logs: Logs) -> Iterator[str]:
    for what, values in (("causes", logs.trajectories["cause"]), ("actions", logs.stages["action"])):
        names = [str(name) for name in sorted(values.dropna().unique(), key=str)]
        folded: dict[str, list[str]] = {}
        for name in names:
            folded.setdefault("".join(char for char in name.casefold() if char.isalnum()) or name, []).append(name)
        for same in folded.values():
            if len(same) > 1:
                yield f"{what} {_listed(map(repr, same))} differ only in their spelling: count them as one"


def _rare_actions(logs: Logs) -> Iterator[str]:
    is_completed = logs.stages["elapsed_s"].notna()
    begun = logs.stages["action"].dropna()
    counts = logs.stages.loc[is_completed, "action"].value_counts()
    names = sorted(begun.unique(), key=str)
    never = [str(name) for name in names if counts.get(name, 0) == 0]
    if never:
        yield f"{_named('action', never)} {_was(never)} begun and never completed: nothing can be learned from that"
    total = int(counts.sum())
    rare = [f"{name} ({counts[name]})" for name in names if 0 < counts.get(name, 0) < RARE_SHARE * total]
    if rare and total >= FEWEST_STAGES:
        yield f"{_named('action', rare)} {_was(rare)} taken in less than 1 % of {total} stages: too few to learn from"


def _no_probability(logs: Logs) -> Iterator[str]:
    """Only where there was something to choose from."""
    actions = logs.stages["action"].dropna()
    if "probability" not in logs.stages.columns and len(actions) >= FEWEST_ROWS and actions.nunique() > 1:
        yield (
            "no action has a probability: learning needs none, but evaluating asks for it, or estimates it if told to "
            "(--propensity estimated)"
        )


def _no_exploration(logs: Logs) -> Iterator[str]:
    is_completed = logs.stages["elapsed_s"].notna()
    if "probability" not in logs.stages.columns or logs.stages["action"].nunique() < 2:
        return
    probability = logs.stages.loc[is_completed, "probability"]
    if len(probability) >= FEWEST_ROWS and (probability == 1).all():
        yield "all probabilities are 1: the policy never explored, so nothing can be learned of other actions"


def _equal_rewards(logs: Logs) -> Iterator[str]:
    rewards = logs.stages["reward"].dropna()
    if len(rewards) >= FEWEST_ROWS and rewards.nunique() == 1:
        yield f"all {len(rewards)} rewards are {rewards.iloc[0]:g}: no action is better than another"


def _constant_covariates(logs: Logs) -> Iterator[str]:
    for name, values, _ in covariates(logs):
        if (
            len(values) < FEWEST_ROWS
            or (values.dtype == object and not values.map(pd.api.types.is_hashable).all())  # lists, records
            or values.nunique(dropna=False) != 1
        ):
            continue
        # A count of what never happened is no dead sensor.
        if not (pd.api.types.is_integer_dtype(values.dtype) and values.iloc[0] == 0):
            yield (
                f"{name} is {shown(values.iloc[0])} in all {len(values)} rows: a dead sensor, or a column to leave out"
            )


def _duplicates(logs: Logs) -> Iterator[str]:
    """Trajectories that agree to the last digit in two measured durations are copies; whole steps may well agree."""
    stages: Any = logs.stages
    part = stages["elapsed_s"] - stages.groupby("trajectory")["elapsed_s"].shift(fill_value=0.0)
    part = (part % 1.0).round(6) % 1.0
    num_measured = part.where(part > 0).groupby(stages["trajectory"]).nunique()
    content = stages[["stage", "elapsed_s", "action", "reward"]].astype({"action": str})
    prints: Any = hash_pandas_object(content, index=False)  # pyright: ignore[reportCallIssue]
    prints = prints.groupby(stages["trajectory"]).sum()
    prints = prints[num_measured >= 2]
    repeated = prints[prints.duplicated(keep=False)]
    if len(repeated):
        first = [shown(name) for name in repeated.index[repeated == repeated.iloc[0]][:2]]
        num_copies = int(prints.duplicated().sum())
        yield (
            f"{num_copies} {'trajectory is a copy' if num_copies == 1 else 'trajectories are copies'} of another (such "
            f"as {' and '.join(first)}): the same clock, actions and rewards to the last digit; drop what was logged "
            "twice"
        )


def _listed(names: Iterable[str]) -> str:
    names = list(names)
    more = f" and {len(names) - NUM_NAMED} more" if len(names) > NUM_NAMED else ""
    return ", ".join(names[:NUM_NAMED]) + more


def _named(what: str, names: list[str]) -> str:
    return f"{what if len(names) == 1 else what + 's'} {_listed(names)}"


def _was(names: list[str]) -> str:
    return "was" if len(names) == 1 else "were"


_CHECKS: dict[str, Callable[[Logs], Iterable[Any]]] = {
    "all-cut": _all_cut,
    "untrue-probability": untrue_probabilities,
    "leak": leaks,
    "outcome-as-covariate": outcomes_among_covariates,
    "cut-called-finished": cuts_called_finished,
    "identifier": identifiers,
    "number-as-text": numbers_as_text,
    "one-action": one_action,
    "no-alternative": no_alternative,
    "end-among-causes": _ends_among_causes,
    "horizon-as-cut": _horizons,
    "cuts-in-one-stage": _one_stage,
    "mixed-clock-units": mixed_clocks,
    "long-clock": long_clocks,
    "mixed-covariate-units": mixed_covariates,
    "spelling": _spelling,
    "rare-action": _rare_actions,
    "no-probability": _no_probability,
    "no-exploration": _no_exploration,
    "equal-rewards": _equal_rewards,
    "constant-covariate": _constant_covariates,
    "duplicated-trajectories": _duplicates,
}
