"""The command line: one file a command, and heavy imports only inside a command."""

import os
import sys
import warnings
from importlib import import_module
from typing import Any

import click

from halfseen import __version__
from halfseen.errors import HalfseenError, HalfseenWarning

COMPILES_QUICKLY = "--xla_backend_optimization_level=1 --xla_cpu_use_fusion_emitters=false"
"""A verb compiles for longer than it runs: this halves that, and what is compiled is as fast."""

VERBS = {
    "inspect": "Say what a folder of logs holds: paths, endings, causes, weights, and what looks wrong.",
    "learn": "Learn a policy from a folder of logs.",
    "evaluate": "Say what a policy is worth, from logs of another one, before it runs.",
    "act": "Decide at one table, and say why.",
    "watch": "Show in the browser what was seen and decided, in 3-D, and why.",
    "report": "Write one page about a folder of logs and a policy.",
    "convert": "Convert logs between Parquet, CSV, Minari datasets and ROS bags.",
    "look": "Say what a depth camera sees on a table, who hides whom, and what looks dirty.",
    "simulate": "Record logs of a policy in the simulated world, some of them cut.",
    "cell": "Let a simulated arm work in physics: calibrate its laws, or run a policy.",
    "study": "Regenerate the study: its figures, tables and report.",
}


class _VerbGroup(click.Group):
    """A group that imports a command's file when that command is called, so that ``--help`` stays instant."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(VERBS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in VERBS:
            return None
        return getattr(import_module(f"halfseen.cli.{cmd_name}"), cmd_name)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl(list(VERBS.items()))


@click.group(cls=_VerbGroup, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="halfseen")
def halfseen() -> None:
    """Learn when to pick, when to look and when to stop, from cut logs and half-hidden views."""


def main() -> None:
    """Run the command line; bad input is told in one line and ends with exit status 2."""
    os.environ.setdefault("XLA_FLAGS", COMPILES_QUICKLY)
    try:
        with warnings.catch_warnings():
            _say_in_one_line()
            halfseen(standalone_mode=False)
    except HalfseenError as error:
        _refuse(str(error))
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message())
    except click.ClickException as error:
        _refuse(error.format_message())
    except (click.Abort, KeyboardInterrupt):
        click.echo("halfseen: stopped", err=True)
        sys.exit(130)


def _say_in_one_line() -> None:
    """Let warnings that are meant for users read like all else; others stay as Python prints them."""
    usual = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        if issubclass(category, HalfseenWarning):
            click.echo("halfseen: " + " ".join(str(message).split()), err=True)
        else:
            usual(message, category, *where, **more)

    warnings.showwarning = show


def _refuse(message: str) -> None:
    click.echo("halfseen: " + " ".join(message.split()), err=True)
    sys.exit(2)
