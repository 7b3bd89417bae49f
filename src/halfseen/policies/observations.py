"""Deciders from policies, stored or in memory; and states of named actions from files."""

import csv
from collections.abc import Callable, Collection
from io import BytesIO, StringIO
from pathlib import Path
from typing import Any

from halfseen.errors import ArgumentError, PolicyError
from halfseen.learning.covariates import Categories
from halfseen.learning.discrete_policy import DiscretePolicy
from halfseen.policies.decision import Decider, QError
from halfseen.policies.folder.stored import UNDECIDED, StoredPolicy, refuse_team
from halfseen.policies.named_decider import (
    STATE_FILES,
    NamedDecider,
    NamedObservation,
    checked_stage,
    completed,
    covariates_in_words,
    known_covariates,
    stage_of,
)
from halfseen.policies.ranges import Margins, RangesOfStage, everything, no_margins
from halfseen.reading import json_of, read_bytes, read_text, reason_of


def decider_of(
    policy: Any,
    ranges: RangesOfStage = everything,
    *,
    extrapolates: bool = False,
    q_error: QError | None = None,
    least_rewards: dict[str, float] | None = None,
    stays_within: bool = False,
    margins: Callable[[int], Margins] = no_margins,
) -> Decider:
    """Make a decider of a policy.

    Parameters
    ----------
    policy
        A `StoredPolicy`, which implies all other arguments except how far to extrapolate; a `DiscretePolicy`; or any
        `halfseen.world.Policy`: learned, a planner or a heuristic.
    ranges
        Ranges of the training logs.
    extrapolates
        True to decide, with a warning, even if a value lies far outside these ranges; otherwise that is refused.
    q_error
        Errors of its Q; if None, the certainty of a decision is unknown.
    least_rewards
        The least reward of each verb of a table in the logs [reward]; None if unknown.
    stays_within
        For named actions: True to refuse values outside these ranges by more than their margins.
    margins
        By stage, how far outside a value may lie by chance; none for custom ranges.

    Raises
    ------
    ArgumentError
        The policy is none of these.
    PolicyError
        The policy decides for a team.
    """
    if isinstance(policy, StoredPolicy):
        refuse_team(policy, UNDECIDED)
        how: Any = {"extrapolates": extrapolates, "stays_within": stays_within, "margins": policy.margins}
        how |= {"q_error": policy.q_error, "least_rewards": policy.least_rewards}
        return decider_of(policy.policy, policy.ranges, **how)
    if isinstance(policy, DiscretePolicy):
        return NamedDecider(policy, ranges, extrapolates, q_error, stays_within, margins)
    # Tables load the world, which takes longer than a decision on named actions.
    from halfseen.policies.table_decider import TableDecider
    from halfseen.world.policy import Policy

    if isinstance(policy, Policy):
        least = least_rewards or {}
        return TableDecider(policy, ranges, extrapolates=extrapolates, q_error=q_error, least_rewards=least)
    raise ArgumentError(f"{type(policy).__name__} is not a policy; give one of named actions or of tables")


def read_covariates(
    stored: StoredPolicy,
    file: Path,
    history: Path | None = None,
    stage: int | None = None,
    labels: Path | None = None,
) -> NamedObservation:
    """Read the covariates that a policy of named actions decides from.

    Parameters
    ----------
    stored
        The policy.
    file
        The covariates of one state, as .json or .csv.
    history, labels
        None: they are for tables (`halfseen.policies.table_observation`).
    stage
        The stage to decide, from 1; None for that of the file, or 1.

    Raises
    ------
    HalfseenError
        The file cannot be read, or does not fit the policy; or an option of tables is given.
    """
    for option, given in (("--history", history), ("--labels", labels)):
        if given is not None:
            raise ArgumentError(
                f"{option} is for tables; this policy looks only at the covariates of the stage; leave {option} out"
            )
    policy = stored.policy
    if file.suffix.lower() not in STATE_FILES:
        raise PolicyError(
            f"{file}: the policy is of named actions and looks at {covariates_in_words(policy)}, not at clouds; give "
            "them as .json or .csv"
        )
    states = _read_states(file, policy.categories)
    if len(states) != 1:
        raise PolicyError(f"{file}: it holds {len(states)} states; give one: a JSON object, or a header and one row")
    state, said = states[0], stage_of(states[0], str(file), policy.covariates)
    full, filled = completed(policy, state)
    values = known_covariates(policy, full, str(file))
    if said is not None and stage not in (None, said):
        raise ArgumentError(f"--stage is {stage}, but {file} says {said}; leave one of them out")
    number = checked_stage(said if said is not None else stage or 1, stored.horizon, str(file))
    return NamedObservation(values, number, filled=filled)


def _cell(value: Any, categories: Collection[str] | None) -> Any:
    """Convert an empty cell of text to null, unless it is a category."""
    return None if categories is not None and value == "" and value not in categories else value


def _read_states(file: Path, texts: Categories) -> list[dict[str, Any]]:
    try:
        if file.suffix.lower() == ".json":
            state = json_of(read_text(file))
            return [state] if isinstance(state, dict) else []
        import pandas as pd

        _check_cells(read_text(file))
        exact: Any = {"float_precision": "round_trip", "converters": dict.fromkeys(texts, str)}
        states = pd.read_csv(BytesIO(read_bytes(file)), **exact).to_dict("records")
        return [{name: _cell(value, texts.get(name)) for name, value in each.items()} for each in states]
    except (OSError, ValueError, csv.Error) as error:
        raise PolicyError(f"{file}: it cannot be read ({reason_of(error)}); give one state as .json or .csv") from error


def _check_cells(text: str) -> None:
    """Refuse columns of one name, and rows of another length, which pandas would shift or fill."""
    head, *rows = [row for row in csv.reader(StringIO(text, newline=None)) if row] or [[]]
    twice = next((name for name in head if name and head.count(name) > 1), None)
    if twice is not None:
        raise ValueError(f"two columns are called {twice!r}")
    wrong = next((len(row) for row in rows if len(row) != len(head)), None)
    if wrong is not None:
        raise ValueError(f"a row has {wrong} cells, and the header {len(head)}")
