"""The command line: one file a verb or family of verbs, and heavy imports only inside a command."""

import gc
import os
import sys
import warnings
from typing import Any

import click

from halfseen import __version__
from halfseen.cli.group import VerbGroup
from halfseen.cli.messages import remedy, tell_error, tell_warning, unexpected
from halfseen.errors import HalfseenError, HalfseenWarning, did_you_mean

VERBS = {
    "inspect": "Say what a folder of logs holds: trajectories, endings, causes, weights, and what looks wrong.",
    "learn": "Learn a policy from a folder of logs.",
    "evaluate": "Say what a policy is worth, from logs of another one, before it runs.",
    "act": "Decide at one table, and say why.",
    "serve": "Answer over HTTP what to do now, and record what was decided.",
    "monitor": "Say whether a policy in service keeps its promise, what has changed, and since when.",
    "export": "Write a policy of named actions as ONNX, for controllers without Python.",
    "watch": "Show in the browser what was seen and decided, in 3-D, and why.",
    "report": "Write one page about a folder of logs and a policy.",
    "convert": "Convert logs of other programs: CSV, SQL, bags, MCAP, Minari, LeRobot, RLDS, D4RL.",
    "look": "Say what a depth camera sees on a table, who hides whom, and what looks dirty.",
    "record": "Record what a program in any language says, in JSON lines.",
    "simulate": "Record logs of a policy in the simulated world, some of them cut.",
    "cell": "Let a simulated arm work in physics: calibrate its laws, or run a policy.",
    "study": "Regenerate the study: its figures, tables and report.",
}
MODULES = {"export": "act", "inspect": "report", "record": "serve"}
"""Where a verb is that has no module of its own name."""
SETTINGS = {"help_option_names": ["-h", "--help"], "show_default": True}


def _show_version(ctx: click.Context, _: click.Parameter, is_asked: bool) -> None:
    if is_asked and not ctx.resilient_parsing:
        click.echo(f"halfseen, version {__version__}")
        ctx.exit()


@click.group(cls=VerbGroup, verbs=VERBS, modules=MODULES, context_settings=SETTINGS)
@click.option(
    "--version", is_flag=True, expose_value=False, is_eager=True, callback=_show_version, help="Show the version."
)
def halfseen() -> None:
    """Learn when to pick, when to look and when to stop, from cut logs and half-hidden views."""


def main() -> None:
    """Run the command line; bad input is told in one line and ends with exit status 2."""
    # A verb loads much that it keeps: looking for garbage as often as Python does takes a tenth of its time.
    gc.set_threshold(100_000, 50, 100)
    # BLAS reads it once, as it loads. What a verb computes is in one thread anyway; others would be begun, and wait.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        with warnings.catch_warnings():
            _say_in_one_line()
            halfseen(standalone_mode=False)
    except click.exceptions.NoArgsIsHelpError as error:
        click.echo(error.format_message())
    except (click.Abort, KeyboardInterrupt):
        click.echo("halfseen: stopped", err=True)
        sys.exit(130)
    except Exception as error:
        refusal = _refusal(error)
        if refusal is None:
            raise
        tell_error(refusal)
        sys.exit(2)


def _refusal(error: Exception) -> str | None:
    """What a command is refused for; None for a defect."""
    if isinstance(error, HalfseenError):
        return str(error)
    if isinstance(error, click.NoSuchOption):
        return _of_option(error)
    if isinstance(error, click.ClickException):
        return error.format_message()
    if isinstance(error, ModuleNotFoundError):
        return remedy(error, next((word for word in sys.argv[1:] if word in VERBS), None))
    return unexpected(error)


def _say_in_one_line() -> None:
    """Let warnings that are meant for users read like all else.

    What libraries say to one another concerns no user, but where one asks for it, as by PYTHONWARNINGS or Python's -W.
    """
    usual = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        if issubclass(category, HalfseenWarning):
            tell_warning(str(message))
        elif sys.warnoptions:
            usual(message, category, *where, **more)

    warnings.showwarning = show


def _of_option(error: click.NoSuchOption) -> str:
    """Say which option there is instead of one that is not there."""
    params = [] if error.ctx is None else error.ctx.command.get_params(error.ctx)
    known = [name for param in params for name in (*param.opts, *param.secondary_opts) if name.startswith("--")]
    ending = did_you_mean(error.option_name, known) or "; --help lists those that there are"
    return f"there is no option {error.option_name}{ending}"
