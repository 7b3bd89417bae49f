"""How this halfseen was installed, and what adds an extra to it."""

import json
import shlex
import shutil
import sys
from importlib import import_module, metadata
from pathlib import Path
from types import ModuleType

from halfseen.errors import ArgumentError


def command_for(extra: str) -> str:
    """Say what to type so that an extra is there, too, for the Python that runs this.

    Parameters
    ----------
    extra
        Name of an extra of halfseen.

    Returns
    -------
    str
        ``pip install 'halfseen[NAME]'``, which adds to what is installed already, or ``pip install -e 'CLONE[NAME]'``.
        A pip that is not the first on the trajectory is called as a module of this Python.
    """
    clone = _clone()
    what = shlex.quote(f"{clone or 'halfseen'}[{extra}]")
    return f"{_pip()} install {'' if clone is None else '-e '}{what}"


def extra(module: str, name: str) -> ModuleType:
    """Import a module of the optional library that halfseen's extra of a name brings.

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
    """Name the pip that installs for this Python."""
    found = shutil.which("pip")
    is_ours = found is not None and Path(found).parent == Path(sys.executable).parent
    return "pip" if is_ours else f"{shlex.quote(sys.executable)} -m pip"


def _clone() -> Path | None:
    """Folder of the clone that runs here; None for a wheel."""
    try:
        record = metadata.distribution("halfseen").read_text("direct_url.json")
    except metadata.PackageNotFoundError:
        folder = Path(__file__).parents[2]
        return folder if (folder / "pyproject.toml").is_file() else None
    origin = json.loads(record or "{}")
    if not origin.get("dir_info", {}).get("editable"):
        return None
    # It loads all of HTTP, which nobody who is not told what to install need wait for.
    from urllib.parse import urlsplit
    from urllib.request import url2pathname

    return Path(url2pathname(urlsplit(origin["url"]).path))
