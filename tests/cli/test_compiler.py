"""What JAX compiled is kept between calls, and nothing that happens to it is a user's concern."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from halfseen.cli import compiler
from halfseen.workers import piece

SIMULATE = "from halfseen.cli import main; main()"


@pytest.fixture
def place(tmp_path, monkeypatch):
    """A user's cache of this test alone."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(os, "environ", os.environ.copy())
    for name in (compiler.KEPT_IN, *compiler.KEPT):
        os.environ.pop(name, None)
    return compiler._place()


def simulated(tmp_path, name):
    words = ["simulate", "-q", "--episodes", "5", "--out", str(tmp_path / name)]
    done = subprocess.run(
        [sys.executable, "-c", SIMULATE, *words], capture_output=True, text=True, check=True, env=os.environ
    )
    return done.stderr, (tmp_path / name / "stages.parquet").read_bytes()


@pytest.mark.slow
def test_what_was_compiled_is_read_by_the_next_call_and_what_a_kill_cut_is_thrown_away(place, tmp_path):
    told, numbers = simulated(tmp_path, "compiled")
    kept = {path: path.read_bytes() for path in place.iterdir()}
    assert kept
    assert place.stat().st_mode & 0o077 == 0
    assert simulated(tmp_path, "read") == (told, numbers)
    assert {path: path.read_bytes() for path in place.iterdir()} == kept
    for path, program in kept.items():
        path.write_bytes(program[: len(program) // 2])
    assert simulated(tmp_path, "cut") == (told, numbers)
    assert simulated(tmp_path, "anew") == (told, numbers)


def test_where_it_is_kept_is_the_users_choice_if_there_is_one(place, monkeypatch):
    monkeypatch.setitem(os.environ, compiler.KEPT_IN, "elsewhere")
    compiler.set_compiler()
    assert os.environ[compiler.KEPT_IN] == "elsewhere"
    assert not place.exists()
    assert not set(compiler.KEPT) & set(os.environ)


def test_what_happens_to_a_folder_of_the_users_own_is_told_and_nothing_is_thrown_away(place, tmp_path, monkeypatch):
    for folder in (place, tmp_path / "own"):
        folder.mkdir(parents=True)
    monkeypatch.setitem(os.environ, compiler.KEPT_IN, str(tmp_path / "own"))
    assert not compiler.is_of_kept_programs(f"{compiler.UNREADABLE} for 'jit_f': it is cut")
    assert place.is_dir()
    assert (tmp_path / "own").is_dir()


def test_what_others_may_write_is_not_run(place):
    compiler.set_compiler()
    assert os.environ.pop(compiler.KEPT_IN) == str(place)
    place.chmod(0o777)
    compiler.set_compiler()
    assert compiler.KEPT_IN not in os.environ


def test_nothing_is_kept_where_nothing_can_be_written(place):
    place.parent.parent.write_text("a file, where a folder is wanted")
    compiler.set_compiler()
    assert compiler.KEPT_IN not in os.environ


def test_too_much_is_thrown_away(place, monkeypatch):
    compiler.set_compiler()
    (place / "program-cache").write_bytes(b"0" * 100)
    os.environ.pop(compiler.KEPT_IN)
    monkeypatch.setattr(compiler, "MOST_BYTES", 99)
    compiler.set_compiler()
    assert not list(place.iterdir())
    assert place.stat().st_mode & 0o077 == 0


def test_a_user_without_a_home_keeps_nothing(place, monkeypatch, tmp_path):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(compiler, "user_cache_path", lambda *_, **__: Path("~/.cache/halfseen"))
    compiler.set_compiler()
    assert compiler.KEPT_IN not in os.environ
    assert not list(tmp_path.iterdir())


def test_other_warnings_are_told(place):
    compiler.set_compiler()
    assert not compiler.is_of_kept_programs("overflow encountered in exp")
    assert compiler.is_of_kept_programs(f"{compiler.UNWRITABLE} for 'jit_f': OSError: disk full")


def test_a_cluster_is_not_told_where_this_machine_keeps_what_it_compiled(place):
    compiler.set_compiler()
    told = piece.home().settings
    assert compiler.KEPT_IN in os.environ
    assert not {compiler.KEPT_IN, *compiler.KEPT} & set(told)
    assert set(compiler.SETTINGS) <= set(told)
