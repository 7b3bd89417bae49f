"""The tests compile more than they compute: XLA does not optimise here, and compiles each computation once for all."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

# How long an example takes depends on what else the machine does.
settings.register_profile("halfseen", deadline=None)
settings.load_profile("halfseen")

COMPILED = Path(__file__).parents[1] / "runs" / "compiled"

# Set before JAX and BLAS are imported, which read them once; processes that tests start read them too. One test process
# a core leaves a second thread of BLAS nothing but to wait.
for name, value in {
    "OPENBLAS_NUM_THREADS": "1",
    "XLA_FLAGS": "--xla_backend_optimization_level=0",
    "JAX_COMPILATION_CACHE_DIR": str(COMPILED),
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
}.items():
    os.environ.setdefault(name, value)

LONG = ("study", "planners", "q_learning", "tables", "docs", "examples")
"""Folders whose files take long: they start first, so that no process is left with one of them at the end."""


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Tests of one file run in one process, and so do all that ask for the one small study, which takes longest."""
    items.sort(key=lambda item: (not _asks_for_study(item), not set(LONG) & set(item.path.parts)))
    for item in items:
        item.add_marker(pytest.mark.xdist_group("the small study" if _asks_for_study(item) else str(item.path)))


def _asks_for_study(item):
    return "study_folder" in getattr(item, "fixturenames", ())
