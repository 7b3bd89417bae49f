"""``halfseen cell``: the physical cell in simulation."""

from importlib import import_module

import click

COMMANDS = {
    "calibrate": "Let the cell try, and estimate its laws of grasping and seeing from that.",
    "run": "Let a policy clear fresh tables in physics, and record it.",
    "film": "Film how a policy clears one table.",
}


class _CellGroup(click.Group):
    """A group that imports a command's file when that command is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        return getattr(import_module(f"halfseen.cli.cell_{cmd_name}"), cmd_name)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.group(cls=_CellGroup, epilog="Example: halfseen cell run --policy policy --tables 50 --out logs")
def cell() -> None:
    """Let a simulated arm work in physics: look, decide, grasp, and look again."""
