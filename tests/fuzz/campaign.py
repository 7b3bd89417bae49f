"""Many cases, by worker processes that are replaced when they hang, die or grow."""

import json
import os
import queue
import signal
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from fuzz.cases import Case, drawn, kept
from fuzz.oracle import Outcome, judged
from fuzz.worker import last_words

TESTS = Path(__file__).parents[1]
KEPT = Path(__file__).parent / "kept"
MOST_CASES = 500
"""That one process runs: what JAX compiled is kept by a process for ever."""
LOAD_S = 300.0


@dataclass(frozen=True)
class Result:
    """What came of a case."""

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
        known = {name: value for name, value in os.environ.items() if not name.startswith(("JAX_", "XLA_"))}
        paths = os.pathsep.join([str(TESTS), str(TESTS.parent / "src"), *filter(None, [known.get("PYTHONPATH")])])
        self._log = tempfile.TemporaryFile()  # noqa: SIM115
        self._process = subprocess.Popen(
            [sys.executable, "-m", "fuzz.worker"],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._log,
            # MuJoCo asks once a process for its way to draw, and here verbs that draw come after others that do not.
            env={**known, "PYTHONPATH": paths, "XDG_CACHE_HOME": str(cache), "MUJOCO_GL": "egl"},
            cwd=place,
            start_new_session=True,
        )
        self._lines: queue.SimpleQueue[bytes] = queue.SimpleQueue()
        self._hears = threading.Thread(target=self._hear, daemon=True)
        self._hears.start()
        self.num_cases = 0
        self.said(LOAD_S)

    def ask(self, order: Mapping[str, Any]) -> None:
        self.num_cases += 1
        self._process.stdin.write(json.dumps(order).encode() + b"\n")
        self._process.stdin.flush()

    def said(self, limit_s: float) -> dict[str, Any] | None:
        """The next line; nothing where the process died, None where the time is up."""
        try:
            line = self._lines.get(timeout=limit_s)
        except queue.Empty:
            return None
        return json.loads(line) if line else {}

    def end(self) -> str:
        """End the process, whatever it does; how it ended, if it did, and the last of what it said to nobody."""
        status = self._process.poll()
        with suppress(ProcessLookupError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self._hears.join()
        for stream in (self._process.stdin, self._process.stdout):
            with suppress(BrokenPipeError):
                stream.close()
        self._log.seek(0)
        with self._log as log:
            return f"exit status {status}: {log.read().decode(errors='replace')[-3000:]}"

    def _hear(self) -> None:
        for line in self._process.stdout:
            self._lines.put(line)
        self._lines.put(b"")


def run(
    orders: Iterable[Mapping[str, Any]],
    place: Path,
    num_workers: int = 1,
    limit_s: float = 30.0,
    on_each: Callable[[Result], object] = lambda result: None,
) -> list[Result]:
    """Run cases."""
    corpus = place / "corpus"
    corpus.mkdir(parents=True, exist_ok=True)
    waiting: queue.SimpleQueue[Any] = queue.SimpleQueue()
    results: list[Result] = []
    lock = threading.Lock()
    for order in orders:
        waiting.put(order)

    def work(number: int) -> None:
        worker = None
        while True:
            try:
                order = waiting.get_nowait()
            except queue.Empty:
                break
            if worker is None:
                worker = Worker(place)
            folder = place / f"case-{number}"
            worker.ask({**order, "folder": str(folder), "corpus": str(corpus)})
            result, is_over = _result_of(worker, order, limit_s)
            if is_over or worker.num_cases >= MOST_CASES:
                said = worker.end()
                if result.label == "fault: crash":
                    said += last_words(folder).read_text(errors="replace")[-3000:] if result.case else ""
                    result = Result(result.name, result.case, result.label, said, result.seconds)
                worker = None
            with lock:
                results.append(result)
                on_each(result)
        if worker is not None:
            worker.end()

    threads = [threading.Thread(target=work, args=(number,)) for number in range(num_workers)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return sorted(results, key=lambda result: (len(result.name), result.name))


def numbered(seed: int, numbers: Iterable[int], has_heavy: bool = True) -> list[dict[str, Any]]:
    """Orders of cases of a seed."""
    return [{"seed": seed, "number": number, "has_heavy": has_heavy} for number in numbers]


def saved(seed: int, number: int, place: Path, has_heavy: bool = True) -> str:
    """The file of a case of a seed: it is drawn again."""
    with tempfile.TemporaryDirectory(dir=place) as folder:
        case = drawn(seed, number, place / "corpus", Path(folder), has_heavy)
        return kept(case, Path(folder), place / "corpus")


def _result_of(worker: Worker, order: Mapping[str, Any], limit_s: float) -> tuple[Result, bool]:
    """What came of an order, and whether the worker is done for."""
    name = str(order.get("number", Path(order.get("file", "")).name))
    told = worker.said(LOAD_S)
    if not told:
        return Result(name, None, "fault: crash", "in the making", LOAD_S), True
    case = Case(**{key: tuple(value) if isinstance(value, list) else value for key, value in told["case"].items()})
    told = worker.said(limit_s)
    if not told:
        outcome, answer = Outcome(None, seconds=limit_s, death="hang" if told is None else "crash"), None
    else:
        told_of = told["outcome"]
        outcome = Outcome(**{key: tuple(value) if isinstance(value, list) else value for key, value in told_of.items()})
        answer = told["answer"]
    label, why = judged(case, outcome, answer)
    return Result(name, case, label, why, outcome.seconds), not told or told["is_spent"]
