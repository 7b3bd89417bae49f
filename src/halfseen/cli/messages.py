"""Output: answers on stdout; errors and warnings on stderr, one line each.

On a terminal, the first word of such a line is in colour. Control characters in names and values of a log are escaped.
System errors, lack of memory, deeply nested input and missing libraries are also reported in one line.
"""

import errno
import json
import os
import re
import sys
from collections.abc import Iterable, Mapping
from typing import Any

import click

_UNPRINTABLE = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069\ud800-\udfff]")

MOST_TOLD = 1200  # characters of a line; the middle of a longer one is left out

EXTRAS = {
    "perception": ("lzf", "matplotlib", "plyfile", "pypcd4", "skimage"),
    "scene": ("mujoco",),
    "study": ("jinja2",),
    "watch": ("viser",),
    "onnx": ("onnx",),
    "serve": ("starlette", "uvicorn"),
    "gym": ("gymnasium",),
    "jax": ("jax",),
    "pettingzoo": ("pettingzoo",),
    "minari": ("minari",),
    "excel": ("openpyxl",),
    "hdf5": ("h5py",),
    "mcap": ("mcap", "mcap_protobuf"),
    "ros": ("rosbags",),
    "sql": ("sqlalchemy",),
    "ray": ("ray",),
    "dask": ("distributed",),
    "stores": ("upath",),
    "opcua": ("asyncua",),
}
"""Optional libraries, by the extra that installs them."""
HELD = {
    "opcua": ("serve",),
    "scene": ("perception",),
    "study": ("scene", "perception"),
    "watch": ("scene", "perception"),
}
"""Extras that an extra includes."""
OF_VERB = {"cell": "scene", "report": "study", "study": "study", "watch": "watch"}
"""Extras to suggest for verbs that need several, so that one suggestion is enough."""
_REMEDIES = {
    errno.EACCES: "ask for the right to it, or name another",
    errno.EPERM: "ask for the right to it, or name another",
    errno.EROFS: "give a writable place",
    errno.ENOSPC: "make room, or name another place",
    errno.EDQUOT: "make room, or name another place",
    errno.ENOENT: "check the name",
    errno.ENOTDIR: "give a place whose parents are folders",
    errno.EISDIR: "give a file",
    errno.ENAMETOOLONG: "give a shorter name",
    errno.ELOOP: "fix the link",
    errno.EMFILE: "raise the limit of open files (ulimit -n)",
}


def say(message: str) -> None:
    """Answer on stdout."""
    click.echo(printable(message))


def tally(counts: Mapping[str, int]) -> str:
    """Names with their counts, as text."""
    return ", ".join(f"{name} {count}" for name, count in counts.items()) or "none"


def answer(report: Mapping[str, Any], lines: Iterable[str], as_json: bool) -> None:
    """Answer on stdout: one JSON object for programs, lines for people."""
    say(json.dumps(report, indent=2, allow_nan=False) if as_json else "\n".join(lines))


def printable(text: str) -> str:
    r"""Escape control characters, colours, changes of direction and invalid characters, as ``\x1b``."""
    return _UNPRINTABLE.sub(lambda found: found[0].encode("unicode_escape").decode(), text)


def tell_error(message: str) -> None:
    """Report an error that ends the command."""
    _tell(message, "red")


def tell_warning(message: str) -> None:
    """Report something legal that is probably a mistake."""
    _tell(message, "yellow")


def is_coloured() -> bool:
    """Whether stderr is a colour terminal, and colours are not disabled (https://no-color.org)."""
    return sys.stderr.isatty() and not os.environ.get("NO_COLOR") and os.environ.get("TERM") != "dumb"


def headed(message: str, colour: str) -> str:
    """Format a message as one line with the program's name."""
    head = click.style("halfseen:", fg=colour, bold=True) if is_coloured() else "halfseen:"
    line = printable(" ".join(message.split()))
    return f"{head} {line if len(line) <= MOST_TOLD else f'{line[: MOST_TOLD - 500]} … {line[-500:]}'}"


def _tell(message: str, colour: str) -> None:
    bars = sys.modules.get("tqdm")
    if bars is None:
        click.echo(headed(message, colour), err=True)
    else:  # Print above a progress bar.
        bars.tqdm.write(headed(message, colour), file=sys.stderr)


def unexpected(error: BaseException) -> str | None:
    """Message for an unexpected error, with place and remedy; None for a defect of halfseen."""
    if isinstance(error, OSError):
        return _of_system(error)
    if isinstance(error, MemoryError) or "RESOURCE_EXHAUSTED" in str(error)[:200]:
        asked = (str(error).splitlines() or [""])[0][:200]
        return f"out of memory{f' ({asked})' if asked else ''}; give less at once, or use a machine with more memory"
    if isinstance(error, RecursionError):
        return "the input is nested too deeply to be read; write it with fewer levels"
    return None


def _of_system(error: OSError) -> str:
    names = [os.fsdecode(name) for name in (error.filename, error.filename2) if isinstance(name, str | bytes)]
    where = f"{' → '.join(names)}: " if names else ""
    reason = (error.strerror or str(error) or type(error).__name__).splitlines()[0][:200]
    remedy = _REMEDIES.get(error.errno or 0, "check that it exists and can be read and written")
    return f"{where}{reason[:1].lower()}{reason[1:]}; {remedy}"


def remedy(error: ModuleNotFoundError, verb: str | None = None) -> str | None:
    """Command that installs a missing library; None if no extra includes it."""
    library = (error.name or "").partition(".")[0]
    extra = next((name for name, libraries in EXTRAS.items() if library in libraries), None)
    if extra is None:
        return None
    from halfseen.installation import command_for

    whole = OF_VERB.get(verb or "")
    wanted = whole if whole is not None and extra in HELD.get(whole, ()) else extra
    return f"{library} is not installed, and this command needs it; run: {command_for(wanted)}"
