"""A team from a file, TOML or JSON.

::

    clearance_m = 0.12          # may be left out, as may what follows but base_m and reach_m
    reward_per_s = -0.05

    [[robot]]
    name = "left"
    base_m = [-0.5, 0.0]
    reach_m = 0.7
    speed = 1.0
    drop_out_rate = 0.001
"""

import json
import tomllib
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from halfseen.errors import ArgumentError
from halfseen.logs.refusal import shown, within
from halfseen.suggestions import did_you_mean
from halfseen.team.robots import Robot
from halfseen.team.team import Team

_NEEDED = ("base_m", "reach_m")
_OF_ROBOT = tuple(field.name for field in fields(Robot))
_OF_TEAM = ("clearance_m", "reward_per_s")


def read_team(path: str | Path) -> Team:
    """Read the robots of a team.

    Parameters
    ----------
    path
        A TOML file, or a JSON file of the same keys with the ending .json.

    Raises
    ------
    ArgumentError
        The file cannot be read, a key is unknown or missing, a value is none that it can be, or two robots have one
        name.
    """
    with within(path):
        told = _read(Path(path))
        _check_keys("", told, ("robot", *_OF_TEAM))
        robots = told.get("robot")
        if not (isinstance(robots, list) and robots and all(isinstance(each, Mapping) for each in robots)):
            raise ArgumentError("there is no robot; give each a table of its own, [[robot]] with base_m and reach_m")
        team = Team(tuple(_robot(k, each) for k, each in enumerate(robots)), **_numbers("", told, _OF_TEAM))
        _check_names(team)
        return team


def _read(path: Path) -> Mapping[str, Any]:
    try:
        text = path.read_text(encoding="utf-8")
        told = json.loads(text) if path.suffix.lower() == ".json" else tomllib.loads(text)
    except OSError as error:
        raise ArgumentError(f"cannot be read ({error.strerror}); give a TOML or JSON file of robots") from error
    except (UnicodeDecodeError, ValueError) as error:
        raise ArgumentError(f"is no TOML or JSON ({error}); mend it there") from error
    if not isinstance(told, Mapping):
        raise ArgumentError(f"holds {type(told).__name__}, not keys; write it as the documentation of read_team has it")
    return told


def _robot(k: int, told: Mapping[str, Any]) -> Robot:
    where = f"robot {k}: "
    _check_keys(where, told, _OF_ROBOT)
    for key in _NEEDED:
        if key not in told:
            raise ArgumentError(f"{where}{key} is missing; give it [m]")
    name = told.get("name", f"robot {k}")
    if not (isinstance(name, str) and name.strip()):
        raise ArgumentError(f"{where}name is {shown(name)}; give a text")
    base = told["base_m"]
    if not (isinstance(base, list) and len(base) == 2 and all(map(_is_number, base))):
        raise ArgumentError(f"{where}base_m is {base}; give two numbers, [x, y] [m]")
    numbers = _numbers(where, told, ("reach_m", "speed", "drop_out_rate"))
    return Robot((float(base[0]), float(base[1])), name=name, **numbers)


def _numbers(where: str, told: Mapping[str, Any], keys: tuple[str, ...]) -> dict[str, float]:
    for key in keys:
        if key in told and not _is_number(told[key]):
            raise ArgumentError(f"{where}{key} is {shown(told[key])}; give a number")
    return {key: float(told[key]) for key in keys if key in told}


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def _check_keys(where: str, told: Mapping[str, Any], known: tuple[str, ...]) -> None:
    for key in told:
        if key not in known:
            raise ArgumentError(f"{where}there is no key {key!r} among {', '.join(known)}{did_you_mean(key, known)}")


def _check_names(team: Team) -> None:
    names = [robot.name for robot in team.robots]
    for name in names:
        if names.count(name) > 1:
            raise ArgumentError(f"two robots are called {name!r}; give each a name of its own")
