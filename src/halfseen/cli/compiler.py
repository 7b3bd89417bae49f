"""What JAX compiles with, and where what it compiled is kept: the next call of a verb reads it instead of compiling."""

import hashlib
import os
import platform
import shutil
from pathlib import Path

from platformdirs import user_cache_path

SETTINGS = {"XLA_FLAGS": "--xla_backend_optimization_level=1 --xla_cpu_use_fusion_emitters=false", "NPROC": "1"}
"""A verb compiles for longer than it runs: the flags halve that, and what is compiled is as fast. Its arrays are small:
more threads than one would only wait for one another."""

KEPT_IN = "JAX_COMPILATION_CACHE_DIR"
KEPT = {"JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0", "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1"}
"""All is kept: programs are small, and there are many."""

PROGRAMS_IN = "HALFSEEN_PROGRAMS"
"""Where `halfseen.programs` keeps those that verbs wait for, of which JAX need not even make anew what it compiles."""

MOST_BYTES = 100_000_000
"""What is kept is thrown away when it is more than this; what `benchmarks/verbs.py` compiles takes some 5 MB."""

UNREADABLE, UNWRITABLE = (f"Error {doing} persistent compilation cache entry" for doing in ("reading", "writing"))
"""How warnings of JAX begin that say of a kept program that it could not be used, or not be kept."""


def set_compiler() -> None:
    """Set what JAX compiles with and where it keeps that, unless the user has; before anything is compiled."""
    for name, value in SETTINGS.items():
        os.environ.setdefault(name, value)
    if KEPT_IN not in os.environ and (folder := _folder()) is not None:
        os.environ[KEPT_IN] = os.environ[PROGRAMS_IN] = str(folder)
        for name, value in KEPT.items():
            os.environ.setdefault(name, value)


def is_of_kept_programs(warning: str) -> bool:
    """Whether a warning is only about what is kept here; where that cannot be read, as after a kill, it is thrown away.

    Where the user says what is kept where, it concerns the user.
    """
    place = _place()
    if os.environ.get(KEPT_IN) != str(place):
        return False
    if warning.startswith(UNREADABLE):
        shutil.rmtree(place, ignore_errors=True)
    return warning.startswith((UNREADABLE, UNWRITABLE))


def _folder() -> Path | None:
    """Where programs are kept, made if need be; None where none can be, or where others may write.

    What is there is run, so nobody but the user may have written it.
    """
    folder = _place()
    # A user without a home has no cache either.
    if not folder.is_absolute():
        return None
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = folder.stat()
        if hasattr(os, "getuid") and (found.st_uid != os.getuid() or found.st_mode & 0o022):
            return None
        if sum(entry.stat().st_size for entry in os.scandir(folder)) > MOST_BYTES:
            shutil.rmtree(folder)
            folder.mkdir(mode=0o700)
    except OSError:
        return None
    return folder


def _place() -> Path:
    """Of this user, and of machines with these instructions."""
    return user_cache_path("halfseen", appauthor=False) / f"compiled-{_instructions()}"


def _instructions() -> str:
    """Name the instructions that this processor knows."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = [platform.processor()]
    known = next((line for line in lines if line.startswith(("flags", "Features"))), lines[0] if lines else "")
    return f"{platform.machine()}-{hashlib.sha256(known.encode()).hexdigest()[:12]}"
