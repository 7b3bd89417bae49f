"""A study whose workers and whose parent are killed at any moment goes on, and ends in the same bytes."""

import contextlib
import os
import random
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

SCRIPT = """
import os, sys, time
from pathlib import Path
from dataclasses import dataclass
import numpy as np
import pandas as pd
from halfseen.study.experiment import Experiment
from halfseen.study.runner import run_study
from halfseen.study.setting import Setting
from halfseen.workers import Workers
from halfseen.world.scene import Scene

@dataclass(frozen=True)
class Slow(Experiment):
    most_repetitions = None
    name = "slow"
    texts = "heading = 'Slow'\\nsentences = ['It was slow.']"

    def prepare(self, setting):
        time.sleep(0.2)
        return {"half": 0.5}

    def repeat(self, setting, prepared, index):
        time.sleep(0.1)
        while index == 20 and Path(os.environ.get("HELD", "nowhere")).exists():
            time.sleep(0.02)
        return {"sum": float(np.random.default_rng([setting.seed, index]).normal(size=1000).sum()) + prepared["half"]}

    def tabulate(self, setting, pieces):
        return {"slow": pd.DataFrame(pieces.repetitions)}

if __name__ == "__main__":
    setting = Setting((Scene(np.zeros((2, 2)), name="two"),), repetitions=int(sys.argv[4]))
    workers = Workers(int(sys.argv[2]), sys.argv[3])
    run_study(setting, Path(sys.argv[1]), (Slow(),), is_resumed="--resume" in sys.argv, workers=workers)
"""
NUM = 40
OUTPUTS = ("slow.csv", "study.json", "report.html")


@pytest.fixture(scope="module")
def script(tmp_path_factory):
    script = tmp_path_factory.mktemp("script") / "slow.py"
    script.write_text(SCRIPT)
    return script


def begun(
    script: Path, folder: Path, num: int, engine: str = "processes", *more: str, held: Path | None = None
) -> subprocess.Popen[bytes]:
    """Begin a study, which does not end while the file `held` is there, however slow who looks at it is."""
    env = os.environ if held is None else os.environ | {"HELD": str(held)}
    words = [sys.executable, str(script), str(folder), str(num), engine, str(NUM), *more]
    return subprocess.Popen(words, stderr=subprocess.PIPE, env=env)


def num_kept(folder: Path) -> int:
    return len(list((folder / "progress/slow").glob("repetition-*.json")))


def until_it_keeps(study: subprocess.Popen[bytes], folder: Path, num: int = 1) -> None:
    """Wait until so many repetitions are kept."""
    while num_kept(folder) < num:
        assert study.poll() is None, study.communicate()[1].decode()
        time.sleep(0.02)


@contextlib.contextmanager
def left_to_nobody(study: subprocess.Popen[bytes]) -> Iterator[None]:
    """Whatever a test says, the study that it began has ended after it."""
    with study:
        try:
            yield
        finally:
            study.kill()


def workers_of(study: subprocess.Popen[bytes]) -> list[psutil.Process]:
    """Workers of a study that live, but for what tells its processes of memory; any may end while it is looked at."""
    found = []
    with contextlib.suppress(psutil.NoSuchProcess):
        for child in psutil.Process(study.pid).children():
            with contextlib.suppress(psutil.NoSuchProcess):
                message = " ".join(child.cmdline())
                if "loky" in message and "resource_tracker" not in message:
                    found.append(child)
    return found


def finished(script: Path, folder: Path, *message) -> dict[str, bytes]:
    study = begun(script, folder, *message)
    with left_to_nobody(study):
        _, said = study.communicate()
    assert study.returncode == 0, said.decode()
    return {name: (folder / name).read_bytes() for name in OUTPUTS}


@pytest.fixture(scope="module")
def wanted(script, tmp_path_factory):
    return finished(script, tmp_path_factory.mktemp("alone") / "study", 1)


@pytest.mark.slow
@pytest.mark.parametrize(("num", "engine"), [(3, "processes"), (2, "dask"), (2, "ray")])
def test_the_bytes_are_those_of_one_worker(script, wanted, tmp_path, num, engine):
    assert finished(script, tmp_path / "study", num, engine) == wanted


@pytest.fixture
def held(tmp_path):
    file = tmp_path / "held"
    file.touch()
    return file


@pytest.mark.slow
def test_workers_killed_at_random_moments_change_nothing(script, wanted, tmp_path, held):
    study, rng, num_killed = begun(script, tmp_path / "study", 2, held=held), random.Random(0), 0
    with left_to_nobody(study):
        until_it_keeps(study, tmp_path / "study")
        while num_killed < 5:
            assert study.poll() is None, study.communicate()[1].decode()
            time.sleep(rng.uniform(0.0, 1.0))
            with contextlib.suppress(psutil.NoSuchProcess, IndexError):
                rng.choice(workers_of(study)).kill()
                num_killed += 1
        held.unlink()
        _, said = study.communicate()
        assert study.returncode == 0, said.decode()
    assert {name: (tmp_path / "study" / name).read_bytes() for name in OUTPUTS} == wanted


@pytest.mark.slow
def test_a_parent_killed_four_times_goes_on_and_leaves_nobody_behind(script, wanted, tmp_path, held):
    """Half of the kills fall anywhere in the life of a study, the others where it keeps what was made."""
    rng, folder = random.Random(1), tmp_path / "study"
    for kill in range(4):
        # The two that are held are never kept.
        num = min(num_kept(folder) + 1, NUM - 2)
        study = begun(script, folder, 2, "processes", "--resume", held=held)
        with left_to_nobody(study):
            if kill % 2:
                until_it_keeps(study, folder, num)
                time.sleep(rng.uniform(0.0, 0.5))
            else:
                time.sleep(rng.uniform(0.3, 3.0))
            children = psutil.Process(study.pid).children(recursive=True)
        _, left = psutil.wait_procs(children, timeout=120)
        assert not left
    held.unlink()
    assert finished(script, folder, 2, "processes", "--resume") == wanted
    assert not list(folder.glob("**/.*.new"))


@pytest.mark.slow
def test_a_second_study_into_the_same_folder_is_refused(script, tmp_path, held):
    study = begun(script, tmp_path / "study", 2, held=held)
    with left_to_nobody(study):
        until_it_keeps(study, tmp_path / "study")
        second = begun(script, tmp_path / "study", 2, "processes", "--resume")
        with left_to_nobody(second):
            _, said = second.communicate()
        assert second.returncode != 0
        assert "another study is writing into it; wait until it ends" in said.decode()
        held.unlink()
        study.communicate()
        assert study.returncode == 0
