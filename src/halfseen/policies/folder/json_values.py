"""Values of policy.json, checked as they are read."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from halfseen.errors import PolicyError


def typed(record: Mapping[str, Any], name: str, kind: type, what: str) -> Any:
    """Take a value of this type.

    Raises
    ------
    PolicyError
        It is another.
    """
    value = record.get(name)
    if not isinstance(value, kind) or isinstance(value, bool):
        raise PolicyError(f"{name} is {value!r} and not {what}; learn the policy anew")
    return value


def names_in(schema: Mapping[str, Any], name: str, kinds: tuple[type, ...]) -> tuple[Any, ...]:
    """Take a list of names, each there once.

    Raises
    ------
    PolicyError
        It is none.
    """
    names = typed(schema, name, list, "a list")
    is_right = all(isinstance(one, kinds) and not isinstance(one, bool) for one in names)
    if not is_right or len(set(names)) < len(names):
        raise PolicyError(f"{name} is {names}; each has a name of its own: learn the policy anew")
    return tuple(names)


def horizon_of(record: Mapping[str, Any]) -> int:
    """Number T of stages."""
    horizon = typed(record["schema"], "horizon", int, "a whole number")
    if horizon < 1:
        raise PolicyError(f"horizon is {horizon}; a trajectory has at least 1 stage: learn the policy anew")
    return horizon


def plain(value: Any) -> Any:
    """Write a value as JSON can: null for a number that it does not have, an object by what it prints."""
    if isinstance(value, np.generic):
        value = value.item()
    if value is None or isinstance(value, (bool, int, float, str)):
        return None if isinstance(value, float) and not np.isfinite(value) else value
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, (Sequence, np.ndarray)):
        return [plain(entry) for entry in value]
    return repr(value)


def check_features(record: Mapping[str, Any], features: Mapping[str, Any], verbs: Sequence[str]) -> None:
    """Refuse a policy that looks at other features, or knows other verbs, than this halfseen.

    Raises
    ------
    PolicyError
        As above.
    """
    found = record["schema"].get("features")
    if found != features or record["schema"].get("actions") != verbs:
        raise PolicyError(
            f"the policy looks at features {found}, and this halfseen knows {features}; use the halfseen that "
            f"wrote it ({record['versions'].get('halfseen')}), or learn the policy anew"
        )
