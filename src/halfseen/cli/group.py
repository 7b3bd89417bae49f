"""A group of verbs: it loads one only when that is called, and knows what was meant by one that does not exist."""

from collections.abc import Mapping
from importlib import import_module
from typing import Any

import click
from click.shell_completion import CompletionItem

from halfseen.errors import did_you_mean
from halfseen.progress import Telling, telling


def _show_progress(ctx: click.Context, _: click.Parameter, is_quiet: bool) -> None:
    """Set for as long as the command runs what its progress shows."""
    if is_quiet:
        ctx.with_resource(telling(Telling.NOTHING))
    elif ctx.parent is None:
        ctx.with_resource(telling(Telling.LINES))


def _with_quiet(command: click.Command) -> click.Command:
    """Give a command ``--quiet``, which every one takes."""
    if all("--quiet" not in param.opts for param in command.params):
        how: Any = {"is_flag": True, "expose_value": False, "callback": _show_progress}
        command.params.append(click.Option(["-q", "--quiet"], help="Show no progress.", **how))
    return command


class VerbGroup(click.Group):
    """A group that imports a command's file when that command is called, so that ``--help`` stays instant.

    Parameters
    ----------
    verbs
        Sentence of each verb, by its name.
    modules
        Where a verb is that has no module of its own name; each holds a command that is called like the verb.
    """

    def __init__(self, *args: Any, verbs: Mapping[str, str], modules: Mapping[str, str], **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self.verbs, self._modules = verbs, modules
        _with_quiet(self)

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Names in the order of ``--help``."""
        return list(self.verbs)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Load a verb; None if there is none of this name."""
        if cmd_name not in self.verbs:
            return None
        return _with_quiet(getattr(import_module(f"halfseen.cli.{self._modules.get(cmd_name, cmd_name)}"), cmd_name))

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the verb that is called, or say which may have been meant."""
        name = args[0]
        if name not in self.verbs and name[:1].isalnum():
            where = f" of {ctx.info_name}" if ctx.parent else ""
            there = f"there are {', '.join(self.verbs)}{did_you_mean(name, self.verbs)}"
            ctx.fail(f"{name}: there is no such command{where}; {there}")
        return super().resolve_command(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write what each verb does, without loading it."""
        with formatter.section("Commands"):
            formatter.write_dl(list(self.verbs.items()))

    def shell_complete(self, ctx: click.Context, incomplete: str) -> list[CompletionItem]:
        """Complete names of verbs, and options; no verb is loaded for that."""
        verbs = [
            CompletionItem(name, help=sentence) for name, sentence in self.verbs.items() if name.startswith(incomplete)
        ]
        return [*verbs, *click.Command.shell_complete(self, ctx, incomplete)]
