"""Pieces of work, made by processes of this machine or by a cluster: what comes out is the same bytes.

Read down: `workers` (who makes them) → `pool` (the pieces, streamed, and made again where a worker was lost) → `piece`
(what a worker does with one), on an
`engine`: `processes`, or a cluster's tasks (`task_backend`: `on_ray`, `on_dask`).
"""

from halfseen.workers.pool import Pool
from halfseen.workers.workers import ENGINES, Workers, num_cores

__all__ = ["ENGINES", "Pool", "Workers", "num_cores"]
