"""How the tests run: one thread of BLAS a process, and files that take long first."""

import gc
import os

from hypothesis import settings

# How long an example takes depends on what else the machine does. A run tries few of them, always the same, so that a
# change fails for what it changes; the other profile looks for new ones.
settings.register_profile("few", deadline=None, max_examples=20, derandomize=True)
settings.register_profile("many", deadline=None, max_examples=60)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "few"))

# Set before BLAS is loaded, which reads it once; processes that tests start read it too. One test process a core leaves
# a second thread nothing but to wait.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# By default Ray gives way to all other processes: on a busy machine a test would wait minutes for its workers.
os.environ.setdefault("RAY_worker_niceness", "0")

LONG = ("benchmarks", "cell", "docs", "examples", "learning", "planners", "study", "tables")
"""Folders whose files take long: they start first, so that no process is left with one of them at the end."""


def pytest_xdist_auto_num_workers(config):
    """Slow tests wait for servers, for pages and for what was killed: two for each core."""
    return 2 * (os.cpu_count() or 1) if config.option.markexpr == "slow" else None


def pytest_collection_modifyitems(items):
    """Order the files: the one with the small study, which takes longest, comes first."""
    items.sort(key=lambda item: (not _asks_for_study(item), not set(LONG) & set(item.path.parts)))


def pytest_collection_finish():
    """What is imported and collected stays to the end: garbage is not looked for in it, and seldom elsewhere."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(50_000, 20, 20)


def _asks_for_study(item):
    return item.path.name == "test_study_run.py"
