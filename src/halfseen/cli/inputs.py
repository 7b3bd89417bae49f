"""Objects that options name: laws, robots, arms, policies and tables; and checks of output files."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import click

from halfseen.cli.messages import say, tell_warning
from halfseen.cli.options import ASSUMED, SHIPPED, ArmOption
from halfseen.errors import ArgumentError, CloudError, PolicyError, did_you_mean
from halfseen.planners import HEURISTICS, PLANNER, exploring, named_policy
from halfseen.writing import refuse_taken, refuse_unwritable, write_file

if TYPE_CHECKING:
    from halfseen.cell.calibration.law import Law
    from halfseen.cell.model import Station
    from halfseen.cell.table_state import Belief
    from halfseen.perception import Cloud, View
    from halfseen.world import GraspLaw, Policy, Scene, Team, WorldConfig


def law_folder(name: str, beside: Path | None = None) -> Path | None:
    """Find the folder of a law; None for the assumed law.

    Parameters
    ----------
    name
        As in ``--law``.
    beside
        Folder of the file that names the law; None if ``--law`` does.

    Raises
    ------
    ArgumentError
        There is no such folder.
    """
    if name == ASSUMED:
        return None
    from halfseen.cell.calibration.law import shipped_law

    if name == SHIPPED:
        return shipped_law()
    folder, where = (Path(name), f"--law {name}") if beside is None else (beside / name, name)
    if not folder.exists():
        there = f"no such folder; write one with `halfseen cell calibrate`, or give {SHIPPED} or {ASSUMED}"
        raise ArgumentError(f"{where}: {there}{did_you_mean(name, (SHIPPED, ASSUMED))}")
    return folder


def law_of(name: str, beside: Path | None = None) -> "Law | None":
    """Read a law by name; None for the assumed law; see `law_folder`.

    Raises
    ------
    PolicyError
        The folder holds no law.
    """
    folder = law_folder(name, beside)
    if folder is None:
        return None
    from halfseen.cell.calibration.law import read_law

    return read_law(folder).law


def _grasping_of(name: str, beside: Path) -> "GraspLaw":
    from halfseen.world import AssumedGrasping

    law = law_of(name, beside)
    return AssumedGrasping() if law is None else law.grasping


def read_robots(file: Path | None) -> "Team | None":
    """Read a team from a file, in which each `law` is as in ``--law``; None without a file.

    Raises
    ------
    ArgumentError
        The file holds no team.
    PolicyError
        A folder named in it holds no law.
    """
    if file is None:
        return None
    from halfseen.world import read_team

    return read_team(file, partial(_grasping_of, beside=file.parent))


def stations_for(arm: ArmOption, num_arms: int = 1) -> "tuple[tuple[Station, ...], str]":
    """Stations of the arms, and the name of the arm, with a digest if it comes from a file.

    Raises
    ------
    HalfseenError
        The file does not exist, lacks the arm, or its arm cannot work at the table, or not in a pair.
    """
    from halfseen.cell import PAIR, ArmFile, Station, robot_of

    if arm.file is None:
        for name, given in (("--flange", arm.flange), ("--joints", arm.joints)):
            if given is not None:
                raise ArgumentError(f"{name} is for an arm from a file; give the file by --arm, or leave {name} out")
        return (Station(),) if num_arms == 1 else PAIR, Station().robot.arm.name
    if num_arms > 1:
        raise ArgumentError(
            f"--arm is {arm.file} and --arms is {num_arms}, but only the default arm can be used twice; leave one out"
        )
    given = ArmFile(arm.file, flange=arm.flange, joints=None if arm.joints is None else tuple(arm.joints))
    return (Station(robot_of(given)),), f"{arm.file.name} ({given.digest})"


NAMES = (*HEURISTICS, PLANNER)


def policy_for(name: str, random_share: float, config: "WorldConfig", num_arms: int) -> "Policy":
    """Find the policy for the arms of a cell, by one of `NAMES` or a folder; a share of the steps is uniformly random.

    With several arms, time has no cost.

    Raises
    ------
    PolicyError
        The folder does not exist, or its policy does not fit the arms.
    """
    if name in NAMES:
        world = config if num_arms == 1 else replace(config, speed=(1.0,) * num_arms)
        return named_policy(name, world, random_share)
    from halfseen.policies import read_policy

    if not Path(name).exists():
        there = f"no such folder; write one with `halfseen learn`, or give one of {', '.join(NAMES)}"
        raise PolicyError(f"--policy {name}: {there}{did_you_mean(name, NAMES)}")
    stored, arms = read_policy(name), "one arm clears" if num_arms == 1 else f"{num_arms} arms clear"
    if num_arms != (stored.num_robots or (1 if stored.is_table else 0)):
        of_arms = "tables" if num_arms == 1 else f"{num_arms} arms"
        made_by = "`halfseen cell run`" if num_arms == 1 else f"`halfseen cell run --arms {num_arms}`"
        raise PolicyError(
            f"{name}: it decides for {stored.whom}, but {arms} the table; learn one from logs of {of_arms}, such as "
            f"those of {made_by}"
        )
    if stored.horizon != num_arms * config.horizon:
        raise PolicyError(
            f"{name}: it was learned for {stored.horizon // num_arms} decisions of each robot, but each arm here "
            f"makes {config.horizon}; learn it with a horizon of {config.horizon}"
        )
    return exploring(stored.policy, random_share)


def belief_of(name: str, arm_name: str) -> "Belief":
    """Belief of a robot with this arm under a named law."""
    from halfseen.cell.arm import JACO_2
    from halfseen.cell.calibration.law import read_law
    from halfseen.cell.table_state import Belief, no_grip
    from halfseen.world import WorldConfig

    folder = law_folder(name)
    if folder is None:
        return Belief(WorldConfig(), no_grip)
    stored = read_law(folder)
    if (its := stored.record.get("arm", JACO_2.name)) != arm_name:
        tell_warning(f"{folder}: the law was calibrated for the arm {its}, but is used for {arm_name}")
    return Belief(stored.law.config(), stored.law.grip)


def looks_at(clouds: Sequence[Path]) -> "list[Callable[[Law | None], Scene]]":
    """Functions that give the scene of each cloud, by default of the ten shipped ones.

    With a law, what is seen predicts grips. They raise `CloudError` for a cloud that cannot be read or is empty.
    """
    if clouds:
        return [partial(_scene_in, cloud) for cloud in clouds]
    from halfseen.cell.facts import tables_seen

    return [seen.scene for seen in tables_seen()]


def _scene_in(cloud: Path, law: "Law | None") -> "Scene":
    _, view = perceived(cloud)
    return view.scene() if law is None else law.scene(view)


def perceived(file: Path) -> "tuple[Cloud, View]":
    """Read a cloud, and detect the objects on its table.

    Raises
    ------
    CloudError
        It cannot be read, or shows no objects.
    """
    from halfseen.perception import perceive, read_cloud
    from halfseen.perception.view import remedy_without_objects

    cloud = read_cloud(file)
    view = perceive(cloud)
    if not view.objects:
        cut = f" except {view.num_cut} cut by the image border" if view.num_cut else ""
        raise CloudError(f"{file}: no objects on the table{cut}; {remedy_without_objects(view)}")
    return cloud, view


def give_mapping(text: str, file: Path | None) -> None:
    """Print a mapping template, or write it to a file.

    Raises
    ------
    ArgumentError
        The file already exists, or cannot be written.
    """
    if file is None:
        click.echo(text, nl=False)
        return
    refuse_taken(file, False, None, "mapping")
    write_file(file, text)
    say(f"{file}: a mapping to start from; check it, then pass it as --mapping")


def check_kind(given: object, kinds_of: Mapping[str, Sequence[str]], kind: str, this: str) -> None:
    """Refuse options that a source of this kind does not take.

    Raises
    ------
    ArgumentError
        Such an option is given.
    """
    for name, kinds in kinds_of.items():
        value = getattr(given, name)
        if value is not None and value is not False and kind not in kinds:
            named = " or ".join(filter(None, [", ".join(kinds[:-1]), kinds[-1]]))
            raise ArgumentError(f"--{name.replace('_', '-')} is for a source of kind {named}; {this}: leave it out")


def refuse_output(file: Path, what: str, endings: Sequence[str], overwrite: bool, inputs: Iterable[Path] = ()) -> None:
    """Refuse an output file that cannot be written, is one of `inputs`, or exists and must not be replaced.

    Raises
    ------
    ArgumentError
        It has a wrong ending, is an input, is not a file, already exists, or lies in a folder that cannot be written.
    """
    refuse_unwritable(file.parent)
    if file.suffix.lower() not in endings:
        raise ArgumentError(f"{file}: {what} ends in {' or '.join(endings)}; give one of these endings")
    if any(one.exists() and file.exists() and file.samefile(one) for one in inputs):
        raise ArgumentError(f"{file}: it is an input, so it is not replaced; choose another file")
    if file.is_dir():
        raise ArgumentError(f"{file}: it is a folder; give the name of a file in it")
    if file.exists() and not file.is_file():
        raise ArgumentError(f"{file}: it is a device, a pipe or the like, and not replaced; choose another file")
    if (file.exists() or file.is_symlink()) and not overwrite:
        raise ArgumentError(f"{file}: it already exists; choose another file, or pass --overwrite to replace it")
