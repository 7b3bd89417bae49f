"""``halfseen cell run``: a policy clears fresh tables in physics."""

import hashlib
import json
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from halfseen.cli import options
from halfseen.cli.arms import arm_options, num_arms_option, robot_for, stations_for
from halfseen.cli.cell_policies import policy_of, policy_option, team_policy_of
from halfseen.cli.following import follow_options, following
from halfseen.cli.laws import SHIPPED, law_folder, law_option
from halfseen.cli.messages import say, tell_warning
from halfseen.cli.opengl import load_mujoco
from halfseen.cli.workers import worker_options
from halfseen.progress import Progress

if TYPE_CHECKING:
    from halfseen.cell.table_state import Belief
    from halfseen.workers import Workers
    from halfseen.world import Policy


@click.command(epilog="Example: halfseen cell run --policy history-penalty --tables 50 --out logs")
@policy_option
@click.option("--out", type=options.PATH, required=True, help="Folder that the logs are written to.")
@click.option(
    "--tables",
    type=click.IntRange(2, options.MOST_EPISODES),
    default=50,
    show_default=True,
    help="Number of fresh tables.",
)
@law_option(SHIPPED)
@click.option("--stops/--no-stops", default=True, show_default=True, help="Whether something may cut a table.")
@click.option(
    "--random-share",
    type=click.FloatRange(0.0, 1.0),
    default=0.0,
    show_default=True,
    help="Probability that a step takes an action uniformly at random instead, for logs that are learned from.",
)
@follow_options
@num_arms_option
@arm_options
@worker_options
@options.seed("logs")
@options.as_json
@options.overwrite("logs that are")
def run(
    name: str,
    out: Path,
    tables: int,
    law: str,
    stops: bool,
    random_share: float,
    is_watched: bool,
    port: int,
    record: Path | None,
    num_arms: int,
    arm: Path | None,
    flange: str | None,
    joints: list[str] | None,
    workers: "Workers",
    seed: int,
    as_json: bool,
    overwrite: bool,
) -> None:
    """Let a policy clear fresh tables in physics: look, decide, act, look again, until FINISH, ten steps or a cut.

    The same seed gives every policy the same tables. What comes of it stands beside what the simulated world foretells
    for them under the law. A run that was stopped goes on where it was, if it is called again. --watch and --record
    follow the tables in one process; tables that were over before are not shown. Two arms follow the policy of a team,
    which decides for the one that is free; the ten steps are each arm's.
    """
    load_mujoco()
    from halfseen.cell.campaign import Campaign, Conditions, logs_of, working_folder
    from halfseen.cell.live_cell import Stops
    from halfseen.cell.summary import summarised
    from halfseen.logs.folder import MANIFEST
    from halfseen.workers import Workers
    from halfseen.writing import refuse_taken

    refuse = partial(refuse_taken, out, overwrite, MANIFEST, "logs")
    refuse()
    stations = stations_for(num_arms, arm)
    robot, arm_name = robot_for(arm, flange, joints)
    belief = belief_of(law, arm_name)
    policy: Policy = (
        team_policy_of(name, random_share, belief.config, num_arms)
        if stations
        else policy_of(name, random_share, belief.config)
    )
    conditions = Conditions(robot=robot, stations=stations, stops=Stops() if stops else None)
    told = f"policy {name}{_digest(Path(name))}, law {law}{_digest(law_folder(law))}"
    what = f"run, seed {seed}, {told}, stops {stops}, random share {random_share}"
    what += f", arm {arm_name}" if arm else ""
    what += f", {num_arms} arms" if stations else ""
    with following(policy, num_arms * belief.config.horizon, is_watched, port, record, overwrite) as follow:
        campaign = Campaign(policy, belief, conditions, seed, follow=follow)
        with (
            working_folder(out, what, refuse) as folder,
            Progress(tables, "run", "tables") as bar,
            (workers if follow is None else Workers(1)).ready() as pool,
        ):
            runs = []
            for _, each in campaign.runs(range(tables), folder, pool):
                runs.append(each)
                bar.update()
            logs = logs_of(folder, range(tables))
            summary = summarised(runs, logs, policy, belief.config, seed)
            logs.write(out, overwrite=overwrite)
        report = {
            "folder": str(out),
            "policy": name,
            "arm": arm_name,
            "arms": num_arms,
            "sentence": str(logs.summary()),
        }
        report |= asdict(summary)
        say(json.dumps(report, indent=2) if as_json else "\n".join(_lines(report)))


def _digest(folder: Path | None) -> str:
    """What a folder of a policy or a law holds, in a few letters; nothing for what is known by its name."""
    files = [] if folder is None else sorted(folder.glob("*.sha256"))
    return f" ({hashlib.sha256(files[0].read_bytes()).hexdigest()[:12]})" if files else ""


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


def _lines(report: dict[str, Any]) -> list[str]:
    counts = report["counts"]

    def listed(named: dict[str, int]) -> str:
        return ", ".join(f"{name} {count}" for name, count in named.items()) or "none"

    def told(estimate: dict[str, float] | None) -> str:
        if estimate is None:
            return "cannot be said: fewer than two tables came to their own end"
        return f"{estimate['value']:+.2f} ({estimate['low']:+.2f} to {estimate['high']:+.2f})"

    earned, together = f"reward in physics   {told(report['reward'])}", report["together"]
    predicted = [] if report["predicted"] is None else [f"foretold            {told(report['predicted'])}"]
    gaps = [f"gap                 {told(report['gap'])}", f"  without luck      {told(report['gap_without_luck'])}"]
    return [
        f"{report['folder']}: {report['sentence']}",
        "",
        earned,
        f"  by luck           {told(report['luck'])}: which cups were dirty, beyond what was believed",
        f"  without luck      {told(report['without_luck'])}",
        *predicted,
        *(gaps if predicted else []),
        f"{'table' if together else 'robot'} time          {report['seconds']:.0f} s a table, arm {report['arm']}",
        f"cups                {counts['num_racked']} of {counts['num_cups']} in the rack, {counts['num_washed']} of "
        f"{counts['num_dirty']} dirty ones; {counts['num_toppled']} toppled, {counts['num_fallen']} fell",
        f"tried               {listed(report['verbs'])}",
        f"did not hold        {listed(report['failures'])}",
        f"cut by              {listed(report['causes'])}",
        *([] if together is None else [_together(together)]),
    ]


def _together(told: dict[str, int | float]) -> str:
    return (
        f"arms                {told['num_collisions']:.0f} collisions; {told['num_waits']:.0f} waits for space, "
        f"{told['waited_s']:.0f} s in all; {told['num_deadlocks']:.0f} deadlocks, {told['num_gave_way']:.0f} of which "
        "sent an arm home"
    )
