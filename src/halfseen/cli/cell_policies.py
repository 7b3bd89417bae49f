"""``--policy`` of a cell: who decides there, by a name or a folder, and what an arm believes under a law."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from halfseen.cli.inputs import law_folder
from halfseen.cli.messages import tell_warning
from halfseen.errors import PolicyError
from halfseen.planners.named import HEURISTICS, PLANNER, exploring, named_policy
from halfseen.suggestions import did_you_mean

if TYPE_CHECKING:
    from halfseen.cell.table_state import Belief
    from halfseen.policies.folder import StoredPolicy
    from halfseen.world import Policy, WorldConfig

NAMES = (*HEURISTICS, PLANNER)
policy_option = click.option(
    "--policy",
    "name",
    required=True,
    help=f"Who decides: the folder of a policy of tables, of two arms that of a team's, or {', '.join(NAMES)}.",
)


def policy_of(name: str, random_share: float, config: "WorldConfig") -> "Policy":
    """Find the policy of one arm, by one of `NAMES` or a folder; a share of its steps is uniformly random instead.

    Raises
    ------
    PolicyError
        There is no such folder, or the policy in it decides for something else.
    """
    if name in NAMES:
        return named_policy(name, config, random_share)
    from halfseen.policies.folder.stored import refuse_team

    stored = _stored(name)
    refuse_team(stored, "and one arm clears the table; give a policy of one robot", name)
    if not stored.is_table:
        raise PolicyError(
            f"{name}: it is no policy of tables; learn one from logs of tables, as of `halfseen cell run`"
        )
    if stored.horizon != config.horizon:
        raise PolicyError(
            f"{name}: it was learned for {stored.horizon} stages, and a table here has {config.horizon}; learn it "
            f"with a horizon of {config.horizon}"
        )
    return exploring(stored.policy, random_share)


def team_policy_of(name: str, random_share: float, config: "WorldConfig", num_arms: int) -> "Policy":
    """Find the policy of several arms, whose seconds cost nothing; errors as in `policy_of`."""
    if name in NAMES:
        return named_policy(name, replace(config, speed=(1.0,) * num_arms), random_share)
    stored = _stored(name)
    remedy = f"learn one from logs of {num_arms} arms, as of `halfseen cell run --arms {num_arms}`"
    if stored.num_robots is None:
        what = "one robot by itself" if stored.is_table else "no table"
        raise PolicyError(f"{name}: it decides for {what}, and {num_arms} arms clear the table; {remedy}")
    if stored.num_robots != num_arms:
        raise PolicyError(
            f"{name}: it decides for a team of {stored.num_robots}, and here are {num_arms} arms; {remedy}"
        )
    if stored.horizon != num_arms * config.horizon:
        raise PolicyError(
            f"{name}: it was learned for {stored.horizon // num_arms} decisions of each robot, and each arm here has "
            f"{config.horizon}; learn it with a horizon of {config.horizon}"
        )
    return exploring(stored.policy, random_share)


def _stored(folder: str) -> "StoredPolicy":
    from halfseen.policies import read_policy

    if not Path(folder).exists():
        there = f"there is no such folder; let `halfseen learn` write one, or name one of {', '.join(NAMES)}"
        raise PolicyError(f"--policy {folder}: {there}{did_you_mean(folder, NAMES)}")
    return read_policy(folder)


def belief_of(name: str, arm_name: str) -> "Belief":
    """What a robot with this arm believes under the law of a name."""
    from halfseen.cell.arm import JACO_2
    from halfseen.cell.calibration.law_folder import read_law
    from halfseen.cell.table_state import Belief, no_grip
    from halfseen.world import WorldConfig

    folder = law_folder(name)
    if folder is None:
        return Belief(WorldConfig(), no_grip)
    stored = read_law(folder)
    if (its := stored.record.get("arm", JACO_2.name)) != arm_name:
        tell_warning(f"{folder}: the law is of the arm {its}, and works here for {arm_name}")
    law = stored.law
    return Belief(law.config(), law.grip)
