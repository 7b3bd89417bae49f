"""The two films, made by the commands that their captions name."""

import os
import shlex
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from click.testing import CliRunner

from pictures.picture import Numbers, Picture, Row, Table

FILM = "cell film --policy planner --seed 6 --out {folder}/film.gif"
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


def _played() -> Table:
    """What the filmed arm decides, in words, and what that earns: the film without its pictures."""
    from halfseen.cli.opengl import GL, load_mujoco

    # It is loaded once, and what is drawn after this needs a way to draw.
    os.environ.setdefault(GL, "egl")
    load_mujoco()
    import jax

    from halfseen.cell.campaign import Conditions
    from halfseen.cell.episode import Moment, play
    from halfseen.cli.arms import robot_for
    from halfseen.cli.cell_run import belief_of, policy_of
    from halfseen.cli.laws import SHIPPED
    from halfseen.logs import LogRecorder

    seed, table, rows = 6, 0, []
    robot, arm_name = robot_for(None, None, None)
    belief = belief_of(SHIPPED, arm_name)
    cell, is_dirty = Conditions(robot=robot, stops=None).cell(seed, table)

    def follow(moment: Moment) -> None:
        rows.append({"stage": moment.stage, "words": moment.words})

    with TemporaryDirectory() as folder, LogRecorder(folder) as recorder:
        path = recorder.begin_path(table)
        key = jax.random.fold_in(jax.random.key(seed), table)
        run = play(cell, is_dirty, policy_of("planner", 0.0, belief.config), belief, path, key, on_decision=follow)
    told = f"{run.num_washed} of {run.num_dirty} dirty cups washed in {run.seconds:.0f} s, reward {run.reward:+.1f}"
    return [*rows, {"stage": 0, "words": told}]


def _decisions() -> Mapping[int, Row]:
    return dict(enumerate(_played()))


CLOSED_LOOP = Picture(
    "closed-loop",
    "docs/static/closed-loop.gif",
    partial(_made_by, FILM),
    Numbers("closed-loop.csv", _played, _decisions),
    seconds=60.0,
)
WATCHED = Picture("watch", "docs/static/watch.gif", partial(_made_by, *WATCH), seconds=60.0)
