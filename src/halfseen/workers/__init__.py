"""Work split into pieces, made by processes of this machine or by a cluster; the results are the same bytes.

Read down: `workers` (the choice of workers) → `pool` (streams pieces, and makes those of lost workers again) →
`engines` (processes of this machine, or tasks of a cluster).
"""

from typing import TYPE_CHECKING

from halfseen.lazy import lazy_names

if TYPE_CHECKING:
    from halfseen.workers.pool import Pool
    from halfseen.workers.workers import ALONE, Workers, checked_workers

ENGINES = ("processes", "ray", "dask")
"""The engines that can run workers, by name."""

__all__ = ["ALONE", "ENGINES", "Pool", "Workers", "checked_workers"]

__getattr__ = lazy_names(
    __name__, {"ALONE": "workers", "Pool": "pool", "Workers": "workers", "checked_workers": "workers"}
)
