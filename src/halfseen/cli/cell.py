"""``halfseen cell``: the physical cell in simulation."""

import click

from halfseen.cli.verb_group import VerbGroup

COMMANDS = {
    "calibrate": "Let the cell try, and estimate its laws of grasping and seeing from that.",
    "run": "Let a policy clear fresh tables in physics, and record it.",
    "film": "Film how a policy clears one table.",
}


@click.group(
    cls=VerbGroup,
    verbs=COMMANDS,
    modules="halfseen.cli.cell_",
    epilog="Example: halfseen cell run --policy policy --tables 50 --out logs",
)
def cell() -> None:
    """Let a simulated arm work in physics: look, decide, grasp, and look again."""
