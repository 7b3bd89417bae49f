"""Programs that are kept: read by the next process, to the same bits, and never where they would be others."""

import os
import subprocess
import sys
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from halfseen import programs
from halfseen.programs import kept_jit

SCRIPT = """
import sys
import jax, jax.numpy as jnp, numpy as np
from functools import partial
from halfseen.programs import kept_jit

@partial(kept_jit, static_argnames="power")
def f(pair, *, power, **more):
    print("traced")
    values, vectors = jnp.linalg.eigh(pair["a"] * more["by"])
    return {"sum": (values**power).sum(), "key": jax.random.split(pair["key"])[0]}

with jax.enable_x64("--double" in sys.argv):
    pair = {"a": np.diag([1.0, 2.0, 5.0])[: int(sys.argv[1]), : int(sys.argv[1])], "key": jax.random.key(1)}
    for _ in range(2):
        found = f(pair, power=int(sys.argv[2]), by=0.3)
    print(repr(found["sum"]), jax.random.key_data(found["key"]))
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv(programs.KEPT_IN, str(tmp_path))
    return tmp_path


def told(*words):
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, *words], capture_output=True, text=True, check=True, env=os.environ
    )
    return done.stdout


def num_kept(folder):
    return len(list(folder.iterdir()))


@pytest.mark.slow
def test_the_next_process_reads_a_program_that_calls_lapack_and_what_was_cut_is_made_anew(folder):
    first, second = told("3", "2"), told("3", "2")
    assert first == "traced\n" + second
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    file.write_bytes(whole[: len(whole) // 2])
    assert told("3", "2") == first
    assert told("3", "2") == second


@pytest.mark.slow
def test_what_is_compiled_for_anything_else_is_another_program(folder, monkeypatch):
    for words in (("3", "2"), ("2", "2"), ("3", "3"), ("3", "2", "--double")):
        assert told(*words).startswith("traced")
    monkeypatch.setenv("XLA_FLAGS", "--xla_backend_optimization_level=1")
    assert told("3", "2").startswith("traced")
    assert num_kept(folder) == 5


def test_other_source_is_another_program(folder, monkeypatch):
    double = kept_jit(lambda x: 2.0 * x)
    assert double(1.5) == 3.0
    monkeypatch.setattr(programs, "_origin", lambda: "another source")
    assert kept_jit(double.__wrapped__)(1.5) == 3.0
    assert num_kept(folder) == 2


def test_nothing_is_kept_of_types_of_a_users_own(folder):
    @jax.tree_util.register_dataclass
    @dataclass
    class Own:
        x: float

    assert kept_jit(lambda own: own.x + 1.0)(Own(1.0)) == 2.0
    assert num_kept(folder) == 0


def test_within_another_program_it_is_a_part_of_that(folder):
    square = kept_jit(lambda x: x * x)
    np.testing.assert_array_equal(jax.vmap(square)(jnp.arange(3.0)), [0.0, 1.0, 4.0])
    assert jax.grad(square)(3.0) == 6.0
    assert num_kept(folder) == 0


def test_nothing_is_kept_where_nobody_says_where(tmp_path, monkeypatch):
    monkeypatch.delenv(programs.KEPT_IN, raising=False)
    monkeypatch.chdir(tmp_path)
    assert kept_jit(lambda x: x + 1.0)(1.0) == 2.0
    assert num_kept(tmp_path) == 0


@pytest.mark.slow
def test_nothing_is_kept_where_nothing_is_to_be(folder, monkeypatch):
    monkeypatch.setenv("JAX_ENABLE_COMPILATION_CACHE", "false")
    assert told("3", "2").startswith("traced")
    assert num_kept(folder) == 0


def test_a_folder_that_is_gone_is_not_made(folder, monkeypatch):
    monkeypatch.setenv(programs.KEPT_IN, str(folder / "gone"))
    assert kept_jit(lambda x: x + 1.0)(1.0) == 2.0
    assert num_kept(folder) == 0
