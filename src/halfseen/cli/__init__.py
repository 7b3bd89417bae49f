"""The command line: one module for each verb or family of verbs, with heavy imports only inside commands."""

import gc
import os
import sys
import warnings
from collections.abc import Mapping
from importlib import import_module
from typing import Any

import click
from click.shell_completion import CompletionItem

from halfseen import __version__
from halfseen.cli.messages import remedy, tell_error, tell_warning, unexpected
from halfseen.errors import HalfseenError, HalfseenWarning, closest, did_you_mean
from halfseen.progress import Verbosity, verbosity

VERBS = {
    "inspect": "Say what a folder of logs holds: trajectories, endings, causes, weights, and what looks wrong.",
    "learn": "Learn a policy from a folder of logs.",
    "evaluate": "Estimate what a policy is worth, from logs of another policy, before it runs.",
    "act": "Decide what to do now, and say why.",
    "serve": "Answer over HTTP what to do now, and record the decisions.",
    "monitor": "Say whether a policy in service keeps its promise, what has changed, and since when.",
    "export": "Write a policy of named actions as ONNX, for controllers without Python.",
    "watch": "Show in the browser what was seen and decided, in 3-D, and why.",
    "report": "Write one page about a folder of logs and a policy.",
    "convert": "Convert logs of other programs: CSV, SQL, bags, MCAP, Minari, LeRobot, RLDS, D4RL.",
    "look": "Say what a depth camera sees on a table, who hides whom, and what looks dirty.",
    "record": "Record logs from a program in any language, as JSON lines.",
    "simulate": "Record logs of a policy in the simulated world, some of them cut.",
    "cell": "Simulate an arm in physics: calibrate its laws, or run a policy.",
    "study": "Regenerate the study: its figures, tables and report.",
}
MODULES = {
    "export": "act",
    "inspect": "report",
    "monitor": "act",
    "record": "serve",
    "study": "simulate",
}
"""Modules of the verbs without a module of their own name."""
SETTINGS = {"help_option_names": ["-h", "--help"], "show_default": True}


def _show_progress(ctx: click.Context, _: click.Parameter, is_quiet: bool) -> None:
    """Set the progress display for the duration of the command."""
    if is_quiet:
        ctx.with_resource(verbosity(Verbosity.NOTHING))
    elif ctx.parent is None:
        ctx.with_resource(verbosity(Verbosity.LINES))


def _with_quiet(command: click.Command) -> click.Command:
    """Add ``--quiet``, which every command takes."""
    if all("--quiet" not in param.opts for param in command.params):
        how: Any = {"is_flag": True, "expose_value": False, "callback": _show_progress}
        command.params.append(click.Option(["-q", "--quiet"], help="Show no progress.", **how))
    return command


class VerbGroup(click.Group):
    """A group that imports a command's file when that command is called, so that ``--help`` stays instant.

    Parameters
    ----------
    verbs
        Sentence of each verb, by name.
    modules
        Modules of the verbs without a module of their own name; each holds a command named like the verb.
    """

    def __init__(self, *args: Any, verbs: Mapping[str, str], modules: Mapping[str, str], **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.verbs, self._modules = verbs, modules
        _with_quiet(self)

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names in the order of ``--help``."""
        return list(self.verbs)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Load a verb; None if its name is unknown."""
        if cmd_name not in self.verbs:
            return None
        return _with_quiet(getattr(import_module(f"halfseen.cli.{self._modules.get(cmd_name, cmd_name)}"), cmd_name))

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the verb; on an unknown name, suggest a similar one."""
        name = args[0]
        if name not in self.verbs and name[:1].isalnum():
            where = f" of {ctx.info_name}" if ctx.parent else ""
            there = f"give one of {', '.join(self.verbs)}{did_you_mean(name, self.verbs)}"
            ctx.fail(f"{name}: unknown command{where}; {there}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the sentence of each verb, without loading it."""
        with formatter.section("Commands"):
            formatter.write_dl(list(self.verbs.items()))

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Complete verb names and options, without loading a verb."""
        verbs = [
            CompletionItem(name, help=sentence) for name, sentence in self.verbs.items() if name.startswith(incomplete)
        ]
        return [*verbs, *click.Command.shell_complete(self, ctx, incomplete)]


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
    """Run the command line; bad input is reported in one line, with exit status 2."""
    # A verb allocates many long-lived objects: garbage collection at Python's default rate takes a tenth of its time.
    gc.set_threshold(100_000, 50, 100)
    # BLAS reads it once, on loading. A verb computes in one thread anyway; other threads would start and idle.
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
    """Message for which a command is refused; None for a defect."""
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
    """Print warnings for users in the usual one-line form.

    Warnings of other libraries are hidden unless the user asks for them, by PYTHONWARNINGS or Python's -W.
    """
    usual = warnings.showwarning

    def show(message: Warning | str, category: type[Warning], *where: Any, **more: Any) -> None:
        if issubclass(category, HalfseenWarning):
            tell_warning(str(message))
        elif sys.warnoptions:
            usual(message, category, *where, **more)

    warnings.showwarning = show


def _of_option(error: click.NoSuchOption) -> str:
    """Message for an unknown option, with a suggestion."""
    params = [] if error.ctx is None else error.ctx.command.get_params(error.ctx)
    names = (name for param in params for name in (*param.opts, *param.secondary_opts))
    name = closest(error.option_name.lstrip("-"), (name[2:] for name in names if name.startswith("--")))
    ending = "--help lists the options" if name is None else f"did you mean '--{name}'?"
    return f"unknown option {error.option_name}; {ending}"
