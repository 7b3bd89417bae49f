"""The engineer's path with the built wheel, in a bare environment and away from the clone: ``make wheel-test``.

First without extras: each verb works, or one line says what to install, and what it says is done. Then with all of them
the commands of the README, in its order. ``python -m release.walk [--wheel WHEEL]``; the environment is of that Python.

``--newest`` (``make newest``) goes the way of the README alone, with the newest of all that is not pinned then, by each
Python that halfseen is for and that is here.
"""

import argparse
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import time
import tomllib
from collections.abc import Iterable
from pathlib import Path
from tempfile import TemporaryDirectory

from release.every_verb import CLONE, Ended, prepare

WITHOUT_EXTRAS = {"inspect", "learn", "evaluate", "act", "record", "convert", "simulate"}
"""Verbs that a plain installation has."""
HINT = re.compile(r"; run: (\S.* install 'halfseen\[[\w-]+\]')\n")


class Bare:
    """An environment with nothing but pip, and a folder with nothing but what an engineer has.

    Parameters
    ----------
    folder
        Where it is made.
    python
        Of which Python it is.
    pins
        Versions that pip keeps to; None for the newest of everything.
    """

    def __init__(
        self, folder: Path, python: str | Path = sys.executable, pins: Path | None = CLONE / "constraints.txt"
    ) -> None:
        self.python, self._folder = folder / "bare" / "bin" / "python", folder
        subprocess.run([python, "-m", "venv", folder / "bare"], check=True)
        # Nothing of the clone but its pins, of this user or of another Python comes in.
        mine = {name: value for name, value in os.environ.items() if not name.startswith(("PYTHON", "HALFSEEN_"))}
        self._env = mine | {"PATH": f"{self.python.parent}{os.pathsep}{os.environ['PATH']}"}
        self._for_pip = self._env if pins is None else self._env | {"PIP_CONSTRAINT": str(pins)}
        self._for_halfseen = self._env | {
            "XDG_CACHE_HOME": str(folder / "cache"),
            "MINARI_DATASETS_PATH": str(folder / "minari"),
        }
        self.begin("own")

    def begin(self, name: str) -> None:
        """Go on in a fresh folder."""
        self._own = self._folder / name
        self._own.mkdir()
        prepare(self._own)

    def pip(self, *words: str | Path) -> None:
        """Install or ask something."""
        self._run([self.python, "-m", "pip", "--quiet", "--disable-pip-version-check", *words], self._for_pip)

    def as_hinted(self, command: str) -> None:
        """Type what a message says."""
        self._run(["sh", "-c", command], self._for_pip)

    def halfseen(self, line: str) -> str:
        """Type a line; what it prints."""
        return self._run(shlex.split(line, comments=True), self._for_halfseen)

    def every_verb(self) -> list[Ended]:
        """Run each verb once."""
        printed = self._run([self.python, CLONE / "release" / "every_verb.py"], self._for_halfseen)
        return [Ended(*each) for each in json.loads(printed)]

    def _run(self, command: list, env: dict[str, str]) -> str:
        begun_s = time.monotonic()
        done = subprocess.run(command, env=env, cwd=self._own, capture_output=True, text=True, check=False)
        words = " ".join(Path(word).name if Path(word).is_absolute() else str(word) for word in command)
        print(f"{time.monotonic() - begun_s:5.1f} s  {words}", flush=True)
        if done.returncode:
            sys.exit(f"{words} ended with {done.returncode}:\n{done.stdout}{done.stderr}")
        return done.stdout


def engineers_path() -> list[str]:
    """Commands of the README that lead from logs to a policy."""
    readme = (CLONE / "README.md").read_text(encoding="utf-8")
    (trajectory,) = (
        block for block in re.findall(r"```sh\n(.*?)```", readme, re.DOTALL) if "halfseen inspect" in block
    )
    return trajectory.replace("\\\n", " ").splitlines()


def faults_without_extras(ended: Iterable[Ended]) -> list[str]:
    """Say which lines neither worked nor said what to install."""
    return [
        f"halfseen {line} ended with {status}: {err}"
        for line, status, err in ended
        if status != 0 and (status != 2 or err.count("\n") != 1 or not HINT.search(err))
    ]


def walk(bare: Bare, wheel: Path) -> None:
    """Install the wheel without and with its extras, and go the ways that each opens."""
    bare.pip("install", "--no-compile", wheel)
    ended = bare.every_verb()
    if faults := faults_without_extras(ended):
        sys.exit("\n".join(faults))
    if missing := WITHOUT_EXTRAS - {each.line.split()[0] for each in ended if each.status == 0}:
        sys.exit(f"these need no extra, and do not work without: {', '.join(sorted(missing))}")
    refused = next(each for each in ended if each.line.startswith("look"))
    bare.as_hinted(HINT.findall(refused.err)[0])
    bare.halfseen(f"halfseen {refused.line}")
    walk_with(bare, wheel, "all")


def walk_with(bare: Bare, wheel: Path, extra: str) -> None:
    """Install the wheel with an extra, and go the way of the README."""
    bare.pip("install", "--no-compile", f"{wheel}[{extra}]")
    bare.pip("check")
    bare.begin("trajectory")
    for line in engineers_path():
        bare.halfseen(line)


def pythons() -> dict[str, str | None]:
    """Path of each Python that halfseen is for, the oldest first; None where it does not run here."""
    project = tomllib.loads((CLONE / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    names = [f"python{each.split()[-1]}" for each in project["classifiers"] if re.search(r":: 3\.\d+$", each)]
    return {name: path if (path := shutil.which(name)) is not None and _is_run(path) else None for name in names}


def _is_run(path: str) -> bool:
    """Whether a Python runs: what stands for one that is not installed ends with an error."""
    return subprocess.run([path, "-c", ""], capture_output=True, check=False).returncode == 0


def walk_newest(wheel: Path) -> None:
    """Go the way of the README by each Python, with the newest of everything."""
    for name, python in pythons().items():
        print(name if python is not None else f"{name} is not here: not tried", flush=True)
        if python is None:
            continue
        with TemporaryDirectory() as folder:
            walk_with(Bare(Path(folder), python, pins=None), wheel, "study")


def main() -> None:
    """Walk with a wheel that is built first, unless one is given."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--wheel", type=Path)
    parser.add_argument("--newest", action="store_true", help="Without pins, by each Python that is here.")
    chosen = parser.parse_args()
    with TemporaryDirectory() as folder:
        bare = Bare(Path(folder))
        if chosen.wheel is None:
            bare.pip("wheel", "--no-deps", "--wheel-dir", Path(folder) / "dist", CLONE)
        (wheel,) = [chosen.wheel] if chosen.wheel else Path(folder).glob("dist/*.whl")
        if chosen.newest:
            walk_newest(wheel.absolute())
        else:
            walk(bare, wheel.absolute())


if __name__ == "__main__":
    main()
