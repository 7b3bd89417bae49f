"""A disk that is full, or fails: the log stays readable, the recorder says so and goes on when there is room."""

import errno
import os
import random
import re
import resource
import shutil
import subprocess
import tempfile
from pathlib import Path

import pytest
from recordings import begin, step

from halfseen.errors import LogError
from halfseen.logs import LogRecorder, read_logs
from halfseen.logs.journal.parts import JOURNAL

# JAX warns of forks where other tests have loaded it; the children here do not touch it.
pytestmark = pytest.mark.filterwarnings("ignore:os.fork:RuntimeWarning")


class FailingDisk:
    """Stands in for `os`: some calls write a part and fail, or fail altogether."""

    def __init__(self, rng, share):
        self._rng, self._share = rng, share
        self.is_broken = False

    def __getattr__(self, name):
        return getattr(os, name)

    def _fails(self):
        return self.is_broken or self._rng.random() < self._share

    def write(self, descriptor, line):
        if not self._fails():
            return os.write(descriptor, line)
        num_bytes = os.write(descriptor, line[: self._rng.randrange(len(line))])
        if self._rng.random() < 0.5:
            return num_bytes
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def fsync(self, descriptor):
        if self._fails():
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    def ftruncate(self, descriptor, num_bytes):
        if self._fails():
            raise OSError(errno.EIO, os.strerror(errno.EIO))
        os.ftruncate(descriptor, num_bytes)


def until_it_is_taken(call, *given, **named):
    """Give an event again until it is taken; returns how often it was refused."""
    num_refused = 0
    while True:
        try:
            call(*given, **named)
        except LogError as error:
            assert re.search("cannot be written .* give it again; all before it is kept", str(error))  # noqa: PT017
            num_refused += 1
        else:
            return num_refused


@pytest.mark.parametrize(
    ("num_paths", "seed", "fewest_refused"), [(6, 1, 5), pytest.param(120, 2, 200, marks=pytest.mark.slow)]
)
def test_faults_of_writing_lose_nothing_that_was_taken(tmp_path, monkeypatch, num_paths, seed, fewest_refused):
    disk = FailingDisk(random.Random(seed), 0.3)
    num_refused = 0
    with LogRecorder(tmp_path, fsync="stage", part_bytes=1) as recorder:
        monkeypatch.setattr("halfseen.logs.journal.writer.os", disk)
        monkeypatch.setattr("halfseen.logs.journal.durability.os", disk)
        for number in range(1, num_paths + 1):
            path = recorder.begin_path()
            for stage in (1, 2):
                num_refused += until_it_is_taken(path.begin_stage, {"x": stage}, action="PICK")
                num_refused += until_it_is_taken(path.complete_stage, 1.0, elapsed_s=float(stage))
            num_refused += until_it_is_taken(path.finish)
            assert read_logs(tmp_path).num_paths == number
        monkeypatch.undo()
    logs = read_logs(tmp_path)
    assert logs.is_finished.all()
    assert logs.stages["x"].tolist() == [1, 2] * num_paths
    assert num_refused > fewest_refused


def test_a_file_that_may_not_grow_loses_only_the_event(tmp_path):
    child = os.fork()
    if child == 0:
        status = 1
        try:
            path = LogRecorder(tmp_path, fsync=True).begin_path()
            step(path, 1.0)
            size = (tmp_path / JOURNAL).stat().st_size
            resource.setrlimit(resource.RLIMIT_FSIZE, (size + 40, resource.RLIM_INFINITY))
            try:
                begin(path)
            except LogError as error:
                status = 0 if "make room and give it again" in str(error) else 2
            resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY, resource.RLIM_INFINITY))
            begin(path)
        except BaseException:
            status = 3
        finally:
            os._exit(status)
    assert os.waitpid(child, 0)[1] == 0
    assert read_logs(tmp_path).stages["elapsed_s"].notna().tolist() == [True, False]


def test_a_disk_that_stays_broken_leaves_what_was_taken(tmp_path, monkeypatch):
    disk, recorder = FailingDisk(random.Random(1), 0.0), LogRecorder(tmp_path)
    path = recorder.begin_path()
    path.begin_stage({"x": 1.0}, action="PICK")
    monkeypatch.setattr("halfseen.logs.journal.writer.os", disk)
    disk.is_broken = True
    with pytest.raises(LogError, match="cannot be written"):
        path.complete_stage(1.0)
    with pytest.raises(LogError, match="cannot be written"):
        recorder.close()
    monkeypatch.undo()
    assert read_logs(tmp_path).paths["cause"].tolist() == ["crash"]
    with LogRecorder(tmp_path) as recorder:
        assert recorder.begin_path().name == 2


@pytest.fixture
def small_disk():
    """A file system of 32 pages, where this user may mount one."""
    folder = Path(tempfile.mkdtemp())
    command = ["mount", "-t", "tmpfs", "-o", "size=128k", "tmpfs", str(folder)]
    if shutil.which("mount") is None or subprocess.run(command, capture_output=True, check=False).returncode:
        folder.rmdir()
        pytest.skip("this user may not mount a file system")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)
        folder.rmdir()


def test_a_disk_that_is_full_for_a_while_loses_nothing_that_was_taken(small_disk):
    (small_disk / "others").write_bytes(bytes(64_000))
    with LogRecorder(small_disk / "logs", fsync="stage") as recorder:
        path, num_stages = recorder.begin_path(), 0
        told = ""
        while not told:
            try:
                path.begin_stage({"x": num_stages, "seen": "z" * 2000}, action="PICK")
                num_stages += 1
                path.complete_stage(1.0, elapsed_s=float(num_stages))
            except LogError as error:
                told = str(error)
        assert re.search(r"\((No space left on device|.*bytes fitted)\); make room and give it again", told)
        assert num_stages > 10
        assert read_logs(small_disk / "logs").num_stages == num_stages
        (small_disk / "others").unlink()
        if not path.is_in_stage:
            path.begin_stage({"x": num_stages, "seen": ""}, action="PICK")
            num_stages += 1
        path.complete_stage(1.0, elapsed_s=float(num_stages))
        path.finish()
    logs = read_logs(small_disk / "logs")
    assert logs.is_finished.all()
    assert logs.stages["x"].tolist() == list(range(num_stages))
