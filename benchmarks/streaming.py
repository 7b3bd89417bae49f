"""A log of five million stages, learned from in passes: time, and the most memory that the process ever held.

python benchmarks/streaming.py [--stages 5000000] [--recipes paper default]

Two recipes: eq. 3 as the paper has it (weights by Kaplan–Meier, a linear Q), which the bars are for, and the learner's
default (imputed targets, a Q with a smooth part of 48 features, pooled stages, pessimism), which sums a hundred times
as many products for each stage.

Writing and learning run in processes of their own, so that the memory of one is not that of the other. The log is made
part by part; its Q is known to be learned as in memory by tests/learners/q_learning/test_streaming.py.
"""

import argparse
import multiprocessing
import resource
import tempfile
import time
from pathlib import Path

import numpy as np
import pandas as pd
import timings

BAR_STAGES, BAR_S = 5_000_000, 60.0
HORIZON, PATHS_AT_ONCE = 10, 2_000
OUT = Path("runs/benchmarks/streaming.json")
NAMES = {"paper": "eq. 3 of the paper", "default": "the default"}


def part_of(first, num_paths, rng):
    """Paths of up to ten stages, cut at exponential times."""
    from halfseen.logs import Logs

    clock = np.cumsum(rng.exponential(1.0, size=(num_paths, HORIZON)) + 0.1, axis=1)
    cut_s = rng.exponential(60.0, size=num_paths)
    is_seen = clock <= cut_s[:, None]
    num_seen = is_seen.sum(axis=1)
    is_cut = num_seen < HORIZON
    path, stage = np.nonzero(np.arange(HORIZON) < np.minimum(num_seen + 1, HORIZON)[:, None])
    x = rng.normal(size=(len(path), 3))
    is_b = rng.integers(0, 2, len(path))
    done = is_seen[path, stage]
    reward = x[:, 0] * (2 * is_b - 1) + rng.normal(size=len(path))
    stages = {
        "path": first + path,
        "stage": stage + 1,
        "elapsed_s": np.where(done, clock[path, stage], np.nan),
        "action": np.array(["A", "B"])[is_b],
        "reward": np.where(done, reward, np.nan),
        **{f"x{k}": x[:, k] for k in range(3)},
    }
    paths = {
        "path": first + np.arange(num_paths),
        "end_s": np.where(is_cut, cut_s, clock[:, -1]),
        "ending": np.where(is_cut, "cut", "finished"),
    }
    return Logs(pd.DataFrame(stages), pd.DataFrame(paths))


def write(folder, num_stages):
    from halfseen.logs import write_stream

    rng, written = np.random.default_rng(0), [0]

    def parts():
        first = 0
        while written[0] < num_stages:
            part = part_of(first, PATHS_AT_ONCE, rng)
            written[0] += part.num_stages
            first += PATHS_AT_ONCE
            yield part

    write_stream(parts(), folder)


def learner_of(recipe):
    from halfseen.learners import CensoredQLearner

    make = CensoredQLearner.of_paper if recipe == "paper" else CensoredQLearner
    return make(HORIZON, ["A", "B"], ["x0", "x1", "x2"])


def learn(folder, recipe, answers):
    from halfseen.logs import LogStream

    stream = LogStream(folder, PATHS_AT_ONCE)
    start = time.perf_counter()
    learner = learner_of(recipe).fit(stream)
    seconds = time.perf_counter() - start
    # The truth: in the last stage B is worth x0 more, A x0 less.
    ends = learner.q_values(pd.DataFrame({"x0": [-1.0, 1.0], "x1": 0.0, "x2": 0.0}), stage=HORIZON)
    slopes = (ends[1] - ends[0]) / 2.0
    answers.put(
        {
            "num_stages": stream.num_stages,
            "num_paths": stream.num_paths,
            "seconds": seconds,
            "passes": HORIZON + 1,
            "peak_gb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6,
            "slopes_of_x0": slopes.tolist(),
        }
    )


def run(job, answers=None):
    job.start()
    told = None if answers is None else answers.get()
    job.join()
    if job.exitcode:
        raise SystemExit(f"{job.name} ended with status {job.exitcode}")
    return told


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--stages", type=int, default=BAR_STAGES)
    parser.add_argument("--recipes", nargs="+", choices=NAMES, default=list(NAMES))
    parser.add_argument("--out", type=Path, default=OUT)
    args = parser.parse_args()
    context, results, rows = multiprocessing.get_context("spawn"), {}, []
    with tempfile.TemporaryDirectory() as scratch:
        folder, answers = Path(scratch) / "logs", context.Queue()
        run(context.Process(target=write, args=(folder, args.stages)))
        megabytes = sum(file.stat().st_size for file in folder.iterdir()) / 1e6
        for recipe in args.recipes:
            told = run(context.Process(target=learn, args=(folder, recipe, answers)), answers)
            told |= {"file_mb": megabytes, "stages_per_s": told["num_stages"] * told["passes"] / told["seconds"]}
            print(f"{recipe}: {told['num_stages']:,} stages of {told['num_paths']:,} paths, {megabytes:.0f} MB on disk")
            speed = f"{told['passes']} passes, {told['stages_per_s']:,.0f} stages a second"
            print(f"  learned in {told['seconds']:.0f} s, {speed}")
            holds = "holds" if told["peak_gb"] < 1.0 else "missed"
            print(f"  most memory {told['peak_gb']:.2f} GB (bar: 1 GB, {holds})")
            low, high = told["slopes_of_x0"]
            print(f"  slopes of x0 in the last stage: {low:+.4f}, {high:+.4f} (truth -1, +1)", flush=True)
            bar_s = BAR_S if recipe == "paper" and told["num_stages"] >= BAR_STAGES else None
            what = f"learning from {told['num_stages']:,} stages in passes, {NAMES[recipe]}"
            rows.append(timings.Row(what, told["seconds"], "s", bar=bar_s))
            results[recipe] = told
    timings.write(args.out, results, rows)


if __name__ == "__main__":
    main()
