"""A process that makes and runs one case after another; ``python -m fuzz.worker``, spoken to in JSON lines."""

import json
import os
import resource
import shlex
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Any

from fuzz.cases import INPUT, Case, drawn, remade
from fuzz.corpus import SEEDS, made
from fuzz.oracle import Outcome

MOST_MORE = 8 * 10**9
"""Bytes of private memory that a case may ask for beyond what the process has: the machine is spared."""

MOST_KEPT_MB = 3500.0
"""Memory that a process may keep of its cases; then another one takes its place."""


def main() -> None:
    """Take orders from stdin until it ends: each names a case; said is when it was made, and what came of it."""
    told, orders = os.fdopen(os.dup(1), "w", buffering=1), os.fdopen(os.dup(0))
    for descriptor in (0, 1):  # what makes an input may talk, and a verb may listen
        os.dup2(os.open(os.devnull, os.O_RDWR), descriptor)
    _load()
    rest_mb = _memory_mb("VmData")
    print(json.dumps({"ready": True}), file=told)
    for line in orders:
        order = json.loads(line)
        folder, corpus = Path(order["folder"]), Path(order["corpus"])
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        if "file" in order:
            case = remade(Path(order["file"]), corpus, folder)
        else:
            case = drawn(order["seed"], order["number"], corpus, folder, order["has_heavy"])
        answer = None if case.line is None else answer_to(case, corpus)
        print(json.dumps({"case": asdict(case)}), file=told)
        outcome = ran(case.words, folder)
        is_spent = _memory_mb("VmData") > rest_mb + MOST_KEPT_MB
        print(json.dumps({"outcome": asdict(outcome), "answer": answer, "is_spent": is_spent}), file=told)
        if not order.get("stays"):
            os.chdir("/")
            shutil.rmtree(folder, ignore_errors=True)


def answer_to(case: Case, corpus: Path) -> str:
    """What is said of the unbroken input; kept beside it."""
    kept = corpus / f"{case.seed}.{case.line}.answer"
    if not kept.exists():
        with tempfile.TemporaryDirectory(dir=corpus) as place:
            folder = Path(place) / "case"
            shutil.copytree(made(SEEDS[case.seed], corpus), folder / INPUT)
            outcome = ran(shlex.split(SEEDS[case.seed].lines[case.line or 0]), folder)
            os.chdir("/")
        if outcome.status != 0:
            raise RuntimeError(f"{case.seed}: the unbroken input is refused: {outcome.err} {outcome.traceback}")
        kept.write_text(outcome.out)
    return kept.read_text()


def last_words(folder: Path) -> Path:
    """Where a case that runs in a folder writes to standard error."""
    return folder.with_name(f"{folder.name}.err")


def ran(words: Any, folder: Path) -> Outcome:
    """Run a command line in a folder, and see what it says, takes, changes and leaves."""
    from halfseen import cli

    caught: list[str] = []
    told_of = cli.unforeseen

    def noted(error: BaseException) -> str | None:
        caught.append("".join(traceback.format_exception(error)))
        return told_of(error)

    before, rest_mb = _seen(folder), _memory_mb("VmRSS")
    _forget_peak()
    sys.argv = ["halfseen", *words]
    os.chdir(folder)
    status: Any = 0
    raised, began = "", time.monotonic()
    # Where the process dies, what it said last is read by who asked.
    with tempfile.TemporaryFile() as out, last_words(folder).open("w+b") as err:
        with _into(1, out), _into(2, err), _temporary_files_in(folder):
            cli.unforeseen = noted
            try:
                cli.main()
            except SystemExit as stop:
                status = stop.code or 0
            except BaseException:
                status, raised = 1, traceback.format_exc()
            finally:
                cli.unforeseen = told_of
        seconds, grown_mb = time.monotonic() - began, _memory_mb("VmHWM") - rest_mb
        said = [_read(file) for file in (out, err)]
    after = _seen(folder)
    inputs = {name for name in before | after if name.split("/")[0] == INPUT}
    return Outcome(
        status if isinstance(status, int) else 1,
        *said,
        round(seconds, 3),
        round(grown_mb, 1),
        tuple(sorted(name for name in inputs if before.get(name) != after.get(name))),
        tuple(sorted({name.split("/")[0] for name in after if name not in inputs})),
        traceback=raised,
        netted="".join(caught)[-3000:],
    )


def _load() -> None:
    """Set what a process of its own would have; what verbs import stays from case to case."""
    warnings.simplefilter("default")
    has_bytes = int(_memory_mb("VmData") * 1e6)
    resource.setrlimit(resource.RLIMIT_DATA, (has_bytes + MOST_MORE, resource.RLIM_INFINITY))


@contextmanager
def _into(descriptor: int, file: Any) -> Iterator[None]:
    """Let a descriptor write into a file."""
    stream = (sys.stdout, sys.stderr)[descriptor - 1]
    stream.flush()
    was = os.dup(descriptor)
    os.dup2(file.fileno(), descriptor)
    try:
        yield
    finally:
        try:
            stream.flush()
        finally:
            os.dup2(was, descriptor)
            os.close(was)


@contextmanager
def _temporary_files_in(folder: Path) -> Iterator[None]:
    was = tempfile.tempdir
    tempfile.tempdir = str(folder)
    try:
        yield
    finally:
        tempfile.tempdir = was


def _read(file: Any) -> str:
    file.seek(0)
    return file.read(10**6).decode("utf-8", "backslashreplace")


def _seen(folder: Path) -> dict[str, tuple[Any, ...]]:
    """What is in a folder, by name: kind, size and time of the last change."""
    seen = {}
    for place in folder.rglob("*"):
        found = place.lstat()
        is_folder = place.is_dir() and not place.is_symlink()
        seen[str(place.relative_to(folder))] = (
            found.st_mode,
            found.st_ino,
            *(() if is_folder else (found.st_size, found.st_mtime_ns)),
        )
    return seen


def _memory_mb(key: str) -> float:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(f"{key}:")) / 1e3


def _forget_peak() -> None:
    Path("/proc/self/clear_refs").write_text("5")


if __name__ == "__main__":
    main()
