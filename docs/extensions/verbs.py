"""A page for every verb of the command line, written from the verbs themselves whenever the docs are built.

The pages lie in reference/verbs, which is wholly made here, and kept out of the repository, so that none can be stale.
An extension for click would still want a page in the repository for each verb, so these few lines are our own.
"""

import inspect
import re
import shutil
from pathlib import Path

import click
from sphinx.application import Sphinx

from halfseen.cli import VERBS, halfseen

FOLDER = Path("reference") / "verbs"
EXAMPLE = "Example: "


def pages() -> dict[str, str]:
    """The reST of each page, by its name; the first, ``index``, lists the others."""
    written = {name: page(halfseen.get_command(click.Context(halfseen), name), f"halfseen {name}") for name in VERBS}
    entries = [f"   {name}" for name in VERBS]
    table = [line for name, summary in VERBS.items() for line in (f":doc:`{name}`", f"   {summary}", "")]
    lines = [*title("The command line", "="), *HEAD, *table, ".. toctree::", "   :hidden:", "", *entries]
    return {"index": text(lines)} | {name: text(lines) for name, lines in written.items()}


HEAD = [
    "Every verb has ``--help``, and where a program may read what it finds, ``--json`` prints one object. Results go",
    "to stdout; progress and warnings go to stderr. Bad input gets one line there and exit status 2, and what is",
    "interrupted ends with 130. :doc:`../../guide/installation` says how shells complete verbs and options, and how to",
    "do without progress and colours.",
    "",
]


def page(command: click.Command | None, path: str, underline: str = "=") -> list[str]:
    """Lines about one verb, and about those of a group below it."""
    assert command is not None, path
    ctx = click.Context(command, info_name=path, help_option_names=["-h", "--help"])
    lines = [*title(path, underline), *about(command), ".. code-block:: console", "", f"   $ {usage(command, ctx)}", ""]
    if command.epilog:
        lines += ["Example:", "", ".. code-block:: sh", "", f"   {command.epilog.removeprefix(EXAMPLE)}", ""]
    lines += [f".. program:: {path}", ""]
    for param in command.get_params(ctx):
        if isinstance(param, click.Option):
            lines += option(param, ctx)
    if isinstance(command, click.Group):
        for name in command.list_commands(ctx):
            lines += page(command.get_command(ctx, name), f"{path} {name}", "-")
    return lines


def about(command: click.Command) -> list[str]:
    """What a verb does, in paragraphs."""
    return [*quoted(inspect.cleandoc(command.help or "")).splitlines(), ""]


def usage(command: click.Command, ctx: click.Context) -> str:
    """How a verb is called."""
    return " ".join([ctx.info_name or "", *command.collect_usage_pieces(ctx)])


def option(param: click.Option, ctx: click.Context) -> list[str]:
    """One option: its names, what it takes, what it does, and what it is if nothing is said."""
    takes = "" if param.is_flag else f" {param.make_metavar(ctx)}"
    names = ", ".join(f"{name}{takes}" for name in (*param.opts, *param.secondary_opts))
    _, record = param.get_help_record(ctx) or ("", "")
    more = " May be given more than once." if param.multiple else ""
    return [f".. option:: {names}", "", f"   {' '.join(quoted(record).split())}{more}", ""]


def quoted(words: str) -> str:
    """Write what stands between backticks, and options, as code; nothing else in a help text is markup."""
    words = re.sub(r"`([^`]+)`", r"``\1``", words).replace("*", r"\*")
    return re.sub(r"(?<![\w`\[-])(--[a-z][a-z-]*)(?![`\w])", r"``\1``", words)


def title(words: str, underline: str) -> list[str]:
    """A heading."""
    return [words, underline * len(words), ""]


def text(lines: list[str]) -> str:
    """A file of these lines."""
    return "\n".join(lines).rstrip() + "\n"


def write(app: Sphinx) -> None:
    """Write all pages again; one that did not change keeps its time, so that Sphinx need not read it again."""
    folder, made = Path(app.srcdir) / FOLDER, {f"{name}.rst": page for name, page in pages().items()}
    folder.mkdir(parents=True, exist_ok=True)
    for file in folder.iterdir():
        if file.name not in made:
            shutil.rmtree(file) if file.is_dir() else file.unlink()
    for name, content in made.items():
        file = folder / name
        if not file.exists() or file.read_text(encoding="utf-8") != content:
            file.write_text(content, encoding="utf-8")


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the pages before Sphinx looks which there are."""
    app.connect("builder-inited", write)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
