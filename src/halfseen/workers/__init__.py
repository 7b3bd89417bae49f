"""Pieces of work, made by processes of this machine or by a cluster: what comes out is the same bytes.

Read down: `workers` (who makes them) → `pool` (the pieces, streamed, and made again where a worker was lost) →
`engines` (processes of this machine, or a cluster's tasks).
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.workers.pool import Pool
    from halfseen.workers.workers import ALONE, Workers

ENGINES = ("processes", "ray", "dask")
"""What may run workers, by name."""

__all__ = ["ALONE", "ENGINES", "Pool", "Workers"]

__getattr__ = lazy_names(__name__, {"ALONE": "workers", "Pool": "pool", "Workers": "workers"})
