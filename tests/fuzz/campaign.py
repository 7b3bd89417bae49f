"""Many cases, by worker processes that are replaced when they hang, die or grow."""

import os
import queue
import signal
import tempfile
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from fuzz import worker
from fuzz.cases import Case, drawn, kept
from fuzz.oracle import Outcome, judged

TESTS = Path(__file__).parents[1]
KEPT = Path(__file__).parent / "kept"
MOST_CASES = 500
"""That one process runs: what libraries keep is kept by a process for ever."""
LOAD_S = 300.0
SPAWN = get_context("spawn")


@dataclass(frozen=True)
class Result:
    """What came of a case: ``refused``, ``right``, or a fault; None for one whose input could not even be made."""

    name: str
    case: Case | None
    label: str
    why: str
    seconds: float

    @property
    def of(self) -> str:
        """Name of its valid input."""
        return "?" if self.case is None else self.case.seed

    @property
    def is_fault(self) -> bool:
        """Whether something is to be mended."""
        return self.label.startswith("fault")


class Worker:
    """A process that runs cases in a folder of its own, and what is known of it."""

    def __init__(self, folder: Path, corpus: Path) -> None:
        self._folders = {"folder": folder, "corpus": corpus}
        cache = TESTS.parent / "runs" / "fuzz" / "cache"
        cache.mkdir(parents=True, exist_ok=True)
        descriptor, self._log = tempfile.mkstemp(dir=folder.parent)
        os.close(descriptor)
        self._talk, theirs = SPAWN.Pipe()
        self._process = SPAWN.Process(target=worker.main, args=(theirs, folder.parent, cache, self._log))
        self._process.start()
        theirs.close()
        self._num_cases, self.is_spent = 0, False
        self._said(LOAD_S)

    def result_of(self, order: Mapping[str, Any], limit_s: float) -> Result:
        """Run a case."""
        self._num_cases += 1
        with suppress(OSError):
            self._talk.send({**order, **self._folders})
        name, case = str(order.get("number", Path(order.get("file", "")).name)), self._said(LOAD_S)
        reply = self._said(limit_s) if case else ()
        outcome, answer, self.is_spent = reply or (None, None, True)
        self.is_spent |= self._num_cases >= MOST_CASES
        if not case:
            return Result(name, None, "fault: crash", f"in the making: {self.end()}", LOAD_S)
        outcome = outcome or Outcome(None, seconds=limit_s, death="hang" if reply is None else "crash")
        label, why = judged(case, outcome, answer)
        if outcome.death == "crash":
            why = self.end() + worker.last_words(self._folders["folder"]).read_text(errors="replace")[-3000:]
        return Result(name, case, label, why, outcome.seconds)

    def _said(self, limit_s: float) -> Any:
        """What it says next; nothing where the process died, None where the time is up."""
        if not self._talk.poll(limit_s):
            return None
        try:
            return self._talk.recv()
        except (EOFError, OSError):
            return ()

    def end(self) -> str:
        """End the process, whatever it does; how it ended, if it did, and the last of what it said to nobody."""
        self._process.join(0.1)
        status = self._process.exitcode
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.join()
        self._talk.close()
        with suppress(FileNotFoundError):
            said = Path(self._log).read_text(errors="replace")[-3000:]
            os.unlink(self._log)
            return f"exit status {status}: {said}"
        return ""


def run(
    orders: Iterable[Mapping[str, Any]],
    place: Path,
    num_workers: int = 1,
    limit_s: float = 30.0,
    on_each: Callable[[Result], object] = lambda result: None,
) -> list[Result]:
    """Run cases in a folder, where the valid inputs stay, each for so many seconds at most.

    An order is the seed and the number of a case, or the file of one that was kept.
    """
    corpus = place / "corpus"
    corpus.mkdir(parents=True, exist_ok=True)
    waiting: queue.SimpleQueue[Any] = queue.SimpleQueue()
    results: list[Result] = []
    for order in orders:
        waiting.put(order)

    def work(number: int) -> None:
        asked = None
        with suppress(queue.Empty):
            while True:
                order = waiting.get_nowait()
                asked = asked or Worker(place / f"case-{number}", corpus)
                results.append(asked.result_of(order, limit_s))
                on_each(results[-1])
                if asked.is_spent:
                    asked.end()
                    asked = None
        if asked is not None:
            asked.end()

    with ThreadPoolExecutor(num_workers) as threads:
        list(threads.map(work, range(num_workers)))
    return sorted(results, key=lambda result: (len(result.name), result.name))


def numbered(seed: int, numbers: Iterable[int], has_heavy: bool = True) -> list[dict[str, Any]]:
    """Orders of cases of a seed."""
    return [{"seed": seed, "number": number, "has_heavy": has_heavy} for number in numbers]


def saved(seed: int, number: int, place: Path, has_heavy: bool = True) -> str:
    """The file of a case of a seed: it is drawn again."""
    with tempfile.TemporaryDirectory(dir=place) as folder:
        case = drawn(seed, number, place / "corpus", Path(folder), has_heavy)
        return kept(case, Path(folder), place / "corpus")
