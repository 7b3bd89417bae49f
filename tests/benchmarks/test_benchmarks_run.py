"""Benchmarks still run: what they import and unpack changes, and nothing else calls them."""

import subprocess
import sys
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    "words",
    [
        ("planning.py", "--episodes", "1"),
        ("looking.py", "--tables", "2", "--runs", "1"),
        ("world_steps.py", "--steps", "2", "--runs", "1"),
        ("calibration.py", "--tables", "1", "--states", "2", "--trajectories", "30"),
        ("coverage.py", "--logs", "2", "--row", "cut 1/3"),
        ("verdicts.py", "--logs", "2", "--world", "trial", "--share", "1/3", "--setting", "default"),
        ("repetition.py", "--repetitions", "1"),
        ("serve.py", "--seconds", "3"),
        ("closed_loop.py", "--tables", "2", "--only", "greedy"),
        ("half_seen.py", "--tables", "1", "--washes", "1", "--stains", "2"),
        ("two_arms.py", "--tables", "1", "--only", "one arm", "two arms"),
        ("team_regret.py", "--horizon", "1", "--futures", "4"),
        ("teams.py", "--robots", "2", "--price", "-0.05", "--trajectories", "60", "--logs", "1", "--episodes", "50"),
        ("recorder.py", "--trajectories", "3"),
        ("lies.py", "--logs", "1", "--trajectories", "60"),
        ("wrong_laws.py", "--cases", "news", "stick", "--sizes", "30", "--logs", "1"),
        ("learners.py", "--logs", "1", "--worlds", "trial", "--shares", "0.3", "--methods", "quadratic, imputed"),
    ],
    ids=lambda words: words[0],
)
def test_it_runs_and_stores_what_it_found(words, tmp_path):
    script, *options = words
    out = tmp_path / "found.json"
    command = [sys.executable, str(BENCHMARKS / script), "--out", str(out), *options]
    done = subprocess.run(command, capture_output=True, text=True, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip()
    assert out.stat().st_size > 100
