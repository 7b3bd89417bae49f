"""A process that makes and runs one case after another, spoken to through a pipe."""

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
from pathlib import Path
from typing import Any
from unittest.mock import patch

from fuzz.cases import INPUT, Case, drawn, remade
from fuzz.corpus import SEEDS, made
from fuzz.oracle import Outcome

MOST_MORE = 8 * 10**9
"""Bytes of private memory that a case may ask for beyond what the process has: the machine is spared."""
MOST_KEPT_MB = 3500.0
"""Memory that a process may keep of its cases; then another one takes its place."""


def main(orders: Any, place: Path, cache: Path, log: str) -> None:
    """Take orders until they end: each names a case; said is when it was made, and what came of it."""
    os.setsid()
    os.chdir(place)
    # MuJoCo asks once a process for its way to draw, and here verbs that draw come after others that do not.
    os.environ.update(XDG_CACHE_HOME=str(cache), MUJOCO_GL="egl")
    for descriptor, file in ((0, os.devnull), (1, os.devnull), (2, log)):  # what makes an input may talk
        os.dup2(os.open(file, os.O_RDWR), descriptor)
    # What a process of its own would have; what verbs import stays from case to case.
    warnings.simplefilter("default")
    rest_mb = _memory_mb("VmData")
    resource.setrlimit(resource.RLIMIT_DATA, (int(rest_mb * 1e6) + MOST_MORE, resource.RLIM_INFINITY))
    orders.send("ready")
    while True:
        try:
            order = orders.recv()
        except EOFError:
            return
        folder, corpus = order["folder"], order["corpus"]
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        if "file" in order:
            case = remade(Path(order["file"]), corpus, folder)
        else:
            case = drawn(order["seed"], order["number"], corpus, folder, order["has_heavy"])
        answer = None if case.line is None else answer_to(case, corpus)
        orders.send(case)
        outcome = ran(case.words, folder)
        orders.send((outcome, answer, _memory_mb("VmData") > rest_mb + MOST_KEPT_MB))
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
    report = cli.unexpected

    def noted(error: BaseException) -> str | None:
        caught.append("".join(traceback.format_exception(error)))
        return report(error)

    before, rest_mb = _seen(folder), _memory_mb("VmRSS")
    Path("/proc/self/clear_refs").write_text("5")  # the peak is forgotten
    sys.argv = ["halfseen", *words]
    os.chdir(folder)
    status: Any = 0
    raised, began = "", time.monotonic()
    # Where the process dies, what it said last is read by who asked.
    with tempfile.TemporaryFile() as out, last_words(folder).open("w+b") as err:
        patches = patch.object(tempfile, "tempdir", str(folder)), patch.object(cli, "unexpected", noted)
        with _into(1, out), _into(2, err), patches[0], patches[1]:
            try:
                cli.main()
            except SystemExit as stop:
                status = stop.code or 0
            except BaseException:
                status, raised = 1, traceback.format_exc()
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


def _read(file: Any) -> str:
    file.seek(0)
    return file.read(10**6).decode("utf-8", "backslashreplace")


def _seen(folder: Path) -> dict[str, tuple[Any, ...]]:
    """What is in a folder, by name: kind, size and time of the last change."""
    seen = {}
    for place in folder.rglob("*"):
        found = place.lstat()
        is_folder = place.is_dir() and not place.is_symlink()
        size = () if is_folder else (found.st_size, found.st_mtime_ns)
        seen[str(place.relative_to(folder))] = (found.st_mode, found.st_ino, *size)
    return seen


def _memory_mb(key: str) -> float:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(f"{key}:")) / 1e3
