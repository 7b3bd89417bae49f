"""How this halfseen was installed, and the command that adds an extra."""

import json
import shlex
import shutil
import sys
from importlib import import_module, metadata
from pathlib import Path
from types import ModuleType

from halfseen.errors import ArgumentError


def command_for(extra: str) -> str:
    """Return the command that installs an extra for the running Python.

    Parameters
    ----------
    extra
        Name of an extra of halfseen.

    Returns
    -------
    str
        ``pip install 'halfseen[NAME]'``, which adds to the present installation, or ``pip install -e 'CLONE[NAME]'``.
        A pip that is not the first on the PATH is called as a module of this Python.
    """
    clone = _clone()
    what = shlex.quote(f"{clone or 'halfseen'}[{extra}]")
    return f"{_pip()} install {'' if clone is None else '-e '}{what}"


def extra(module: str, name: str) -> ModuleType:
    """Import a module of the optional library that an extra of halfseen installs.

    Raises
    ------
    ArgumentError
        It is not installed.
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise ArgumentError(f"{module} cannot be imported ({error}); run: {command_for(name)}") from error


def _pip() -> str:
    """Return the pip command that installs for this Python."""
    found = shutil.which("pip")
    is_ours = found is not None and Path(found).parent == Path(sys.executable).parent
    return "pip" if is_ours else f"{shlex.quote(sys.executable)} -m pip"


def _clone() -> Path | None:
    """Folder of the clone that is running; None for a wheel."""
    try:
        record = metadata.distribution("halfseen").read_text("direct_url.json")
    except metadata.PackageNotFoundError:
        folder = Path(__file__).parents[2]
        return folder if (folder / "pyproject.toml").is_file() else None
    origin = json.loads(record or "{}")
    if not origin.get("dir_info", {}).get("editable"):
        return None
    # It loads all of HTTP, which only this message needs.
    from urllib.parse import urlsplit
    from urllib.request import url2pathname

    return Path(url2pathname(urlsplit(origin["url"]).path))
