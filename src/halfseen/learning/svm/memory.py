"""Refuse a kernel matrix that the memory cannot hold, before it is asked for."""

from pathlib import Path

import psutil

from halfseen.errors import ArgumentError

BYTES_A_NUMBER = 8

MOST_LANDMARKS_ADVISED = 1000
"""More landmarks rarely change a fit, and their cost grows with the square."""

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
        Free memory [B]; None asks the machine.

    Raises
    ------
    ArgumentError
        They don't fit; the message says how many landmarks would.
    """
    free = free_bytes() if available_bytes is None else available_bytes
    needed = BYTES_A_NUMBER * num_buffers * num_rows**2
    if needed <= free:
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


def free_bytes() -> int:
    """Memory that can be taken without swapping [B], by the machine and by the container's limit."""
    available = psutil.virtual_memory().available
    # Inside a container, the machine's memory is told, not the container's.
    limit = CONTAINER_LIMIT.read_text().strip() if CONTAINER_LIMIT.exists() else "max"
    return available if limit == "max" else min(available, int(limit))


def _told(num_bytes: int) -> str:
    for unit, size in (("GB", 1e9), ("MB", 1e6)):
        if num_bytes >= size:
            return f"{num_bytes / size:.3g} {unit}" if num_bytes < 1000 * size else f"{num_bytes / size:,.0f} {unit}"
    return f"{num_bytes / 1e3:.3g} kB"
