"""Valid inputs by name, each with command lines that read it; the project's own writers make them.

A command line names its input ``in/…`` and what it writes ``out…``, below the folder in which it runs.
"""

import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

CLOUDS, LOGS, HEAVY, OTHERS = "clouds", "logs", "heavy", "others"
ONE = "--out out --json"
INSPECTED = ("inspect in/logs --json", "inspect in/logs", "convert in/logs --out csv:out --json")
MAPPED = "--mapping in/cell.toml --out out"
LEARN = "learn in/logs --out out --no-verdict --workers 1"


@dataclass(frozen=True)
class Seed:
    """A valid input and what is done with it."""

    name: str
    kind: str
    make: Callable[[Path], object]
    lines: tuple[str, ...]

    @property
    def is_heavy(self) -> bool:
        """Whether making or reading it learns."""
        return self.kind == HEAVY


SEEDS: dict[str, Seed] = {}


def seed(kind: str, *lines: str, name: str = "") -> Callable[[Callable[[Path], object]], Callable[[Path], object]]:
    """Name what makes an input, and the command lines that read it."""

    def noted(make: Callable[[Path], object]) -> Callable[[Path], object]:
        called = name or getattr(make, "__name__", "").replace("_", "-")
        SEEDS[called] = Seed(called, kind, make, lines)
        return make

    return noted


def of_kind(*kinds: str) -> tuple[Seed, ...]:
    return tuple(each for each in SEEDS.values() if each.kind in kinds)


def made(seed: Seed, corpus: Path) -> Path:
    """The folder of a valid input, made where it is not there yet; several processes may ask at once."""
    folder = corpus / seed.name
    if not folder.exists():
        fresh = Path(tempfile.mkdtemp(dir=corpus))
        seed.make(fresh)
        try:
            fresh.rename(folder)
        except OSError:  # another process was faster
            shutil.rmtree(fresh)
    return folder
