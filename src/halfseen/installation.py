"""How this halfseen was installed: its version, and what adds an extra to it."""

import json
import shlex
import shutil
import sys
from importlib import metadata
from pathlib import Path

UNKNOWN = "0.0.0.dev0"
"""Version where nobody knows it: a source folder that runs without having been installed."""


def version() -> str:
    """Version of what is installed; a clone has that of the commit from which it was installed."""
    try:
        return metadata.version("halfseen")
    except metadata.PackageNotFoundError:
        return UNKNOWN


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


def _pip() -> str:
    """Name the pip that installs for this Python."""
    found = shutil.which("pip")
    is_ours = found is not None and Path(found).parent == Path(sys.executable).parent
    return "pip" if is_ours else f"{shlex.quote(sys.executable)} -m pip"


def _clone() -> Path | None:
    """Folder of the clone that runs here; None for a wheel."""
    try:
        told = metadata.distribution("halfseen").read_text("direct_url.json")
    except metadata.PackageNotFoundError:
        folder = Path(__file__).parents[2]
        return folder if (folder / "pyproject.toml").is_file() else None
    origin = json.loads(told or "{}")
    if not origin.get("dir_info", {}).get("editable"):
        return None
    # It loads all of HTTP, which nobody who is not told what to install need wait for.
    from urllib.parse import urlsplit
    from urllib.request import url2pathname

    return Path(url2pathname(urlsplit(origin["url"]).path))
