"""Logs of half a million stages and of many more, learned from in passes: time, memory, and how both grow.

python benchmarks/streaming.py [--stages 500000 5000000] [--recipes paper default] [--workers 2] [--forget] [--keep]

Two recipes: eq. 3 as the paper has it (weights by Kaplan–Meier, a linear Q), and the learner's default (imputed
targets, a Q with a smooth part of 48 features, pooled stages, pessimism), which sums a hundred times as many products
for each stage. Memory is the most that all processes ever held together: the sum of their proportional set sizes.
With --forget nothing is kept on disk between passes, as for a worker of a cluster that another one's shard comes to.

Writing and learning run in processes of their own, so that the memory of one is not that of the other. The log is made
part by part; its Q is known to be learned as in memory by tests/learning/test_streaming.py. With --keep the
results are written to benchmarks/streaming.json, from which the guide computes what a fleet would take.
"""

import argparse
import json
import multiprocessing
import os
import resource
import tempfile
import threading
import time
from pathlib import Path

import numpy as np
import pandas as pd
import timings

from halfseen.writing import write_file

BAR_STAGES, BAR_S = 5_000_000, 60.0
HORIZON, TRAJECTORIES_AT_ONCE = 10, 2_000
OUT, KEPT = Path("runs/benchmarks/streaming.json"), Path(__file__).with_name("streaming.json")
LOOK_S = 0.1
"""Between two looks at the memory [s]."""
NAMES = {"paper": "eq. 3 of the paper", "default": "the default"}


def part_of(first, num_trajectories, rng):
    """Trajectories of up to ten stages, cut at exponential times."""
    from halfseen.logs import Logs

    clock = np.cumsum(rng.exponential(1.0, size=(num_trajectories, HORIZON)) + 0.1, axis=1)
    cut_s = rng.exponential(60.0, size=num_trajectories)
    is_seen = clock <= cut_s[:, None]
    num_seen = is_seen.sum(axis=1)
    is_cut = num_seen < HORIZON
    trajectory, stage = np.nonzero(np.arange(HORIZON) < np.minimum(num_seen + 1, HORIZON)[:, None])
    x = rng.normal(size=(len(trajectory), 3))
    is_b = rng.integers(0, 2, len(trajectory))
    done = is_seen[trajectory, stage]
    reward = x[:, 0] * (2 * is_b - 1) + rng.normal(size=len(trajectory))
    stages = {
        "trajectory": first + trajectory,
        "stage": stage + 1,
        "elapsed_s": np.where(done, clock[trajectory, stage], np.nan),
        "action": np.array(["A", "B"])[is_b],
        "reward": np.where(done, reward, np.nan),
        **{f"x{k}": x[:, k] for k in range(3)},
    }
    trajectories = {
        "trajectory": first + np.arange(num_trajectories),
        "end_s": np.where(is_cut, cut_s, clock[:, -1]),
        "ending": np.where(is_cut, "cut", "finished"),
    }
    return Logs(pd.DataFrame(stages), pd.DataFrame(trajectories))


def write(folder, num_stages):
    from halfseen.logs import write_stream

    rng, written = np.random.default_rng(0), [0]

    def parts():
        first = 0
        while written[0] < num_stages:
            part = part_of(first, TRAJECTORIES_AT_ONCE, rng)
            written[0] += part.num_stages
            first += TRAJECTORIES_AT_ONCE
            yield part

    write_stream(parts(), folder)


def learner_of(recipe):
    from halfseen.learning import CensoredQLearner

    make = CensoredQLearner.of_paper if recipe == "paper" else CensoredQLearner
    return make(HORIZON, ["A", "B"], ["x0", "x1", "x2"])


def processes_of(pid):
    """A process and all that it has begun."""
    found = [pid]
    for tasks in Path(f"/proc/{pid}/task").glob("*/children"):
        try:
            for child in tasks.read_text().split():
                found += processes_of(int(child))
        except OSError:
            continue  # it has ended meanwhile
    return found


def held_bytes(pid):
    """Proportional set size of a process: what several share counts once."""
    try:
        lines = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    except OSError:
        return 0
    return next((1024 * int(line.split()[1]) for line in lines if line.startswith("Pss:")), 0)


class Watch:
    """Notes the most memory that this process and its workers hold."""

    def __init__(self):
        self.most, self._is_over = 0, threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    def _watch(self):
        while not self._is_over.wait(LOOK_S):
            self.most = max(self.most, sum(map(held_bytes, processes_of(os.getpid()))))

    def stop(self):
        self._is_over.set()
        self._thread.join()


def cpu_s():
    """What this process and those of its workers that have ended took [s]."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def learn(folder, recipe, num_workers, is_kept, answers):
    from joblib.externals.loky import get_reusable_executor

    from halfseen.logs import LogStream
    from halfseen.workers import Workers

    if not is_kept:
        from halfseen.learning import streaming

        streaming.MOST_SHARE = 0.0

    watch, stream = Watch(), LogStream(folder, TRAJECTORIES_AT_ONCE)
    start, begun = time.perf_counter(), cpu_s()
    learner = learner_of(recipe).fit(stream, Workers(num_workers))
    seconds = time.perf_counter() - start
    watch.stop()
    if num_workers > 1:
        get_reusable_executor().shutdown(wait=True)
    # The truth: in the last stage B is worth x0 more, A x0 less.
    ends = learner.q_values(pd.DataFrame({"x0": [-1.0, 1.0], "x1": 0.0, "x2": 0.0}), stage=HORIZON)
    slopes = (ends[1] - ends[0]) / 2.0
    answers.put(
        {
            "num_stages": stream.num_stages,
            "num_trajectories": stream.num_trajectories,
            "num_workers": num_workers,
            "is_kept": is_kept,
            "seconds": seconds,
            "cpu_s": cpu_s() - begun,
            "passes": HORIZON,
            "peak_gb": watch.most / 1e9,
            "slopes_of_x0": slopes.tolist(),
        }
    )


def run(job, answers=None):
    job.start()
    answer = None if answers is None else answers.get()
    job.join()
    if job.exitcode:
        raise SystemExit(f"{job.name} ended with status {job.exitcode}")
    return answer


def measured(num_stages, recipes, num_workers, is_kept):
    """Learn by each recipe from a log of so many stages."""
    context, found = multiprocessing.get_context("spawn"), []
    with tempfile.TemporaryDirectory() as scratch:
        folder, answers = Path(scratch) / "logs", context.Queue()
        run(context.Process(target=write, args=(folder, num_stages)))
        megabytes = sum(file.stat().st_size for file in folder.iterdir()) / 1e6
        for recipe in recipes:
            output = run(context.Process(target=learn, args=(folder, recipe, num_workers, is_kept, answers)), answers)
            found.append({"recipe": recipe, "file_mb": megabytes} | output)
            show(found[-1])
    return found


def is_judged(result):
    """Whether the bars are meant for a log of this size."""
    return BAR_STAGES <= result["num_stages"] < 2 * BAR_STAGES


def show(result):
    print(
        f"{result['recipe']}: {result['num_stages']:,} stages of {result['num_trajectories']:,} trajectories, "
        f"{result['file_mb']:.0f} MB"
    )
    print(
        f"  learned in {result['seconds']:.0f} s ({result['cpu_s']:.0f} s of processors), "
        f"{result['num_workers']} workers"
    )
    bar = f" (bar: 1 GB, {'holds' if result['peak_gb'] < 1.0 else 'missed'})" if is_judged(result) else ""
    print(f"  most memory {result['peak_gb']:.2f} GB{bar}")
    low, high = result["slopes_of_x0"]
    print(f"  slopes of x0 in the last stage: {low:+.4f}, {high:+.4f} (truth -1, +1)", flush=True)


def with_kept(results):
    """What was kept before, and these in its place where they are of the same."""

    def key(result):
        return result["recipe"], result["is_kept"], result["num_stages"]

    before = json.loads(KEPT.read_text()) if KEPT.exists() else []
    machine = timings.machine()
    both = {key(result): result for result in before} | {
        key(result): result | {"machine": machine} for result in results
    }
    return [both[each] for each in sorted(both)]


def slope_of(results, recipe, is_kept=True):
    """What a stage more takes, between the smallest log and the largest one: processor time [s] and memory [bytes]."""
    sizes = [result for result in results if result["recipe"] == recipe and result["is_kept"] == is_kept]
    sizes.sort(key=lambda result: result["num_stages"])
    few, many = sizes[0], sizes[-1]
    more = many["num_stages"] - few["num_stages"]
    if not more:
        return None
    return (many["cpu_s"] - few["cpu_s"]) / more, 1e9 * (many["peak_gb"] - few["peak_gb"]) / more


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--stages", type=int, nargs="+", default=[500_000, BAR_STAGES])
    parser.add_argument("--recipes", nargs="+", choices=NAMES, default=list(NAMES))
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--forget", action="store_true")
    parser.add_argument("--keep", action="store_true")
    parser.add_argument("--out", type=Path, default=OUT)
    args = parser.parse_args()
    results = [result for size in args.stages for result in measured(size, args.recipes, args.workers, not args.forget)]
    for recipe in args.recipes:
        slope = slope_of(results, recipe, not args.forget)
        if slope is not None:
            print(f"{recipe}: a million stages more take {1e6 * slope[0]:.1f} s of processors and {slope[1]:.0f} MB")
    rows = []
    for result in [] if args.forget else results:
        bar_s = BAR_S if is_judged(result) else None
        what = f"learning from {result['num_stages']:,} stages in passes, {NAMES[result['recipe']]}"
        rows.append(timings.Row(what, result["seconds"], "s", bar=bar_s))
    timings.write(args.out, results, rows)
    if args.keep:
        write_file(KEPT, json.dumps(with_kept(results), indent=1) + "\n")


if __name__ == "__main__":
    main()
