"""The films, made by the commands that their captions name."""

import os
import shlex
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from click.testing import CliRunner

from halfseen.world import random
from pictures.picture import Numbers, Picture, Table

FILM = "cell film --policy planner --seed 6 --out {folder}/film.gif"
TWO_FILM = "cell film --policy history-penalty --arms 2 --seed 7 --out {folder}/film.gif"
WATCH = (
    "cell run --policy history-penalty --tables 2 --seed 6 --out {folder}/logs --record {folder}/record",
    "watch {folder}/record --stages 1-4 --export {folder}/film.gif",
)


def _made_by(*commands: str) -> bytes:
    from halfseen.cli import halfseen

    with TemporaryDirectory() as folder:
        for command in commands:
            done = CliRunner().invoke(halfseen, shlex.split(command.format(folder=folder)), catch_exceptions=False)
            assert done.exit_code == 0, done.output
        return (Path(folder) / "film.gif").read_bytes()


def _played(policy: str, seed: int, num_arms: int) -> Table:
    """What the filmed arms decide, in words, and what that earns: the film without its pictures."""
    from halfseen.cli.cell import GL, load_mujoco

    # It is loaded once, and what is drawn after this needs a way to draw.
    os.environ.setdefault(GL, "egl")
    load_mujoco()

    from halfseen.cell.campaign import Conditions
    from halfseen.cell.episode import Moment, play
    from halfseen.cell.film import Film
    from halfseen.cli.inputs import belief_of, policy_for, stations_for
    from halfseen.cli.options import SHIPPED, ArmOption
    from halfseen.logs import LogRecorder

    table, rows, taken = 0, [], Film()
    stations, arm_name = stations_for(ArmOption(None, None, None), num_arms)
    belief = belief_of(SHIPPED, arm_name)
    cell, is_dirty = Conditions(stations=stations, stops=None).cell(seed, table)

    def follow(moment: Moment) -> None:
        rows.append({"stage": moment.stage, "words": moment.words})
        taken.say(moment.words)

    cell.cell.watches.append(taken)

    with TemporaryDirectory() as folder, LogRecorder(folder) as recorder:
        trajectory = recorder.begin_trajectory(table)
        key = random.fold_in(random.key_of(seed), table)
        config = belief.config
        rule = policy_for(policy, 0.0, config, num_arms)
        run = play(cell, is_dirty, rule, belief, trajectory, key, on_decision=follow)
    caption = f"{run.num_washed} of {run.num_dirty} dirty cups washed in {run.seconds:.0f} s, reward {run.reward:+.1f}"
    # What another arm decides a moment later is in no picture of its own.
    return [*(row for row in rows if row["words"] in taken.captions), {"stage": 0, "words": caption}]


def _film(name: str, command: str, policy: str, seed: int, num_arms: int) -> Picture:
    table = partial(_played, policy, seed, num_arms)
    numbers = Numbers(f"{name}.csv", table, lambda: dict(enumerate(table())))
    return Picture(name, f"docs/static/{name}.gif", partial(_made_by, command), numbers, seconds=60.0)


CLOSED_LOOP = _film("closed-loop", FILM, "planner", 6, 1)
TWO_ARMS = _film("two-arms", TWO_FILM, "history-penalty", 7, 2)
FILMS = (CLOSED_LOOP, TWO_ARMS)
WATCHED = Picture("watch", "docs/static/watch.gif", partial(_made_by, *WATCH), seconds=60.0)
