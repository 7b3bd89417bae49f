"""Refuse a kernel matrix that the memory cannot hold, before it is asked for."""

import os
from pathlib import Path

from halfseen.errors import ArgumentError

BYTES_A_NUMBER = 8

MOST_LANDMARKS_ADVISED = 1000
"""More landmarks rarely change a fit, and their cost grows with the square."""

MEMINFO = Path("/proc/meminfo")
CONTAINER_LIMIT = Path("/sys/fs/cgroup/memory.max")


def check_gram_fits(num_rows: int, num_buffers: int = 3, available_bytes: int | None = None) -> None:
    """Refuse n × n matrices that would not fit in the free memory.

    Parameters
    ----------
    num_rows
        n.
    num_buffers
        Matrices of n × n that are held at once: the Gram matrix, and what the solver needs on top.
    available_bytes
        Free memory [B]; None asks the machine, and nothing is refused where it does not tell.

    Raises
    ------
    ArgumentError
        They don't fit; the message says how many landmarks would.
    """
    free = free_bytes() if available_bytes is None else available_bytes
    needed = BYTES_A_NUMBER * num_buffers * num_rows**2
    if free is None or needed <= free:
        return
    landmarks = advised_landmarks(num_rows, free)
    low_rank = f"num_landmarks={landmarks} (a low-rank kernel, {_told(BYTES_A_NUMBER * num_rows * landmarks)}), or "
    raise ArgumentError(
        f"the kernel matrix of {num_rows:,} rows takes {_told(needed)} and {_told(free)} are free; "
        f"give {low_rank if landmarks else ''}kernel='linear'"
    )


def advised_landmarks(num_rows: int, available_bytes: int) -> int:
    """Landmarks whose features take at most half of the memory, one digit and zeros, at most 1000; 0 where none fits.

    Parameters
    ----------
    num_rows
        Rows whose features are held.
    available_bytes
        Free memory [B].
    """
    most = min(MOST_LANDMARKS_ADVISED, num_rows, available_bytes // (2 * BYTES_A_NUMBER * max(num_rows, 1)))
    if most < 1:
        return 0
    unit = 10 ** (len(str(most)) - 1)
    return int(most // unit * unit)


def free_bytes() -> int | None:
    """Memory that can be taken without swapping [B], or None where the system does not tell."""
    limits = [limit for limit in (_available_in_meminfo(), _container_limit()) if limit is not None]
    return min(limits) if limits else _physical_bytes()


def _available_in_meminfo() -> int | None:
    if not MEMINFO.exists():
        return None
    for line in MEMINFO.read_text().splitlines():
        name, _, value = line.partition(":")
        if name == "MemAvailable":
            return int(value.split()[0]) * 1024
    return None


def _container_limit() -> int | None:
    # Inside a container, meminfo tells of the whole machine.
    limit = CONTAINER_LIMIT.read_text().strip() if CONTAINER_LIMIT.exists() else "max"
    return None if limit == "max" else int(limit)


def _physical_bytes() -> int | None:
    try:
        return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, ValueError, OSError):
        return None


def _told(num_bytes: int) -> str:
    for unit, size in (("GB", 1e9), ("MB", 1e6)):
        if num_bytes >= size:
            return f"{num_bytes / size:.3g} {unit}" if num_bytes < 1000 * size else f"{num_bytes / size:,.0f} {unit}"
    return f"{num_bytes / 1e3:.3g} kB"
