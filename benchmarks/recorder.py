"""What it costs to record: the time of a call, for each of the ways to wait for the disk.

python benchmarks/recorder.py [--folder FOLDER] [--trajectories 200] [--out FILE]

The folder lies on the disk that is measured; without it, on that of this clone. Told are medians and 99th percentiles
of begin_stage and complete_stage [µs], and of a trajectory of ten stages its time a stage, with the ratio to that
without waiting.
"""

import argparse
import json
import tempfile
import time
from pathlib import Path

import numpy as np
import timings

from halfseen.logs import LogRecorder
from halfseen.logs.journal_writer import FSYNC
from halfseen.writing import write_file

OUT = Path("runs/benchmarks/recorder.json")
STAGES_A_TRAJECTORY = 10
SEEN = {f"x{k}": 0.1 * k for k in range(6)}
OBJECTS = [{"object": k, "occlusion": 0.5, "x_m": 0.1 * k} for k in range(6)]


def trajectory_us(recorder):
    """Times of begin_stage and of complete_stage, and the whole of a trajectory a stage [µs]."""
    begun_us, completed_us = [], []
    first = time.perf_counter_ns()
    trajectory = recorder.begin_trajectory()
    for _ in range(STAGES_A_TRAJECTORY):
        before = time.perf_counter_ns()
        trajectory.begin_stage(SEEN, OBJECTS, "PICK", 1, 0.5)
        between = time.perf_counter_ns()
        trajectory.complete_stage(1.0)
        begun_us.append((between - before) / 1e3)
        completed_us.append((time.perf_counter_ns() - between) / 1e3)
    trajectory.finish()
    return begun_us, completed_us, (time.perf_counter_ns() - first) / 1e3 / STAGES_A_TRAJECTORY


def measured(fsync, folder, num_trajectories):
    """One row of the report."""
    with tempfile.TemporaryDirectory(dir=folder) as place, LogRecorder(Path(place) / "logs", fsync=fsync) as recorder:
        trajectory_us(recorder)  # Whatever is done once.
        trajectories = [trajectory_us(recorder) for _ in range(num_trajectories)]
    begun, completed = (
        np.percentile([trajectory[k] for trajectory in trajectories], [50, 99]).round(1).tolist() for k in (0, 1)
    )
    return {
        "fsync": fsync,
        "num_trajectories": num_trajectories,
        "begin_stage_us": begun[0],
        "begin_stage_p99_us": begun[1],
        "complete_stage_us": completed[0],
        "complete_stage_p99_us": completed[1],
        "stage_us": round(float(np.median([trajectory[2] for trajectory in trajectories])), 1),
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--folder", type=Path, default=Path())
    parser.add_argument("--trajectories", type=int, default=200)
    parser.add_argument("--out", type=Path, default=OUT)
    given = parser.parse_args()
    rows = [measured(fsync, given.folder, given.trajectories) for fsync in FSYNC]
    for row in rows:
        row["ratio"] = round(row["stage_us"] / rows[0]["stage_us"], 2)
        row["machine"] = timings.machine()
        print(
            f"{row['fsync']:6} begin_stage {row['begin_stage_us']:8.1f} µs (99 %: {row['begin_stage_p99_us']:8.1f}), "
            f"complete_stage {row['complete_stage_us']:8.1f} µs (99 %: {row['complete_stage_p99_us']:8.1f}), "
            f"a stage {row['stage_us']:8.1f} µs, {row['ratio']:.2f} times that of never"
        )
    write_file(given.out, json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
