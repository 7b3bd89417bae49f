"""Policies of named actions in a folder."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from halfseen.errors import ArgumentError, PolicyError
from halfseen.lazy import Frame
from halfseen.learning.covariates import Categories, Covariates
from halfseen.learning.flat_policy import FlatPolicy
from halfseen.policies.folder.arrays import (
    BEHAVIOUR,
    COEFFICIENTS,
    MARGIN,
    Arrays,
    Shape,
    check_arrays,
    kernel_map_of,
    policy_arrays,
)
from halfseen.policies.folder.json_values import horizon_of, names_in, typed
from halfseen.policies.folder.seen import entry, ranges

if TYPE_CHECKING:
    from halfseen.logs import Logs
else:
    Logs = Any  # What is decided by a policy of this kind loads no log.


@dataclass(frozen=True)
class NamedKind:
    """Kind ``"flat"``: a `FlatPolicy`, in double precision."""

    policy_type = FlatPolicy

    def facts(self, logs: Logs) -> None:
        """The schema needs nothing of the log."""

    def schema(self, policy: FlatPolicy, facts: Sequence[Any]) -> dict[str, Any]:
        """Covariates and their categories, names of the actions, and those that each stage allows.

        Raises
        ------
        ArgumentError
            An action has a name that a JSON file cannot hold.
        """
        names = [_action_name(name) for name in policy.actions]
        rows = policy.is_possible
        return {
            "horizon": policy.horizon,
            "covariates": list(policy.covariates),
            "categories": {name: list(known) for name, known in policy.categories.items()},
            "actions": names,
            "possible": [[name for name, is_it in zip(names, row, strict=True) if is_it] for row in rows],
        }

    def seen(self, logs: Logs, policy: FlatPolicy, is_by_stage: bool) -> list[dict[str, Any]]:
        """Ranges of the covariates."""
        return _seen(logs, policy.looks_at, is_by_stage)

    def range_names(self, policy: FlatPolicy) -> tuple[str, ...]:
        """Names of the covariates."""
        return policy.covariates

    def arrays_of(self, policy: FlatPolicy) -> dict[str, np.ndarray]:
        """Coefficients, and the kernel, the margin and the behaviour policy if there are."""
        return policy_arrays(policy)

    def policy_of(self, record: Mapping[str, Any], arrays: Arrays) -> FlatPolicy:
        """Put a policy together again.

        Raises
        ------
        PolicyError
            A name is none or is there twice, a stage allows none of the actions, or arrays do not fit.
        """
        schema, horizon = record["schema"], horizon_of(record)
        actions = names_in(schema, "actions", (int, str))
        looks_at = Covariates(names_in(schema, "covariates", (str,)), _categories(schema))
        possible = typed(schema, "possible", list, "a list")
        is_right = len(possible) == horizon and all(isinstance(names, list) and names for names in possible)
        if not is_right or not all(name in actions for names in possible for name in names):
            raise PolicyError(f"possible is {possible}; it lists some of the actions for each of the {horizon} stages")
        is_possible = np.array([[name in names for name in actions] for names in possible])
        check_arrays(arrays, Shape(horizon, len(actions), looks_at.num_features, np.float64))
        return FlatPolicy(
            actions=actions,
            covariates=looks_at.columns,
            is_possible=is_possible,
            coefficients=arrays[COEFFICIENTS],
            kernel_map=kernel_map_of(arrays),
            margin=arrays.get(MARGIN),
            behaviour=arrays.get(BEHAVIOUR),
            categories=looks_at.categories,
        )


def _categories(schema: Mapping[str, Any]) -> Categories:
    """Categories of the covariates that hold text; none in a folder that does not say."""
    if "categories" not in schema:
        return {}
    each = typed(schema, "categories", dict, "an object")
    if not set(each) <= set(schema["covariates"]):
        raise PolicyError(f"categories are of {', '.join(each)}; each is of a covariate: learn the policy anew")
    return {name: names_in(each, name, (str,)) for name in each}


def _action_name(name: Any) -> int | str:
    value = name.item() if isinstance(name, np.generic) else name
    if isinstance(value, bool) or not isinstance(value, (int, str)):
        raise ArgumentError(f"action {name!r} is neither a whole number nor text; a folder cannot hold other names")
    return value


def _seen(logs: Logs, covariates: Covariates, is_by_stage: bool) -> list[dict[str, Any]]:
    """Give the least and the largest value of each covariate of named actions, by stage or over all stages.

    Of text, give how many states showed each category that was seen.

    Parameters
    ----------
    logs
        The log.
    covariates
        Columns of its stages.
    is_by_stage
        One entry a stage; else one for all.

    Returns
    -------
    list
        For each entry the ``stages`` that it is for, from and to; how many states there were; and their ``ranges``.
    """
    frame: Any = logs.stages
    if not is_by_stage:
        return [entry(1, logs.horizon, len(frame), _shown(frame, covariates))]
    parts = [(stage, frame[frame["stage"] == stage]) for stage in range(1, logs.horizon + 1)]
    return [entry(stage, stage, len(part), _shown(part, covariates)) for stage, part in parts]


def _shown(frame: Frame, covariates: Covariates) -> dict[str, Any]:
    """Range of each column of numbers, and counts of each of text, in the order of columns."""
    counts = {name: frame[name].astype(str).value_counts() for name in covariates.categories}
    return {
        name: {one: int(counts[name][one]) for one in covariates.categories[name] if one in counts[name]}
        if name in counts
        else ranges(frame, (name,))[name]
        for name in covariates.columns
    }
