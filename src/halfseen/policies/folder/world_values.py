"""A world, its robots and its laws included, as plain values of policy.json, and back."""

from collections.abc import Mapping
from dataclasses import fields
from typing import Any

import numpy as np

from halfseen.errors import ArgumentError, HalfseenError, PolicyError
from halfseen.policies.folder.json_values import typed
from halfseen.world.config import WorldConfig
from halfseen.world.grasping import AssumedGrasping, FittedGrasping
from halfseen.world.seeing import AssumedSeeing, PersistentSeeing

LAWS = {
    "grasping": {"exponential": AssumedGrasping, "logistic": FittedGrasping},
    "seeing": {"independent": AssumedSeeing, "persistent": PersistentSeeing},
}
"""Families that a folder can hold, by law and name."""
_CURVES = ("views", "sensitivity", "false_alarms")
NUMBERS = (
    "dirty_share",
    "transport_s",
    "reward_wash_dirty",
    "reward_wash_clean",
    "reward_wash_failed",
    "reward_lift_per_s",
    "reward_dirty_left",
)


def values_of_world(config: WorldConfig) -> dict[str, Any]:
    """Write a world down.

    Raises
    ------
    ArgumentError
        A law is of no family that a folder can hold.
    """
    found: dict[str, Any] = {"horizon": config.horizon, **{name: float(getattr(config, name)) for name in NUMBERS}}
    for name, families in LAWS.items():
        law = getattr(config, name)
        family = next((family for family, kind in families.items() if type(law) is kind), None)
        if family is None:
            raise ArgumentError(
                f"{name} is {type(law).__name__}, whose code a folder cannot hold; fit the law to a log"
            )
        numbers = {each.name: _plain(getattr(law, each.name)) for each in fields(law)}
        found[name] = {"family": family, **numbers}
    if config.num_robots > 1:
        out = config.drop_out_rate
        found["speed"] = [float(each) for each in config.speed]
        found["reward_per_s"] = float(config.reward_per_s)
        found["drop_out_rate"] = None if out is None else [float(each) for each in out]
    return found


def _plain(value: Any) -> Any:
    return [float(each) for each in value] if isinstance(value, tuple) else float(value)


def world_of_values(values: Mapping[str, Any]) -> WorldConfig:
    """Put a world together again.

    Raises
    ------
    PolicyError
        A number is missing or none, or a law is of an unknown family.
    """
    numbers = {name: _number(values, name) for name in NUMBERS}
    horizon = typed(values, "horizon", int, "a whole number")
    if not 0.0 < numbers["dirty_share"] < 1.0:
        raise PolicyError(f"dirty_share is {numbers['dirty_share']}; it lies between 0 and 1: learn the policy anew")
    laws = {name: _law(name, typed(values, name, dict, "a law"), families) for name, families in LAWS.items()}
    robots: dict[str, Any] = {}
    if "speed" in values:
        robots = {"speed": _curve(values, "speed"), "reward_per_s": _number(values, "reward_per_s")}
        robots["drop_out_rate"] = None if values.get("drop_out_rate") is None else _curve(values, "drop_out_rate")
    try:
        return WorldConfig(horizon=horizon, **numbers, **laws, **robots)
    except HalfseenError as error:
        raise PolicyError(f"laws: {error}; learn the policy anew") from error


def _law(name: str, values: Mapping[str, Any], families: Mapping[str, Any]) -> Any:
    family = values.get("family")
    if family not in list(families):
        raise PolicyError(f"{name} is of family {family!r}; it is {' or '.join(families)}: learn the policy anew")
    kind = families[family]
    names = [each.name for each in fields(kind)]
    if set(values) != {"family", *names}:
        raise PolicyError(
            f"{name} holds {sorted(values)}; it holds {sorted(['family', *names])}: learn the policy anew"
        )
    found = {each: _curve(values, each) if each in _CURVES else _number(values, each) for each in names}
    try:
        return kind(**found)
    except (HalfseenError, TypeError, ValueError) as error:
        raise PolicyError(f"{name}: {error}; learn the policy anew") from error


def _curve(values: Mapping[str, Any], name: str) -> tuple[float, ...]:
    return tuple(_finite(name, each) for each in typed(values, name, list, "a list of numbers"))


def _number(values: Mapping[str, Any], name: str) -> float:
    return _finite(name, values.get(name))


def _finite(name: str, value: Any) -> float:
    if not isinstance(value, int | float) or isinstance(value, bool) or not np.isfinite(value):
        raise PolicyError(f"{name} is {value!r} and no finite number; learn the policy anew")
    return float(value)
