"""Many cases, by worker processes that are replaced when they hang, die or grow."""

import os
import queue
import signal
import tempfile
from collections.abc import Callable, Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
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
    """A process that runs cases, and what is known of it."""

    def __init__(self, place: Path) -> None:
        cache = TESTS.parent / "runs" / "fuzz" / "cache"
        cache.mkdir(parents=True, exist_ok=True)
        descriptor, self._log = tempfile.mkstemp(dir=place)
        os.close(descriptor)
        self._talk, theirs = SPAWN.Pipe()
        self._process = SPAWN.Process(target=worker.main, args=(theirs, place, cache, self._log))
        self._process.start()
        theirs.close()
        self.num_cases = 0
        self.said(LOAD_S)

    def ask(self, order: Mapping[str, Any]) -> None:
        self.num_cases += 1
        with suppress(OSError):
            self._talk.send(order)

    def said(self, limit_s: float) -> Any:
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
        said = Path(self._log).read_text(errors="replace")[-3000:]
        os.unlink(self._log)
        return f"exit status {status}: {said}"


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
        asked, folder = None, place / f"case-{number}"
        while not waiting.empty():
            with suppress(queue.Empty):
                order = waiting.get_nowait()
                asked = asked or Worker(place)
                asked.ask({**order, "folder": folder, "corpus": corpus})
                result, is_over = _result_of(asked, order, limit_s)
                if is_over or asked.num_cases >= MOST_CASES:
                    said, asked = asked.end(), None
                    if result.label == "fault: crash":
                        last = worker.last_words(folder).read_text(errors="replace")[-3000:] if result.case else ""
                        result = replace(result, why=said + last)
                results.append(result)
                on_each(result)
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


def _result_of(asked: Worker, order: Mapping[str, Any], limit_s: float) -> tuple[Result, bool]:
    """What came of an order, and whether the worker is done for."""
    name = str(order.get("number", Path(order.get("file", "")).name))
    case = asked.said(LOAD_S)
    if not case:
        return Result(name, None, "fault: crash", "in the making", LOAD_S), True
    told = asked.said(limit_s)
    lost = Outcome(None, seconds=limit_s, death="hang" if told is None else "crash")
    outcome, answer, is_spent = told or (lost, None, True)
    label, why = judged(case, outcome, answer)
    return Result(name, case, label, why, outcome.seconds), is_spent
