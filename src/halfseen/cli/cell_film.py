"""``halfseen cell film``: one table that a policy clears in physics, as an animated picture."""

from pathlib import Path
from tempfile import TemporaryDirectory

import click

from halfseen.cli import options
from halfseen.cli.arms import arm_options, num_arms_option, robot_for, stations_for
from halfseen.cli.cell_policies import policy_of, policy_option, team_policy_of
from halfseen.cli.cell_run import belief_of
from halfseen.cli.laws import SHIPPED, law_option
from halfseen.cli.messages import say
from halfseen.cli.opengl import start_opengl
from halfseen.cli.output_files import refuse_output
from halfseen.progress import Progress

DRAWING = 3
"""What drawing takes, where a decision and what is done after it take 1."""


@click.command(epilog="Example: halfseen cell film --policy planner --out film.gif")
@policy_option
@click.option("--out", type=options.PATH, required=True, help="File that the film is written to (.gif).")
@law_option(SHIPPED)
@click.option(
    "--table", type=click.IntRange(0, options.MOST_EPISODES), default=0, show_default=True, help="Number of the table."
)
@num_arms_option
@arm_options
@options.seed("film")
@options.overwrite("a film that is")
def film(
    name: str,
    out: Path,
    law: str,
    table: int,
    num_arms: int,
    arm: Path | None,
    flange: str | None,
    joints: list[str] | None,
    seed: int,
    overwrite: bool,
) -> None:
    """Film how a policy clears a table in physics, eight times faster than it was, and say what it decides.

    Seed and number give the same table as in `halfseen cell run`. Drawing needs OpenGL; nothing else of halfseen does.
    """
    refuse_output(out, "a film", [".gif"], overwrite, [arm] if arm else [])
    start_opengl()
    from halfseen.cell.campaign import Conditions
    from halfseen.cell.episode import Moment, play
    from halfseen.cell.film import OF_TWO_ARMS, Film, Shot
    from halfseen.logs import LogRecorder
    from halfseen.world import random

    stations = stations_for(num_arms, arm)
    robot, arm_name = robot_for(arm, flange, joints)
    belief = belief_of(law, arm_name)
    cell, is_dirty = Conditions(robot=robot, stations=stations, stops=None).cell(seed, table)
    taken = Film(OF_TWO_ARMS if stations else Shot())
    cell.cell.watches.append(taken)
    key = random.fold_in(random.key_of(seed), table)
    num_stages = num_arms * belief.config.horizon
    with Progress(num_stages + DRAWING, "play") as bar:

        def follow(moment: Moment) -> None:
            taken.say(moment.words)
            bar.update()

        with TemporaryDirectory() as folder, LogRecorder(folder) as recorder:
            trajectory = recorder.begin_trajectory(table)
            policy = (
                team_policy_of(name, 0.0, belief.config, num_arms) if stations else policy_of(name, 0.0, belief.config)
            )
            run = play(cell, is_dirty, policy, belief, trajectory, key, on_decision=follow)
        bar.reach(num_stages)
        bar.begin("draw", 0)
        taken.write(out, cell)
    say(
        f"{out}: {run.num_washed} of {run.num_dirty} dirty cups washed in {run.seconds:.0f} s, reward {run.reward:+.1f}"
    )
