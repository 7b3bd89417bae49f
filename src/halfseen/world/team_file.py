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
    law = "assumed"             # of grasping, by a name that whoever reads the file knows; the world's if left out
"""

from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from halfseen.errors import ArgumentError, within
from halfseen.reading import json_of, read_text, toml_of
from halfseen.suggestions import did_you_mean
from halfseen.world.grasping import GraspLaw
from halfseen.world.robots import Robot, Team, check_numbers, check_robot

_NEEDED = ("base_m", "reach_m")
_OF_ROBOT = (*(field.name for field in fields(Robot) if field.name != "grasping"), "law")
_OF_TEAM = ("clearance_m", "reward_per_s")


def read_team(path: str | Path, law_of: Callable[[str], GraspLaw] | None = None) -> Team:
    """Read the robots of a team.

    Parameters
    ----------
    path
        A TOML file, or a JSON file of the same keys with the ending .json.
    law_of
        Gives the law of grasping of a name, for robots with a `law`; None where none has one. On the command line a
        name is what `--law` takes, a folder being looked for beside the file.

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
        of_team = {key: told[key] for key in _OF_TEAM if key in told}
        check_numbers(of_team)
        team = Team(tuple(_robot(k, each, law_of) for k, each in enumerate(robots)), **of_team)
        _check_names(team)
        return team


def _read(path: Path) -> Mapping[str, Any]:
    try:
        told = (json_of if path.suffix.lower() == ".json" else toml_of)(read_text(path))
    except OSError as error:
        raise ArgumentError(f"cannot be read ({error.strerror}); give a TOML or JSON file of robots") from error
    except ValueError as error:
        raise ArgumentError(f"is no TOML or JSON ({error}); mend it there") from error
    if not isinstance(told, Mapping):
        raise ArgumentError(f"holds {type(told).__name__}, not keys; write it as the documentation of read_team has it")
    return told


def _robot(k: int, told: Mapping[str, Any], law_of: Callable[[str], GraspLaw] | None) -> Robot:
    where = f"robot {k}: "
    _check_keys(where, told, _OF_ROBOT)
    for key in _NEEDED:
        if key not in told:
            raise ArgumentError(f"{where}{key} is missing; give it [m]")
    named = {"name": f"robot {k}", **told}
    law = named.pop("law", None)
    check_robot(named)
    return Robot(**named, grasping=None if law is None else _grasping(where, law, law_of))


def _grasping(where: str, law: Any, law_of: Callable[[str], GraspLaw] | None) -> GraspLaw:
    if not isinstance(law, str):
        raise ArgumentError(f"{where}law is {law!r}; give the name of a law of grasping")
    if law_of is None:
        raise ArgumentError(f"{where}law is {law!r}, and nobody says which that is; give read_team a law_of that does")
    with within(f"{where}law"):
        return law_of(law)


def _check_keys(where: str, told: Mapping[str, Any], known: tuple[str, ...]) -> None:
    for key in told:
        if key not in known:
            raise ArgumentError(f"{where}there is no key {key!r} among {', '.join(known)}{did_you_mean(key, known)}")


def _check_names(team: Team) -> None:
    names = [robot.name for robot in team.robots]
    for name in names:
        if names.count(name) > 1:
            raise ArgumentError(f"two robots are called {name!r}; give each a name of its own")
