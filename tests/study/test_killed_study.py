"""A study whose workers and whose parent are killed at any moment goes on, and ends in the same bytes."""

import contextlib
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import psutil
import pytest

SCRIPT = """
import sys, time
from pathlib import Path
from dataclasses import dataclass
import numpy as np
import pandas as pd
from halfseen.study.experiment import Section, Setting
from halfseen.study.run import run_study
from halfseen.workers import Workers
from halfseen.world.scene import Scene

@dataclass(frozen=True)
class Slow:
    most_repetitions = None
    name = "slow"

    def prepare(self, setting):
        time.sleep(0.2)
        return {"half": 0.5}

    def repeat(self, setting, prepared, index):
        time.sleep(0.25)
        return {"sum": float(np.random.default_rng([setting.seed, index]).normal(size=1000).sum()) + prepared["half"]}

    def tabulate(self, setting, pieces):
        return {"slow": pd.DataFrame(pieces.repetitions)}

    def section(self, setting, tables):
        return Section("Slow", ("It was slow.",), (), ())

if __name__ == "__main__":
    setting = Setting((Scene(np.zeros((2, 2)), name="two"),), repetitions=40)
    workers = Workers(int(sys.argv[2]), sys.argv[3])
    run_study(setting, Path(sys.argv[1]), (Slow(),), is_resumed="--resume" in sys.argv, workers=workers)
"""
OUTPUTS = ("slow.csv", "study.json", "report.html")


@pytest.fixture(scope="module")
def script(tmp_path_factory):
    script = tmp_path_factory.mktemp("script") / "slow.py"
    script.write_text(SCRIPT)
    return script


def begun(script: Path, folder: Path, num: int, engine: str = "processes", *more: str) -> subprocess.Popen[bytes]:
    return subprocess.Popen([sys.executable, str(script), str(folder), str(num), engine, *more], stderr=subprocess.PIPE)


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
                told = " ".join(child.cmdline())
                if "loky" in told and "resource_tracker" not in told:
                    found.append(child)
    return found


def finished(script: Path, folder: Path, *told) -> dict[str, bytes]:
    study = begun(script, folder, *told)
    _, said = study.communicate(timeout=120)
    assert study.returncode == 0, said.decode()
    return {name: (folder / name).read_bytes() for name in OUTPUTS}


@pytest.fixture(scope="module")
def wanted(script, tmp_path_factory):
    return finished(script, tmp_path_factory.mktemp("alone") / "study", 1)


@pytest.mark.slow
@pytest.mark.parametrize(("num", "engine"), [(2, "processes"), (3, "processes"), (2, "dask"), (2, "ray")])
def test_the_bytes_are_those_of_one_worker(script, wanted, tmp_path, num, engine):
    assert finished(script, tmp_path / "study", num, engine) == wanted


@pytest.mark.slow
def test_workers_killed_at_random_moments_change_nothing(script, wanted, tmp_path):
    study, rng, num_killed = begun(script, tmp_path / "study", 2), random.Random(0), 0
    with left_to_nobody(study):
        while study.poll() is None:
            time.sleep(rng.uniform(1.5, 4.0))
            workers = workers_of(study)
            if workers and num_killed < 5:
                with contextlib.suppress(psutil.NoSuchProcess):
                    rng.choice(workers).kill()
                    num_killed += 1
        _, said = study.communicate()
        assert study.returncode == 0, said.decode()
    assert num_killed >= 1
    assert {name: (tmp_path / "study" / name).read_bytes() for name in OUTPUTS} == wanted


@pytest.mark.slow
def test_a_parent_killed_twenty_times_goes_on_and_leaves_nobody_behind(script, wanted, tmp_path):
    rng, folder = random.Random(1), tmp_path / "study"
    for _ in range(20):
        study = begun(script, folder, 2, "processes", "--resume")
        time.sleep(rng.uniform(0.3, 3.0))
        children = psutil.Process(study.pid).children(recursive=True)
        os.kill(study.pid, signal.SIGKILL)
        study.communicate()
        _, left = psutil.wait_procs(children, timeout=10)
        assert not left
    assert finished(script, folder, 2, "processes", "--resume") == wanted
    assert not list(folder.glob("**/.*.new"))


@pytest.mark.slow
def test_a_second_study_into_the_same_folder_is_refused(script, tmp_path):
    study = begun(script, tmp_path / "study", 2)
    with left_to_nobody(study):
        while not (tmp_path / "study/progress/slow").exists():
            time.sleep(0.02)
        second = begun(script, tmp_path / "study", 2, "processes", "--resume")
        _, said = second.communicate()
        assert second.returncode != 0
        assert "another study writes into it; wait for its end" in said.decode()
        study.communicate()
        assert study.returncode == 0
