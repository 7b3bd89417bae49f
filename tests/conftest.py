"""The tests compile more than they compute: XLA does not optimise here, and compiles each computation once for all."""

import gc
import os
from pathlib import Path

import pytest
from hypothesis import settings

# How long an example takes depends on what else the machine does. A run tries few of them, as there are many runs.
settings.register_profile("few", deadline=None, max_examples=20)
settings.register_profile("many", deadline=None, max_examples=60)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "few"))

COMPILED = Path(__file__).parents[1] / "runs" / "compiled"

# Set before JAX and BLAS are imported, which read them once; processes that tests start read them too. One test process
# a core leaves a second thread of BLAS nothing but to wait, nor one of LLVM, for which XLA splits what it compiles.
for name, value in {
    "OPENBLAS_NUM_THREADS": "1",
    "XLA_FLAGS": "--xla_backend_optimization_level=0 --xla_cpu_use_fusion_emitters=false "
    "--xla_cpu_parallel_codegen_split_count=1",
    "JAX_COMPILATION_CACHE_DIR": str(COMPILED),
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
    "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
}.items():
    os.environ.setdefault(name, value)

LONG = ("study", "planners", "learning", "tables", "docs", "examples")
"""Folders whose files take long: they start first, so that no process is left with one of them at the end."""

MAPPED = Path("/proc/self/maps")
MOST_MAPPED = 20_000
"""Regions of memory after which compiled code is let go. Linux maps 65,530 for a process, and kills it at the next."""


@pytest.fixture(scope="module", autouse=True)
def _room_for_compiled_code():
    """Let go of what files before this one compiled, where there is much of it: each computation maps some memory."""
    import jax

    if MAPPED.exists() and MAPPED.read_bytes().count(b"\n") > MOST_MAPPED:
        jax.clear_caches()
        gc.collect()


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
